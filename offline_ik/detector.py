"""From (gamma, delta, r) to joint and motor angles on one particular robot, or the reason why not.

The public face of this layer: :class:`Detector` is a model in a cell; :meth:`Detector.locate` answers one position.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from clampid.model import Model, load_model
from kinematics.description import load_robot
from kinematics.robot import RobotDescription
from offline_ik.arm import REFERENCE_TEMPERATURE, Conditions, IdentifiedArm, arm_of
from offline_ik.branches import Choice, candidate_turns, parse_choice, status_and_turn
from offline_ik.cell import Cell, default_cell, read_cell
from offline_ik.coordinates import check_target, detector_pose
from offline_ik.errors import TargetError
from offline_ik.kernels import Kernel, locate_kernel
from offline_ik.mount import identified_mount
from offline_ik.ortho import SIGNS
from offline_ik.reach import nearest_reachable
from offline_ik.solver import ELBOW_SINGULAR, NEARLY, WRIST_SINGULAR, Solver
from offline_ik.uncertainty import Propagation, Uncertainty

__all__ = ["Answer", "Detector", "Solution", "open_detector"]

Array = npt.NDArray[np.float64]

ROLLS = 24  # tried where the roll is free
SHOULDER_SINGULAR = 0.02  # m: the wrist this near to axis 1


@dataclass(frozen=True)
class Solution:
    """One posture that puts the detector there.

    Attributes
    ----------
    q, motor
        ``(n,)``, rad: what to command at the joints, and at the motors.
    position_error, angle_error
        What the identified model has left to the asked pose, m and rad.
    roll
        The detector's roll about its normal, rad.
    singular
        Which of ``wrist``, ``elbow``, ``shoulder`` are near a singularity.
    status, turn
        KUKA's bits.
    distance
        The largest joint move from the posture at hand, rad.
    """

    q: Array
    motor: Array
    position_error: float
    angle_error: float
    uncertainty: Uncertainty
    roll: float
    singular: tuple[str, ...]
    status: int
    turn: int
    distance: float
    direction: Array

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "q_rad": self.q.tolist(),
            "motor_rad": self.motor.tolist(),
            "position_error_m": self.position_error,
            "angle_error_rad": self.angle_error,
            "std_m": self.uncertainty.std_m,
            "std_rad": self.uncertainty.std_rad,
            "uncertainty": self.uncertainty.to_json(),
            "roll_rad": self.roll,
            "singular": list(self.singular),
            "status": self.status,
            "turn": self.turn,
            "largest_move_rad": self.distance,
            "approach_direction": self.direction.tolist(),
        }


@dataclass(frozen=True)
class Answer:
    """What became of one asked position.

    Attributes
    ----------
    target
        ``(4, 4)``: the asked pose in the convention's frame (at the first solution's roll, where that is free).
    reasons
        Why there is no solution, branch by branch put together.
    nearest
        The nearest detector position that can be reached, where the asked one cannot: gamma, delta, r, how far off.
    """

    asked: dict[str, float | None]
    target: Array
    solutions: tuple[Solution, ...]
    reasons: tuple[str, ...]
    nearest: dict[str, float] | None
    convention: dict[str, Any]
    cell: dict[str, Any]

    @property
    def reachable(self) -> bool:
        """Whether there is any solution."""
        return bool(self.solutions)

    def to_json(self) -> dict[str, Any]:
        """The JSON of ``clampid ik``."""
        return {
            "reachable": self.reachable,
            "solutions": [s.to_json() for s in self.solutions],
            "reasons": list(self.reasons),
            "nearest": self.nearest,
            "asked": self.asked,
            "detector_position_m": self.target[:3, 3].tolist(),
            "detector_rotation": self.target[:3, :3].tolist(),
            "convention": self.convention,
            "cell": self.cell,
        }


class Detector:
    """A detector on an identified arm in a cell.

    Parameters
    ----------
    arm, cell
        Of the same robot.

    Raises
    ------
    CellError
        The sample lies in an obstacle or in the robot's base, or the cell's targets are not the model's.
    """

    def __init__(self, arm: IdentifiedArm, cell: Cell) -> None:
        self.arm, self.cell = arm, cell
        self.robot: RobotDescription = arm.robot
        self.solver = Solver(arm, identified_mount(cell, arm))
        self.lower = self.robot.lower + cell.limit_margin
        self.upper = self.robot.upper - cell.limit_margin
        self.rest = np.clip(np.zeros(arm.n), self.lower, self.upper)
        from offline_ik.safety import check_sample

        check_sample(self)

    def warm_up(self) -> None:
        """Compile what the first answer would otherwise have to wait for."""
        self.solver.pose(self.rest, self.still)
        near = self.pose(self.rest[None])[0]
        self.solver.solve(self.to_base(near)[None], self.rest[None], self.solver.signs(self.rest), self.still)
        self.propagation.jacobian(self.rest, self.still)
        if self.solver.analytic is not None:
            self.solver.branches(near[None])
        self._quick((0.0, 0.0, 1.0, 0.0), self.rest, None)

    @cached_property
    def still(self) -> Conditions:
        """The cell's temperatures, and no direction of approach known."""
        n, cell = self.arm.n, self.cell

        def above(value: Array | None) -> Array:
            return np.zeros(n) if value is None else np.asarray(value - REFERENCE_TEMPERATURE)

        return Conditions(np.zeros(n), above(cell.link_temperature), above(cell.motor_temperature))

    def at_temperature(self, link: Array | None = None, motor: Array | None = None) -> Detector:
        """The same at other temperatures ``(n,)``, °C."""
        out = object.__new__(Detector)
        out.__dict__.update(self.__dict__)
        for derived in ("still", "_still_vector", "_said"):
            out.__dict__.pop(derived, None)
        out.cell = replace(
            self.cell,
            link_temperature=self.cell.link_temperature if link is None else link,
            motor_temperature=self.cell.motor_temperature if motor is None else motor,
        )
        return out

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
        return np.asarray(q @ self._to_motor)

    def check_posture(self, q: Sequence[float] | Array, what: str = "near") -> Array:
        """A posture as an array.

        Raises
        ------
        TargetError
            Not as many finite numbers as there are joints, or far beyond the limits (degrees?).
        """
        found = np.asarray(q, dtype=float)
        if found.shape != (self.arm.n,):
            raise TargetError(f"{what}: expected {self.arm.n} joint angles, found {list(q)}")
        largest = max(map(abs, found.tolist()))
        if not np.isfinite(found).all():
            raise TargetError(f"{what}: expected {self.arm.n} finite joint angles, found {list(q)}")
        if largest > 3 * math.pi:
            raise TargetError(f"{what}: expected joint angles in radians, found {found.tolist()}; are these degrees?")
        return found

    def locate(
        self,
        gamma: float,
        delta: float,
        r: float,
        roll: float | None = 0.0,
        *,
        near: Sequence[float] | Array | None = None,
        branch: Choice | str = "nearest",
        direction: Array | Literal["moved"] | None = None,
    ) -> Answer:
        """Joint and motor angles for a detector position.

        Parameters
        ----------
        gamma, delta, r
            rad, rad, m, in the cell's convention.
        roll
            About the detector's normal, rad; None: free, the one that moves the joints least.
        near
            ``(n,)``: the posture at hand, rad; zero without.
        branch
            See :func:`offline_ik.branches.parse_choice`.
        direction
            ``(n,)``: the intended direction of approach of each joint, ±1 or 0 where unknown; ``moved``: as the joints
            move straight from ``near``.

        Raises
        ------
        TargetError
            The coordinates cannot be meant.
        """
        check_target(gamma, delta, r, 0.0 if roll is None else roll)
        choice = parse_choice(branch) if isinstance(branch, str) else branch
        here = self.rest if near is None else self.check_posture(near)
        if choice.kind == "nearest" and roll is not None:
            quick = self._quick((gamma, delta, r, roll), here, direction)
            if quick is not None:
                return self._answer((gamma, delta, r, roll), quick[0], (quick[1],))
        rolls = np.array([roll]) if roll is not None else np.arange(ROLLS) * (2 * np.pi / ROLLS) - np.pi
        poses = detector_pose(self.cell.convention, gamma, delta, r, np.asarray(rolls, dtype=np.float64))
        found: list[Solution] = []
        reasons: dict[str, None] = {}
        order = self._order(poses, here) if roll is None else [0]
        for k in order:
            found = self._solutions(poses[k], float(rolls[k]), here, choice, direction, reasons)
            if found:
                break
        target = poses[order[0]] if not found else detector_pose(
            self.cell.convention, gamma, delta, r, found[0].roll)  # fmt: skip
        nearest = None
        if not found:
            nearest = nearest_reachable(self, poses[order[0]], 0.0 if roll is None else roll)
        return self._answer((gamma, delta, r, roll), target, tuple(found), tuple(reasons) if not found else (), nearest)

    def _answer(
        self,
        asked: tuple[float, float, float, float | None],
        target: Array,
        solutions: tuple[Solution, ...],
        reasons: tuple[str, ...] = (),
        nearest: dict[str, float] | None = None,
    ) -> Answer:
        names = dict(zip(("gamma_rad", "delta_rad", "r_m", "roll_rad"), asked, strict=True))
        return Answer(names, target, solutions, reasons, nearest, self._said[0], self._said[1])

    @cached_property
    def _said(self) -> tuple[dict[str, Any], dict[str, Any]]:
        return self.cell.convention.to_json(), self.cell.to_json()

    @cached_property
    def _kernel(self) -> Kernel | None:
        ortho = self.solver.ortho
        if ortho is None:
            return None
        return locate_kernel(
            self.arm, ortho, self.solver.mount, self.lower, self.upper, self.cell.convention, self.propagation.mount
        )

    def _quick(
        self, asked: tuple[float, float, float, float], here: Array, direction: Array | Literal["moved"] | None
    ) -> tuple[Array, Solution] | None:
        """Target and nearest solution by the one compiled kernel; None where that is not the whole story."""
        kernel, n = self._kernel, self.arm.n
        if kernel is None:
            return None
        row = kernel.row
        row[:4] = asked
        row[4] = isinstance(direction, str)
        row[5 : 5 + n] = here
        row[5 + n :] = self._still_vector
        if direction is not None and not isinstance(direction, str):
            row[5 + n : 5 + 2 * n] = np.sign(direction)
        kernel.trigger()
        first = kernel.out[0].copy()
        error, told = first[16 + 2 * n : 22 + 2 * n].tolist(), first[-5:].tolist()
        if told[0] < 0:
            return None
        q = first[16 : 16 + n]
        status, turn = status_and_turn(self.solver.ortho, self.solver.linkage @ q, int(told[0]))
        return first[:16].reshape(4, 4), Solution(
            q,
            first[16 + n : 16 + 2 * n],
            math.hypot(*error[:3]),
            math.hypot(*error[3:]),
            self.propagation.combined(kernel.out[1].reshape(6, -1), kernel.out[2].reshape(n, 6)),
            asked[3],
            self._names(told[1], told[3], -told[2]),
            status,
            turn,
            told[4],
            first[22 + 2 * n : 22 + 3 * n],
        )

    def _names(self, wrist: float, elbow: float, shoulder: float) -> tuple[str, ...]:
        """What is singular: by |sin| of the wrist's angle, joint 3 of the chain, the wrist's distance from axis 1."""
        ortho = self.solver.ortho
        found = ["wrist"] if wrist < WRIST_SINGULAR else []
        if ortho is not None and abs(math.sin(elbow - ortho.stretched)) < ELBOW_SINGULAR:
            found.append("elbow")
        if shoulder < SHOULDER_SINGULAR:
            found.append("shoulder")
        return tuple(found)

    @cached_property
    def _still_vector(self) -> Array:
        return self.still.vector

    @cached_property
    def _to_motor(self) -> Array:
        return np.linalg.inv(np.asarray(self.robot.transmission))

    def _order(self, poses: Array, here: Array) -> list[int]:
        """Free rolls, those that move the joints least first."""
        base = np.array([self.to_base(p) for p in poses])
        if self.solver.analytic is None:
            return list(range(len(poses)))
        q, quality = self.solver.branches(base, here)
        fits = (quality[..., :2] <= 0).all(axis=2) & ((q >= self.lower) & (q <= self.upper)).all(axis=2)
        cost = np.where(fits, np.abs(q - here).max(axis=2), np.inf).min(axis=1)
        return [int(k) for k in np.argsort(cost, kind="stable")]

    def _solutions(
        self,
        pose: Array,
        roll: float,
        here: Array,
        choice: Choice,
        direction: Array | Literal["moved"] | None,
        reasons: dict[str, None],
    ) -> list[Solution]:
        base = self.to_base(pose)
        found: list[Solution] = []
        for q, direct in self._postures(base, here, direction, reasons):
            if not choice.allows(self.solver.ortho, self.solver.linkage @ q):
                reasons["no branch of those asked for leads there"] = None
                continue
            if any(np.abs(q - other.q).max() < 1e-7 for other in found):
                continue
            found.append(self._solution(q, base, roll, here, replace(self.still, direction=direct)))
        found.sort(key=lambda s: s.distance)
        return found if choice.kind == "all" else found[:1]

    def _postures(
        self, base: Array, here: Array, direction: Array | Literal["moved"] | None, reasons: dict[str, None]
    ) -> list[tuple[Array, Array]]:
        """Postures within limits on the identified model, with the directions that they were solved for."""
        starts = self._starts(base, here, reasons)
        out = []
        for start, signs in starts:
            near = start
            given = self._direction(direction, start, here)
            solved = self.solver.solve(base[None], near[None], signs[None], replace(self.still, direction=given))
            if not solved.reached[0]:
                reasons["beyond the reach of the identified arm" if self.solver.ortho else
                        "no posture was found: out of reach, or nearly"] = None  # fmt: skip
                continue
            q = candidate_turns(solved.q[0], start, self.lower, self.upper)
            if q is None:
                reasons[self._limits(solved.q[0])] = None
                continue
            if np.abs(q - solved.q[0]).max() > 1e-9:  # another turn: solved again, since ratios may be off
                again = self.solver.solve(base[None], q[None], signs[None], replace(self.still, direction=given))
                q = again.q[0]
                if not again.reached[0] or (q < self.lower).any() or (q > self.upper).any():
                    reasons[self._limits(q)] = None
                    continue
            out.append((q, given))
        return out

    def _starts(self, base: Array, here: Array, reasons: dict[str, None]) -> list[tuple[Array, Array]]:
        if self.solver.analytic is None:
            rng = np.random.default_rng(0)
            low, high = np.clip(self.lower, -np.pi, np.pi), np.clip(self.upper, -np.pi, np.pi)
            return [(start, np.ones(3)) for start in (here, *rng.uniform(low, high, (ROLLS, len(here))))]
        q, quality = self.solver.branches(base[None], here)
        out = []
        for branch, lacks, signs in zip(q[0], quality[0], SIGNS, strict=True):
            if lacks[0] > NEARLY:
                reasons[f"the wrist would be {1e3 * lacks[0]:.0f} mm too near to axis 1"] = None
                continue
            if lacks[1] > NEARLY:
                reasons[f"out of reach by {1e3 * lacks[1]:.0f} mm"] = None
                continue
            turned = candidate_turns(branch, here, self.lower - 0.05, self.upper + 0.05)
            if turned is None:
                reasons[self._limits(branch)] = None
                continue
            out.append((turned, signs))
        return out

    def _direction(self, direction: Array | Literal["moved"] | None, start: Array, here: Array) -> Array:
        if direction is None:
            return np.zeros(self.arm.n)
        if isinstance(direction, str):
            return np.sign(start - here)
        return np.asarray(np.sign(np.asarray(direction, dtype=float)))

    def _limits(self, q: Array) -> str:
        """The joints whose limits no turn keeps."""
        beyond = []
        for i, joint in enumerate(self.robot.joints):
            one = slice(i, i + 1)
            if candidate_turns(q[one], q[one], self.lower[one], self.upper[one]) is None:
                beyond.append(joint.name)
        return f"beyond the limits of {', '.join(beyond)}" if beyond else "at the limits"

    def _solution(self, q: Array, base: Array, roll: float, here: Array, conditions: Conditions) -> Solution:
        error = self.solver.residual(base, q, conditions)
        chain = self.solver.linkage @ q
        status, turn = status_and_turn(self.solver.ortho, chain)
        return Solution(
            q,
            self.motor(q),
            float(np.linalg.norm(error[:3])),
            float(np.linalg.norm(error[3:])),
            self.propagation.at(q, conditions, self._towards(base, roll)),
            roll,
            self._singular(base, chain),
            status,
            turn,
            float(np.abs(q - here).max()),
            conditions.direction,
        )

    @cached_property
    def propagation(self) -> Propagation:
        """From the model's covariance to the detector's."""
        return Propagation(self.solver, self.cell)

    def _towards(self, base: Array, roll: float) -> Array:
        """Columns: across and up of the detector as the circles carry it (at roll 0), outward; in the base's axes."""
        c, s = math.cos(roll), math.sin(roll)
        x, y, z = base[:3, 0], base[:3, 1], base[:3, 2]
        return np.column_stack([-s * x - c * y, s * y - c * x, -z])

    def _singular(self, base: Array, chain: Array) -> tuple[str, ...]:
        ortho = self.solver.ortho
        if ortho is None:
            J = self.solver.forward.one(np.r_[self.solver.unlinked @ chain, self.still.vector])[2].reshape(6, -1)
            return ("singular",) if np.linalg.svd(J, compute_uv=False)[-1] < WRIST_SINGULAR else ()
        _, quality = self.solver.branches(base[None], chain)
        return self._names(abs(math.sin(chain[4] + ortho.psi)), float(chain[2]), -float(quality[0, 0, 0]))


def open_detector(
    model: Model | str | Path,
    cell: Cell | str | Path | None = None,
    *,
    robot: RobotDescription | str | Path | None = None,
    user_effects: Path | None = None,
) -> Detector:
    """A model in a cell.

    Parameters
    ----------
    model
        A model or the path of its file.
    cell
        A cell or the path of its file; without one, the placeholder of :func:`offline_ik.cell.default_cell`.
    robot
        The nominal robot, where it is not a bundled one.

    Raises
    ------
    ModelError, DescriptionError, CellError
        One of them cannot be read, or they do not fit each other.
    """
    loaded = model if isinstance(model, Model) else load_model(model)
    described = robot if isinstance(robot, RobotDescription) else load_robot(robot or loaded.robot)
    cell = default_cell(described) if cell is None else cell
    placed = cell if isinstance(cell, Cell) else read_cell(cell, described)
    arm = arm_of(
        loaded,
        robot=described,
        gravity=placed.gravity,
        tool_mass=placed.tool_mass,
        tool_com=placed.tool_com,
        session=placed.session,
        user_effects=user_effects,
    )
    return Detector(arm, placed)
