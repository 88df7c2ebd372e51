"""Whether a move is safe before it is made: limits, speeds, the arm with itself, and the arm with what stands around.

The world is the one that measurement plans are checked against, and so is the check: see :mod:`kinematics.collision`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import coal  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from kinematics.collision.bodies import Shape, distance_of
from kinematics.collision.moves import LongCheckError, MoveCheck
from offline_ik.collision.world import world_of
from offline_ik.errors import CellError

if TYPE_CHECKING:
    from offline_ik.inverse.detector import Detector

__all__ = ["Clearance", "LongCheckError", "PathReport", "check_path", "check_sample", "clearances_along", "move_time"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PathReport:
    """What a check of a move found.

    Attributes
    ----------
    reasons
        Why it is refused; empty: it is safe.
    clearance
        The least distance seen, m, and ``between`` which shapes, ``at`` what share of the move (in legs).
    base_distance
        The least distance of the forearm and wrist (axes 4 and 5) from the robot's own base, m.
    duration
        At the cell's share of the greatest speeds, s.
    """

    reasons: tuple[str, ...]
    clearance: float
    between: tuple[str, str]
    at: float
    base_distance: float
    duration: float

    @property
    def safe(self) -> bool:
        """Whether the move is safe."""
        return not self.reasons

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "safe": self.safe,
            "reasons": list(self.reasons),
            "least_distance_m": self.clearance if np.isfinite(self.clearance) else None,
            "between": list(self.between),
            "at": self.at,
            "forearm_to_base_m": self.base_distance if np.isfinite(self.base_distance) else None,
            "duration_s": self.duration,
        }


@dataclass(frozen=True)
class Clearance:
    """The least distance of two bodies along a way, m, and at which share of it."""

    between: tuple[str, str]
    distance: float
    at: float

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {"between": list(self.between), "least_distance_m": self.distance, "at": self.at}


def check_path(detector: Detector, postures: Sequence[Array] | Array, most: float = np.inf) -> PathReport:
    """Check a move through postures ``(m, n)``, straight in joint space between them.

    Parameters
    ----------
    postures
        rad; a single one is checked as a place.
    most
        Places on the way that may be looked at.

    Raises
    ------
    LongCheckError
        They do not decide.
    """
    path = np.atleast_2d(np.asarray(postures, dtype=float))
    reasons: dict[str, None] = {}
    wild = ~np.isfinite(path).all(axis=0)
    beyond = ((path < detector.lower) | (path > detector.upper)).any(axis=0)
    for i in np.flatnonzero(wild | beyond).tolist():
        name, (low, high) = detector.robot.joints[i].name, np.degrees([detector.lower[i], detector.upper[i]])
        limits = "is not a finite angle" if wild[i] else f"leaves its limits of {low:.1f} to {high:.1f} deg"
        reasons[f"{name} {limits}"] = None
    if reasons:
        return PathReport(tuple(reasons), np.inf, ("", ""), 0.0, np.inf, move_time(detector, path))
    world = world_of(detector)
    worst = MoveCheck(world, most)
    for leg in range(max(len(path) - 1, 1)):
        start, end = path[leg], path[min(leg + 1, len(path) - 1)]
        worst.leg(start, end, leg)
        if worst.hit is not None:
            break
    if worst.hit is not None:
        a, b = worst.hit
        gap = 1e3 * worst.clearance
        near = f"come within {gap:.0f} mm" if gap >= 0.0 else f"overlap by {-gap:.0f} mm"
        reasons[f"{a} and {b} would {near} after {100.0 * worst.at:.0f} % of the move"] = None
    return PathReport(
        tuple(reasons), worst.clearance, worst.between, worst.at, worst.base, move_time(detector, path)
    )  # fmt: skip


def clearances_along(detector: Detector, postures: Array) -> list[Clearance]:
    """The least distance of every pair of bodies that may not touch, over postures ``(m, n)``; the nearest pair first.

    Between the postures nothing is looked at: this is for people to read. :func:`check_path` decides.
    """
    world = world_of(detector)
    if not world.pairs:
        return []
    distances = world.distances(np.atleast_2d(postures))  # (m, pairs)
    least, last = distances.argmin(axis=0), max(len(distances) - 1, 1)
    found = [
        Clearance((a.name, b.name), float(distances[k, i]), float(k) / last)
        for i, ((a, b), k) in enumerate(zip(world.pairs, least.tolist(), strict=True))
    ]
    return sorted(found, key=lambda c: c.distance)


def move_time(detector: Detector, path: Array, speed: float | None = None) -> float:
    """How long a move takes at the given share of the joints' greatest speeds (the cell's by default), s."""
    share = detector.cell.speed if speed is None else speed
    path = np.atleast_2d(path)
    legs = np.abs(path[1:] - path[:-1])
    return float((legs / (share * detector.fastest)).max(axis=1).sum()) if len(legs) else 0.0


def check_sample(detector: Detector) -> None:
    """Refuse a sample that lies in an obstacle, in the robot's own base, or in what carries that.

    An upright robot stands on something: the column of its base goes on without end below it, unless an obstacle of the
    cell reaches its foot and so says what is there.

    Raises
    ------
    CellError
        It does.
    """
    convention = detector.cell.convention
    at = np.eye(4)
    at[:3, 3] = convention.sample
    place = detector.to_base(at)[:3, 3]
    position = f"the sample at {np.round(place, 4).tolist()} m (base frame) lies inside"
    point = coal.Sphere(1e-6)
    here = coal.Transform3s(np.eye(3), place.copy())
    inside = {o.name for o in detector.cell.obstacles if o.holds_sample}
    for shape in world_of(detector).shapes:
        if shape.kind == "base" and _in_column(detector, shape, place):
            raise CellError(
                f"{position} the robot's base or what is below it (within {shape.radius:.3f} m of axis 1); an obstacle "
                "that reaches the foot of the base says what is there"
            )
        if shape.kind != "obstacle" or shape.name in inside:
            continue
        geometry = shape.geometry if shape.hull is None else shape.hull
        if distance_of(point, here, geometry, shape.at(np.eye(4))) <= 0:
            raise CellError(f"{position} {shape.name}; an obstacle that may hold it says holds_sample = true")


def _in_column(detector: Detector, base: Shape, place: Array) -> bool:
    """Whether a place ``(3,)`` is in the base, up to the shoulder, or below an upright one that stands on who knows."""
    gravity = np.asarray(detector.cell.gravity)
    upright = gravity[2] < -0.5 * np.linalg.norm(gravity)
    endless = upright and not world_of(detector).stands_on
    lowest, shoulder = -np.inf if endless else 0.0, detector.robot.joints[1].point[2]
    return bool(np.hypot(*place[:2]) <= base.radius and lowest <= place[2] <= shoulder)
