"""Programs that show how well a robot, or an instrument, repeats: ISO 9283's cycles, a line, one fixed point.

**ISO 9283.** Five poses in a plane through two opposite edges of a cube: P1 in its centre, P2 … P5 on the plane's
diagonals, a tenth of a diagonal away from their ends. A cycle is P1, P5, P4, P3, P2, always in this order, so that
every pose is approached from one side. Thirty cycles give AP and RP. Source: ISO 9283:1998, 6.8.1, 6.8.2 and 7.2.

**Line.** Stops at equal distances on a straight line, out and back. Each stop is approached along the line, from one
side on the way out and from the other on the way back; or always from the side of the way out. Joints move in step, so
that the path is only nearly straight, and the last move to a stop begins beside the line. The plan reports how far the
target is off the line.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from clampid.planning.scene import Scene
from clampid.planning.visiting import Approach, Stop, finished, path_through, sides_along, visits_of
from clampid.stages.rows import Array
from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits
from experiments.plans.model import Cell, Plan
from kinematics.poe import forward

__all__ = ["PLANES", "Cube", "Returns", "off_line", "plan_cube", "plan_fixed", "plan_line"]

PLANES = {"a": (0, 1, 6, 7), "b": (1, 2, 7, 4), "c": (2, 3, 4, 5), "d": (3, 0, 5, 6)}
"""Corners of the cube in each plane, in order around it: C1 … C8 of the standard, from 0."""

CORNERS = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1], [-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1]])
FROM_END = 0.1  # of a diagonal
CYCLE = (1, 5, 4, 3, 2)
MOST_VISITS = 20_000
PLACES_BETWEEN = 9  # places looked at between two stops


@dataclass(frozen=True)
class Returns:
    """The wishes that all such programs share.

    Attributes
    ----------
    way
        ``(3,)``, base frame: where the flange's z axis looks.
    targets
        Which targets are measured; the first one is brought to the places.
    one_side
        Every pose is approached from the same side, each time.
    approach
        The last move.
    measure_time
        s for each target.
    """

    way: Array
    targets: tuple[str, ...]
    one_side: bool = False
    approach: Approach = field(default_factory=Approach)
    measure_time: float = 3.0

    def point(self, cell: Cell) -> Array:
        """What is brought to the places ``(3,)`` m, flange frame.

        Raises
        ------
        PlanError
            A target is none of the cell's.
        """
        for name in self.targets:
            if name not in cell.targets:
                raise PlanError(f"targets: expected some of {', '.join(cell.targets)}, found {name!r}")
        if not self.targets or len(set(self.targets)) < len(self.targets):
            raise PlanError("targets: expected one or more different ones")
        return np.asarray(cell.targets[self.targets[0]], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Cube:
    """ISO 9283's cube: centre ``(3,)`` and edge, m, base frame, and which of its planes has the poses."""

    centre: Array
    edge: float
    plane: str = "a"

    def check(self) -> None:
        """Refuse what is no cube.

        Raises
        ------
        PlanError
            Edge or plane.
        """
        if not self.edge > 0.0 or not np.isfinite(self.edge):
            raise PlanError(f"cube: expected an edge above 0 m, found {self.edge:g}")
        if self.plane not in PLANES:
            raise PlanError(f"plane: expected one of {', '.join(PLANES)}, found {self.plane!r}")


def plan_cube(
    cell: Cell, limits: Limits, scene: Scene, wanted: Returns, cube: Cube, *,
    cycles: int = 30, assumed: tuple[str, ...] = (),
) -> Plan:  # fmt: skip
    """ISO 9283's cycles through five poses of a cube with edges along the base's axes.

    Raises
    ------
    PlanError
        A number is out of range, or a pose out of reach.
    """
    _count("cycles", cycles, 1, 5 * cycles)
    cube.check()
    wanted.approach.check()
    centre = cube.centre
    corners = centre + cube.edge / 2 * CORNERS[list(PLANES[cube.plane])]
    places = np.vstack([centre, corners + 2 * FROM_END * (centre - corners)])
    q = path_through(cell, limits, scene, places, wanted.way, wanted.point(cell), 1.5 * wanted.approach.angle)
    stops = []
    for cycle in range(cycles):
        for number, before in zip(CYCLE, (CYCLE[-1], *CYCLE[:-1]), strict=True):
            sides = sides_along(q[number - 1], q[before - 1])
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
    return finished(cell, limits, visits, wanted.measure_time, record | _record(wanted), assumed)


