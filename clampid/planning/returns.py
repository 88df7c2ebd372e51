"""Plans that measure repeatability of a robot or an instrument: the cycles of ISO 9283, a line, one fixed point.

**ISO 9283.** Five poses lie in a plane through two opposite edges of a cube: P1 in its centre, P2 … P5 on the plane's
diagonals, a tenth of a diagonal from their ends. A cycle is P1, P5, P4, P3, P2, always in this order, so every pose is
approached from one side. Thirty cycles give AP and RP. Source: ISO 9283:1998, 6.8.1, 6.8.2 and 7.2.

**Line.** Stops have equal distances on a straight line, out and back. Each stop is approached along the line, from one
side on the way out and from the other on the way back, or always from the side of the way out. All joints move
synchronously, so the path is only nearly straight, and the last move to a stop starts beside the line. The plan reports
the largest distance of the target from the line.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from clampid.planning.scene import Scene
from clampid.planning.visiting import Approach, Stop, approach_signs, path_through, plan_of_visits, visits_of
from clampid.stages.rows import Array
from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits
from experiments.plans.model import Cell, Plan
from kinematics.poe import forward

__all__ = ["PLANES", "Cube", "ReturnWishes", "line_deviation", "plan_cube", "plan_fixed", "plan_line"]

PLANES = {"a": (0, 1, 6, 7), "b": (1, 2, 7, 4), "c": (2, 3, 4, 5), "d": (3, 0, 5, 6)}
"""Plane → indices of its corners, in order around it; indices 0 … 7 are C1 … C8 of the standard."""

CORNERS = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1], [-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1]])
DISTANCE_FROM_END = 0.1  # of P2 … P5 from the ends of a diagonal, as a share of its length
CYCLE = (1, 5, 4, 3, 2)
MAX_VISITS = 20_000
POINTS_BETWEEN = 9  # points of a move at which its distance from the line is computed


@dataclass(frozen=True)
class ReturnWishes:
    """The wishes that all plans of repeated visits share.

    Attributes
    ----------
    z_axis
        Direction of the flange's z axis ``(3,)``, base frame.
    targets
        Names of the targets to measure; the first one is brought to the places.
    one_side
        Whether a pose is approached from the same side at each visit.
    approach
        The last move to a pose.
    measure_time
        Time for each target, s.
    """

    z_axis: Array
    targets: tuple[str, ...]
    one_side: bool = False
    approach: Approach = field(default_factory=Approach)
    measure_time: float = 3.0

    def point(self, cell: Cell) -> Array:
        """The first target ``(3,)``, m, flange frame, which is brought to the places.

        Raises
        ------
        PlanError
            The cell does not have a target, or none or the same one is named twice.
        """
        for name in self.targets:
            if name not in cell.targets:
                raise PlanError(f"targets: expected some of {', '.join(cell.targets)}, found {name!r}")
        if not self.targets or len(set(self.targets)) < len(self.targets):
            raise PlanError("targets: expected one or more different ones")
        return np.asarray(cell.targets[self.targets[0]], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Cube:
    """The cube of ISO 9283: centre ``(3,)`` and edge, m, base frame, and the plane of the poses (``a`` … ``d``)."""

    centre: Array
    edge: float
    plane: str = "a"

    def check(self) -> None:
        """Check edge and plane.

        Raises
        ------
        PlanError
            The edge is not above 0, or the plane is unknown.
        """
        if not self.edge > 0.0 or not np.isfinite(self.edge):
            raise PlanError(f"cube: expected an edge above 0 m, found {self.edge:g}")
        if self.plane not in PLANES:
            raise PlanError(f"plane: expected one of {', '.join(PLANES)}, found {self.plane!r}")


def plan_cube(
    cell: Cell, limits: Limits, scene: Scene, wanted: ReturnWishes, cube: Cube, *,
    cycles: int = 30, assumed: tuple[str, ...] = (),
) -> Plan:  # fmt: skip
    """Plan the cycles of ISO 9283 through five poses of a cube with edges along the base's axes.

    Parameters
    ----------
    cell, limits, scene
        The cell, its limits and its obstacles.
    wanted
        Wishes for targets and approaches.
    cube
        The cube.
    cycles
        Number of cycles.
    assumed
        Assumptions made so far, in words.

    Raises
    ------
    PlanError
        A number is out of range, or a pose is out of reach.
    """
    _count("cycles", cycles, 1, 5 * cycles)
    cube.check()
    wanted.approach.check()
    centre = cube.centre
    corners = centre + cube.edge / 2 * CORNERS[list(PLANES[cube.plane])]
    places = np.vstack([centre, corners + 2 * DISTANCE_FROM_END * (centre - corners)])
    q = path_through(cell, limits, scene, places, wanted.z_axis, wanted.point(cell), 1.5 * wanted.approach.angle)
    stops = []
    for cycle in range(cycles):
        for number, before in zip(CYCLE, (CYCLE[-1], *CYCLE[:-1]), strict=True):
            sides = approach_signs(q[number - 1], q[before - 1])
            flip = -1.0 if cycle % 2 and not wanted.one_side else 1.0
            via = q[number - 1] - flip * wanted.approach.angle * sides
            stops.append(Stop(number, q[number - 1], via, wanted.targets))
    record: dict[str, float | int | str] = {
        "program": "iso9283",
        "plane": cube.plane,
        "edge_m": cube.edge,
        "cycles": cycles,
    }
    visits = visits_of(cell, limits, scene, stops, wanted.approach)
    return plan_of_visits(cell, limits, visits, wanted.measure_time, record | _record(wanted), assumed)


def plan_line(
    cell: Cell, limits: Limits, scene: Scene, wanted: ReturnWishes, ends: Array, *,
    stops: int = 24, repetitions: int = 200, assumed: tuple[str, ...] = (),
) -> Plan:  # fmt: skip
    """Plan stops on a straight line, out and back.

    Visits with odd numbers are on the way out. The two ends are also visited once in each direction.

    Parameters
    ----------
    cell, limits, scene
        The cell, its limits and its obstacles.
    wanted
        Wishes for targets and approaches.
    ends
        Ends of the line ``(2, 3)``, m, base frame.
    stops
        Number of stops.
    repetitions
        Number of times out and back.
    assumed
        Assumptions made so far, in words.

    Raises
    ------
    PlanError
        A number is out of range, or a place is out of reach.
    """
    if stops < 2:
        raise PlanError(f"stops: expected 2 or more, found {stops}")
    _count("repetitions", repetitions, 1, 2 * stops * repetitions)
    if not np.linalg.norm(ends[1] - ends[0]) > 0.0:
        raise PlanError("line: expected two different ends, found one place")
    wanted.approach.check()
    places = ends[0] + np.linspace(0.0, 1.0, stops)[:, None] * (ends[1] - ends[0])
    q = path_through(cell, limits, scene, places, wanted.z_axis, wanted.point(cell), 1.5 * wanted.approach.angle)
    out = np.array([approach_signs(q[max(k, 1)], q[max(k, 1) - 1]) for k in range(stops)])
    made = []
    for _ in range(repetitions):
        for back in (False, True):
            for k in range(stops)[:: -1 if back else 1]:
                side = -out[k] if back and not wanted.one_side else out[k]
                made.append(Stop(k + 1, q[k], q[k] - wanted.approach.angle * side, wanted.targets))
    record: dict[str, float | int | str] = {"program": "line", "stops": stops, "repetitions": repetitions}
    visits = visits_of(cell, limits, scene, made, wanted.approach)
    return plan_of_visits(cell, limits, visits, wanted.measure_time, record | _record(wanted), assumed)


def plan_fixed(
    cell: Cell, limits: Limits, scene: Scene, wanted: ReturnWishes, posture: Array, *,
    readings: int = 30, pause: float = 0.0, assumed: tuple[str, ...] = (),
) -> Plan:  # fmt: skip
    """Plan repeated readings with the robot at rest, which show the repeatability of the instrument alone.

    Parameters
    ----------
    cell, limits, scene
        The cell, its limits and its obstacles.
    wanted
        Wishes for targets and approach.
    posture
        Joint angles ``(n,)``, rad.
    readings
        Number of readings.
    pause
        Time between readings, s.
    assumed
        Assumptions made so far, in words.

    Raises
    ------
    PlanError
        A number is out of range.
    """
    _count("readings", readings, 2, readings)
    if not 0.0 <= pause < 86400.0:
        raise PlanError(f"pause: expected seconds from 0 to 86400, found {pause:g}")
    wanted.approach.check()
    wanted.point(cell)
    via = posture - wanted.approach.angle
    stops = [Stop(1, posture, posture if k else via, wanted.targets, wait=pause if k else 0.0) for k in range(readings)]
    record: dict[str, float | int | str] = {"program": "fixed point", "readings": readings, "pause_s": pause}
    visits = visits_of(cell, limits, scene, stops, wanted.approach)
    return plan_of_visits(cell, limits, visits, wanted.measure_time, record, assumed)


def line_deviation(plan: Plan, target: str) -> tuple[float, float]:
    """Largest distances of a target from the straight line, m.

    Returns
    -------
    between, travelled
        On direct moves between neighbouring stops, from the line through these; and on the moves of the plan, which
        pass the start of each approach, from the line through the ends.
    """
    robot, point = plan.cell.robot, plan.cell.targets[target]

    def off(corners: Array, first: Array, last: Array) -> float:
        """Distance of moves through ``corners`` ``(k, n)`` from the line through two stops ``(n,)``, rad."""
        share = np.linspace(0.0, 1.0, POINTS_BETWEEN)[:, None]
        ways = [before + share * (after - before) for before, after in pairwise(corners)]
        q = np.vstack([first, last, *ways])
        T = forward(robot.screws, robot.flange, q @ np.asarray(robot.linkage).T)
        p = T[:, :3, :3] @ point + T[:, :3, 3] - (T[0, :3, :3] @ point + T[0, :3, 3])
        along = p[1] / np.linalg.norm(p[1])
        return float(np.linalg.norm(p - (p @ along)[:, None] * along, axis=1).max())

    stops = {visit.pose: visit.q for visit in plan.visits}
    ends = stops[min(stops)], stops[max(stops)]
    between = max(off(np.array([stops[a], stops[b]]), stops[a], stops[b]) for a, b in pairwise(sorted(stops)))
    once = plan.visits[: 2 * len(stops)]  # out and back once; all repetitions are the same
    travelled = [off(np.array([a.q, b.via, b.q]), *ends) for a, b in pairwise(once)]
    return between, max(travelled, default=between)


def _count(what: str, value: int, least: int, visits: int) -> None:
    """Raise :class:`PlanError` if ``value`` is too small or leads to too many visits."""
    if value < least or visits > MAX_VISITS:
        raise PlanError(f"{what}: expected {least} or more and at most {MAX_VISITS} visits, found {value}")


def _record(wanted: ReturnWishes) -> dict[str, float | int | str]:
    """The wishes, as the plan records them."""
    record: dict[str, float | int | str] = {
        "targets": ", ".join(wanted.targets),
        "approach_rad": wanted.approach.angle,
        "from": "one side" if wanted.one_side else "both sides",
        "speed": wanted.approach.share,
    }
    return record if wanted.approach.seconds is None else record | {"last_move_s": wanted.approach.seconds}
