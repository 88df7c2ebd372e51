"""From (gamma, delta, r) to joint and motor angles on one particular robot, or the reason why not.

The public face of this layer: :class:`Detector` is a model in a cell; :meth:`Detector.locate` answers one position.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from clampid.models.ranges import Beyond
from experiments.temperatures import REFERENCE_TEMPERATURE
from kinematics.robot import RobotDescription
from offline_ik.arm.identified import Conditions, IdentifiedArm
from offline_ik.arm.kernel import Kernel
from offline_ik.cell.cell import LONGEST_TIME, Cell
from offline_ik.cell.checks import check_directions, check_posture, check_temperatures
from offline_ik.cell.coordinates import check_target, detector_pose
from offline_ik.cell.frames import Framing
from offline_ik.cell.reach import nearest_reachable
from offline_ik.collision.world import sheets_of
from offline_ik.errors import TargetError
from offline_ik.inverse.answer import Answer, Solution
from offline_ik.inverse.assumed import notes_of
from offline_ik.inverse.branches import Choice, parse_choice, status_and_turn
from offline_ik.inverse.detector_parts import DetectorParts
from offline_ik.inverse.free_roll import effort, rolls_to_try
from offline_ik.inverse.nearest import Nearest
from offline_ik.inverse.postures import STAYED, Direction, Reasons
from offline_ik.inverse.uncertainty import Propagation

__all__ = ["Answer", "Detector", "Solution"]


Array = npt.NDArray[np.float64]


class Detector:
    """A detector on an identified arm in a cell.

    Parameters
    ----------
    arm, cell
        Of the same robot.
    parts
        Of the same arm in a cell that differs by its temperatures and running time only; None: made anew.

    Raises
    ------
    CellError
        The sample lies in an obstacle or in the robot's base, or the cell's targets are not the model's.
    DetectorError
        The arm has a joint that is not revolute, or fewer than six.
    """

    def __init__(self, arm: IdentifiedArm, cell: Cell, parts: DetectorParts | None = None) -> None:
        self.arm, self.cell = arm, cell
        self.parts = DetectorParts(arm, cell) if parts is None else parts
        self.robot: RobotDescription = arm.robot
        self.solver, self.search = self.parts.solver, self.parts.search
        self.lower, self.upper = self.parts.lower, self.parts.upper
        self.fastest, self.rest = self.parts.fastest, self.parts.rest
        if parts is None:
            from offline_ik.collision.safety import check_sample

            check_sample(self)

    def warm_up(self) -> None:
        """Compile what the first answer would otherwise have to wait for."""
        self.solver.pose(self.rest, self.still)
        near = self.pose(self.rest[None])[0]
        self.solver.solve(self.to_base(near)[None], self.rest[None], self.solver.signs(self.rest), self.still)
        self.propagation.jacobian(self.rest, self.still)
        if self.solver.analytic is not None:
            self.solver.branches(near[None])
        self.locate(0.0, 0.0, 1.0, nearest=False)
        for kernel in (self.looking, self.solver.whole):  # of what is out of reach, and of what is singular
            kernel.trigger()
        self.solver.search.refine(self.to_base(near)[None], self.rest[None], self.still)
        self.framing(near, self.rest)

    @cached_property
    def still(self) -> Conditions:
        """The cell's temperatures and running time, and no direction of approach known."""
        n, cell = self.arm.n, self.cell

        def above(value: Array | None) -> Array:
            return np.zeros(n) if value is None else np.asarray(value - REFERENCE_TEMPERATURE)

        running = cell.running or 0.0
        return Conditions(np.zeros(n), above(cell.link_temperature), above(cell.motor_temperature), running)

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What the cell states and the model does not use, and which meshes are flat."""
        return (*notes_of(self.arm, self.cell), *sheets_of(self.cell))

    def at_temperature(self, link: Array | None = None, motor: Array | None = None) -> Detector:
        """The same at other temperatures ``(n,)``, °C.

        Raises
        ------
        TargetError
            They are not as many, not finite, or no robot's (kelvin?).
        """
        cell, n = self.cell, self.arm.n
        links = cell.link_temperature if link is None else check_temperatures(n, link, "link")
        motors = cell.motor_temperature if motor is None else check_temperatures(n, motor, "motor")
        return self.within(replace(cell, link_temperature=links, motor_temperature=motors))

    def at_running(self, seconds: float) -> Detector:
        """The same when the robot has been running for so long, s.

        Raises
        ------
        TargetError
            It is no time, or of years.
        """
        if not 0 <= seconds <= LONGEST_TIME:
            raise TargetError(f"running: expected seconds from 0 to {LONGEST_TIME:g}, found {seconds:g}")
        return self.within(replace(self.cell, running=seconds))

    def within(self, cell: Cell) -> Detector:
        """The same in a cell that differs by its temperatures and running time, and by nothing else."""
        return self if cell is self.cell else Detector(self.arm, cell, self.parts)

    def to_base(self, pose: Array) -> Array:
        """A pose in the convention's frame as one in the calibrated base's."""
        return pose if self.cell.convention.frame == "base" else np.asarray(np.linalg.inv(self.arm.base) @ pose)

    def from_base(self, pose: Array) -> Array:
        """The inverse of :meth:`to_base`."""
        return pose if self.cell.convention.frame == "base" else np.asarray(self.arm.base @ pose)

    def pose(self, q: Array, conditions: Conditions | None = None) -> Array:
        """Where the detector is ``(N, 4, 4)`` at ``q`` ``(N, n)``, in the convention's frame."""
        return self.from_base(self.solver.pose(q, conditions or self.still))

    def motor(self, q: Array) -> Array:
        """Motor angles of joint angles ``(..., n)``: T^-T q."""
        return np.asarray(q @ self.parts.to_motor)

    def check_posture(self, q: Sequence[float] | Array, what: str = "near") -> Array:
        """A posture as an array.

        Raises
        ------
        TargetError
            Not as many finite numbers as there are joints, or far beyond the limits (degrees?).
        """
        return check_posture(self.arm.n, q, what)

    def locate(
        self,
        gamma: float,
        delta: float,
        r: float,
        roll: float | None = 0.0,
        *,
        near: Sequence[float] | Array | None = None,
        branch: Choice | str = "nearest",
        direction: Direction = None,
        nearest: bool = True,
    ) -> Answer:
        """Joint and motor angles for a detector position.

        Parameters
        ----------
        gamma, delta, r
            rad, rad, m, in the cell's convention.
        roll
            About the detector's normal, rad; None: free, the one that moves the joints least, see
            :mod:`offline_ik.inverse.free_roll`.
        near
            ``(n,)``: the posture at hand, rad; zero without.
        branch
            See :func:`offline_ik.inverse.branches.parse_choice`.
        direction
            ``(n,)``: the intended direction of approach of each joint, ±1 or 0 where unknown; ``moved``: as the joints
            move straight from ``near``.
        nearest
            Whether to look for the nearest position that can be reached, where the asked one cannot.

        Raises
        ------
        TargetError
            The coordinates, the posture at hand or the directions cannot be meant.
        """
        choice, direction = parse_choice(branch) if isinstance(branch, str) else branch, self._sides(direction)
        here, quick = self._quickly(gamma, delta, r, roll, near, choice, direction)
        if quick is not None:
            first = quick.solutions[0]
            if not _wanders(first):
                return quick
            return quick._replace(solutions=(self._beside(quick.target, first, here, direction),))
        reasons: Reasons = {}
        rolls = [roll] if roll is not None else rolls_to_try(self, (gamma, delta, r), here, choice, direction)
        for turned in rolls:
            target = detector_pose(self.cell.convention, gamma, delta, r, turned)
            key = effort if roll is None else None
            found = self._solutions(target, turned, here, choice, direction, reasons, key)
            if found:
                return self._answer((gamma, delta, r, roll), target, tuple(found))
        target = detector_pose(self.cell.convention, gamma, delta, r, roll or 0.0)
        closest = nearest_reachable(self, target, roll) if nearest else None
        return self._answer((gamma, delta, r, roll), target, (), tuple(reasons), closest)

    def at_once(
        self,
        gamma: float,
        delta: float,
        r: float,
        roll: float | None = 0.0,
        *,
        near: Sequence[float] | Array | None = None,
        branch: Choice | str = "nearest",
        direction: Direction = None,
    ) -> Answer | None:
        """As :meth:`locate`, if one call of a kernel has the answer; else None.

        Raises
        ------
        TargetError
            As for :meth:`locate`.
        """
        choice, direction = parse_choice(branch) if isinstance(branch, str) else branch, self._sides(direction)
        _, quick = self._quickly(gamma, delta, r, roll, near, choice, direction)
        return None if quick is None or _wanders(quick.solutions[0]) else quick

    def _sides(self, asked: Direction) -> Direction:
        if asked is None or (isinstance(asked, str) and asked == "moved"):
            return asked
        return check_directions(self.arm.n, asked)

    def _quickly(
        self,
        gamma: float,
        delta: float,
        r: float,
        roll: float | None,
        near: Sequence[float] | Array | None,
        choice: Choice,
        direction: Direction,
    ) -> tuple[Array, Answer | None]:
        """The posture at hand ``(n,)``, and what one call of a kernel finds nearest to it, or None."""
        check_target(gamma, delta, r, 0.0 if roll is None else roll)
        here = self.rest if near is None else self.check_posture(near)
        if choice.kind != "nearest" or roll is None or self.parts.nearest is None:
            return here, None
        asked = (gamma, delta, r, roll)
        quick = self.parts.nearest.locate(asked, here, direction, self._still_vector)
        if quick is None:
            return here, None
        return here, self._answer(asked, quick[0], (self._told_outside(self.parts.nearest, quick[1]),))

    def _answer(
        self,
        asked: tuple[float, float, float, float | None],
        target: Array,
        solutions: tuple[Solution, ...],
        reasons: tuple[str, ...] = (),
        nearest: dict[str, float] | None = None,
    ) -> Answer:
        gamma, delta, r, roll = asked
        names = {"gamma_rad": gamma, "delta_rad": delta, "r_m": r, "roll_rad": roll}
        return Answer(names, target, solutions, reasons, nearest, self._said[0], self._said[1])

    @cached_property
    def _said(self) -> tuple[dict[str, Any], dict[str, Any]]:
        return self.cell.convention.to_json(), self.cell.to_json()

    @property
    def twin(self) -> Detector:
        """The same with kernels of its own, ready to be used by another thread: those of one may not be shared."""
        if self.parts.twin is None:
            first = Detector(self.arm, self.cell)
            first.warm_up()
            self.parts.twin = first.parts
        return Detector(self.arm, self.cell, self.parts.twin)

    @property
    def framing(self) -> Framing:
        """Makes the frames that a controller writes."""
        return self.parts.framing

    @property
    def looking(self) -> Kernel:
        """See :func:`offline_ik.inverse.kernels.looking_kernel`."""
        return self.parts.looking

    @cached_property
    def _still_vector(self) -> Array:
        return self.still.vector

    def _solutions(
        self,
        pose: Array,
        roll: float,
        here: Array,
        choice: Choice,
        direction: Direction,
        reasons: Reasons,
        key: Callable[[Array, Array], Array] | None = None,
    ) -> list[Solution]:
        base = self.to_base(pose)
        found: list[Solution] = []
        for q, direct in self.search.find(base, here, direction, self.still, reasons):
            if not choice.allows(self.solver.ortho, self.solver.linkage @ q):
                reasons["no branch of those asked for leads there"] = None
                continue
            if any(np.abs(q - other.q).max() < 1e-7 for other in found):
                continue
            found.append(self._solution(q, base, roll, here, replace(self.still, direction=direct)))
        found.sort(key=(lambda s: s.distance) if key is None else lambda s: key(s.q, here))
        return found if choice.kind == "all" else found[:1]

    def _solution(self, q: Array, base: Array, roll: float, here: Array, conditions: Conditions) -> Solution:
        error = self.solver.residual(base, q, conditions)
        chain = self.solver.linkage @ q
        status, turn = status_and_turn(self.solver.ortho, chain)
        return Solution(
            q,
            self.motor(q),
            float(np.linalg.norm(error[:3])),
            float(np.linalg.norm(error[3:])),
            self.propagation.at(q, conditions, self.towards(base, roll)),
            roll,
            self.search.singular(base, chain, self.still),
            status,
            turn,
            float(np.abs(q - here).max()),
            conditions.direction,
            self._extrapolating(q),
        )

    def _beside(self, target: Array, first: Solution, here: Array, direction: Direction) -> Solution:
        """At a singular pose ``(4, 4)`` the posture nearest to ``here``: the branches are not all that there is."""
        base, conditions = self.to_base(target), replace(self.still, direction=first.direction)
        found = self.search.nearer(base, first.q, first.q, here, direction, conditions)
        if found is None or found[0] is first.q:
            return first
        return self._solution(found[0], base, first.roll, here, replace(conditions, direction=found[1]))

    def _told_outside(self, nearest: Nearest, solution: Solution) -> Solution:
        """The solution that was just located, with doubt added where it is outside the identified ranges."""
        outside, beyond = self.propagation.outside, self._extrapolating(solution.q)
        if outside is None or not beyond:
            return solution
        uncertainty = solution.uncertainty
        if outside.widens(beyond):
            more = outside.widening(nearest.by_doubted(), solution.q, self.still.link_temperature)
            uncertainty = uncertainty._replace(covariance=uncertainty.covariance + more)
        return solution._replace(extrapolating=beyond, uncertainty=uncertainty)

    def _extrapolating(self, q: Array) -> tuple[Beyond, ...]:
        """What is beyond that on which the model was identified."""
        outside = self.propagation.outside
        return () if outside is None else outside.posture(q) + self._surroundings

    @cached_property
    def _surroundings(self) -> tuple[Beyond, ...]:
        outside = self.propagation.outside
        return () if outside is None else outside.surroundings(self.cell.link_temperature)

    @property
    def propagation(self) -> Propagation:
        """From the model's covariance to the detector's."""
        return self.parts.propagation

    def towards(self, base: Array, roll: float) -> Array:
        """Columns: across and up of the detector as the circles carry it (at roll 0), outward; in the base's axes."""
        c, s = math.cos(roll), math.sin(roll)
        x, y, z = base[:3, 0], base[:3, 1], base[:3, 2]
        return np.column_stack([-s * x - c * y, s * y - c * x, -z])


def _wanders(solution: Solution) -> bool:
    """Whether the posture of a singular pose is far from the one at hand, so that others may be nearer."""
    return bool(solution.singular) and solution.distance >= STAYED