def plan_line(
    cell: Cell, limits: Limits, scene: Scene, wanted: Returns, ends: Array, *,
    stops: int = 24, repetitions: int = 200, assumed: tuple[str, ...] = (),
) -> Plan:  # fmt: skip
    """Stops on a straight line between two ``ends`` ``(2, 3)`` m, base frame, out and back.

    Visits with odd numbers are on the way out. The two ends are visited once in each direction too.

    Raises
    ------
    PlanError
        A number is out of range, or a place out of reach.
    """
    if stops < 2:
        raise PlanError(f"stops: expected 2 or more, found {stops}")
    _count("repetitions", repetitions, 1, 2 * stops * repetitions)
    if not np.linalg.norm(ends[1] - ends[0]) > 0.0:
        raise PlanError("line: expected two different ends, found one place")
    wanted.approach.check()
    places = ends[0] + np.linspace(0.0, 1.0, stops)[:, None] * (ends[1] - ends[0])
    q = path_through(cell, limits, scene, places, wanted.way, wanted.point(cell), 1.5 * wanted.approach.angle)
    out = np.array([sides_along(q[max(k, 1)], q[max(k, 1) - 1]) for k in range(stops)])
    made = []
    for _ in range(repetitions):
        for back in (False, True):
            for k in range(stops)[:: -1 if back else 1]:
                side = -out[k] if back and not wanted.one_side else out[k]
                made.append(Stop(k + 1, q[k], q[k] - wanted.approach.angle * side, wanted.targets))
    record: dict[str, float | int | str] = {"program": "line", "stops": stops, "repetitions": repetitions}
    visits = visits_of(cell, limits, scene, made, wanted.approach)
    return finished(cell, limits, visits, wanted.measure_time, record | _record(wanted), assumed)


def plan_fixed(
    cell: Cell, limits: Limits, scene: Scene, wanted: Returns, posture: Array, *,
    readings: int = 30, pause: float = 0.0, assumed: tuple[str, ...] = (),
) -> Plan:  # fmt: skip
    """Measure targets of a robot that stands, again and again: what the instrument itself repeats to.

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
    return finished(cell, limits, visits, wanted.measure_time, record, assumed)


def off_line(plan: Plan, target: str) -> tuple[float, float]:
    """How far a target leaves the straight line between two stops of a plan, at most, m.

    Returns
    -------
    between, travelled
        If the joints went from one stop straight to the next; and on the ways that the plan takes, which lead past the
        place from which each stop is approached.
    """
    robot, point = plan.cell.robot, plan.cell.targets[target]

    def off(corners: Array, first: Array, last: Array) -> float:
        """How far the joints' way along some corners ``(k, n)`` is off the line through two stops ``(n,)``."""
        share = np.linspace(0.0, 1.0, PLACES_BETWEEN)[:, None]
        ways = [before + share * (after - before) for before, after in pairwise(corners)]
        q = np.vstack([first, last, *ways])
        T = forward(robot.screws, robot.flange, q @ np.asarray(robot.linkage).T)
        p = T[:, :3, :3] @ point + T[:, :3, 3] - (T[0, :3, :3] @ point + T[0, :3, 3])
        along = p[1] / np.linalg.norm(p[1])
        return float(np.linalg.norm(p - (p @ along)[:, None] * along, axis=1).max())

    stops = {visit.pose: visit.q for visit in plan.visits}
    ends = stops[min(stops)], stops[max(stops)]
    between = max(off(np.array([stops[a], stops[b]]), stops[a], stops[b]) for a, b in pairwise(sorted(stops)))
    once = plan.visits[: 2 * len(stops)]  # out and back; all further repetitions are the same
    travelled = [off(np.array([a.q, b.via, b.q]), *ends) for a, b in pairwise(once)]
    return between, max(travelled, default=between)


def _count(what: str, value: int, least: int, visits: int) -> None:
    if value < least or visits > MOST_VISITS:
        raise PlanError(f"{what}: expected {least} or more and at most {MOST_VISITS} visits, found {value}")


def _record(wanted: Returns) -> dict[str, float | int | str]:
    """What was asked for, as the plan records it."""
    record: dict[str, float | int | str] = {
        "targets": ", ".join(wanted.targets),
        "approach_rad": wanted.approach.angle,
        "from": "one side" if wanted.one_side else "both sides",
        "speed": wanted.approach.share,
    }
    return record if wanted.approach.seconds is None else record | {"last_move_s": wanted.approach.seconds}
