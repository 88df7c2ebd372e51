"""Whether a move is safe before it is made: limits, speeds, the arm with itself, and the arm with what stands around.

The arm's links are capsules between its joints (radii from the cell, or guessed from its reach), the detector is a box,
obstacles are the cell's shapes. A move in joint space is checked along its whole length: at the middle of an interval
the distance of every pair of shapes must exceed what they can come nearer within half of it, or else the interval is
halved. What such a step can move is bounded by the lengths of the links, so that nothing between the samples is missed.
Distances are `coal`'s. The geometry is the nominal arm's, whose millimetres the clearance covers. Source of the bound:
Schwarzer, Saha, Latombe (2005), Adaptive dynamic collision checking for single and multiple articulated robots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import coal  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from kinematics.poe import joint_transforms
from offline_ik.errors import CellError
from offline_ik.shapes import Shape, carries, checked_pairs, distance_of, shapes_of

if TYPE_CHECKING:
    from offline_ik.detector import Detector

__all__ = ["Clearance", "PathReport", "check_path", "check_sample", "clearances_along", "move_time"]

Array = npt.NDArray[np.float64]

FINEST = 1e-4  # of a move: what is nearer than the clearance plus this much of the move is refused


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
        """Whether nothing speaks against it."""
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


class _World:
    """All shapes of a detector's cell and the pairs of them that may not touch."""

    def __init__(self, detector: Detector) -> None:
        self.detector = detector
        robot = detector.robot
        points = np.array([*(j.point for j in robot.joints), robot.flange[:3, 3]])
        self.lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)  # (n,)
        shapes = shapes_of(detector)
        self.pairs = list(checked_pairs(detector, shapes, self.lengths))
        self.shapes = list(dict.fromkeys([*shapes, *(a for a, _ in self.pairs)]))  # some are cut back for a pair
        # How far a unit of each joint can move points of each shape (shapes, n), m/rad.
        self.levers = {id(s): self._lever(s) for s in self.shapes}

    def _lever(self, shape: Shape) -> Array:
        out = np.zeros(len(self.lengths))
        for k in range(shape.link):
            out[k] = self.lengths[k : shape.link - 1].sum() + shape.extent
        return out

    def distances(self, q: Array) -> Array:
        """Of every pair ``(pairs,)`` at a posture ``(n,)``; negative: overlapping, m."""
        robot = self.detector.robot
        G = joint_transforms(robot.screws, np.asarray(robot.linkage) @ q)
        placed = {id(shape): shape.at(G[shape.link]) for shape in self.shapes}
        return np.array(
            [distance_of(a.geometry, placed[id(a)], b.geometry, placed[id(b)]) for a, b in self.pairs], dtype=float
        )

    def motion(self, step: Array) -> Array:
        """How far the shapes of every pair ``(pairs,)`` can come nearer in a step ``(n,)`` of the joints, m."""
        moved = np.abs(np.asarray(self.detector.robot.linkage) @ step)
        joints = np.arange(len(moved))
        return np.array([float((self.levers[id(b)] * (joints >= a.link)) @ moved) for a, b in self.pairs])


def check_path(detector: Detector, postures: Sequence[Array] | Array) -> PathReport:
    """Check a move through postures ``(m, n)``, straight in joint space between them.

    Parameters
    ----------
    postures
        rad; a single one is checked as a place.
    """
    path = np.atleast_2d(np.asarray(postures, dtype=float))
    reasons: dict[str, None] = {}
    for i, joint in enumerate(detector.robot.joints):
        if not np.isfinite(path[:, i]).all():
            reasons[f"{joint.name} is not a finite angle"] = None
        elif (path[:, i] < detector.lower[i]).any() or (path[:, i] > detector.upper[i]).any():
            low, high = np.degrees([detector.lower[i], detector.upper[i]])
            reasons[f"{joint.name} leaves its limits of {low:.1f} to {high:.1f} deg"] = None
    if reasons:
        return PathReport(tuple(reasons), np.inf, ("", ""), 0.0, np.inf, move_time(detector, path))
    world = _world(detector)
    worst = _Worst(world, detector.cell.clearance)
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
    world = _world(detector)
    if not world.pairs:
        return []
    distances = np.array([world.distances(q) for q in np.atleast_2d(postures)])  # (m, pairs)
    least, last = distances.argmin(axis=0), max(len(distances) - 1, 1)
    found = [
        Clearance((a.name, b.name), float(distances[k, i]), float(k) / last)
        for i, ((a, b), k) in enumerate(zip(world.pairs, least.tolist(), strict=True))
    ]
    return sorted(found, key=lambda c: c.distance)


class _Worst:
    """The least distances met while intervals are halved."""

    def __init__(self, world: _World, allowed: float) -> None:
        self.world, self.allowed = world, allowed
        self.clearance, self.between, self.at, self.base = np.inf, ("", ""), 0.0, np.inf
        self.hit: tuple[str, str] | None = None
        self._forearm = np.array([a.kind == "base" and b.link in (4, 5) for a, b in world.pairs], dtype=bool)

    def leg(self, start: Array, end: Array, number: int) -> None:
        whole = self.world.motion(end - start)
        todo = [(0.0, 1.0)]
        while todo:
            a, b = todo.pop()
            middle = 0.5 * (a + b)
            distance = self.world.distances(start + middle * (end - start))
            self._note(distance, number + middle)
            if not len(distance):
                return
            if (distance < self.allowed).any():
                self._refuse(distance, number + middle)
                return
            near = distance - self.allowed <= 0.5 * (b - a) * whole
            if not near.any():
                continue
            if b - a < FINEST:
                self._refuse(np.where(near, distance, np.inf), number + middle)
                return
            todo += [(middle, b), (a, middle)]

    def _note(self, distance: Array, at: float) -> None:
        if len(distance) and distance.min() < self.clearance:
            k = int(np.argmin(distance))
            self.clearance, self.at = float(distance[k]), at
            self.between = (self.world.pairs[k][0].name, self.world.pairs[k][1].name)
        if self._forearm.any():
            self.base = min(self.base, float(distance[self._forearm].min()))

    def _refuse(self, distance: Array, at: float) -> None:
        k = int(np.argmin(distance))
        self.clearance, self.at = float(distance[k]), at
        self.hit = self.between = (self.world.pairs[k][0].name, self.world.pairs[k][1].name)


def move_time(detector: Detector, path: Array, speed: float | None = None) -> float:
    """How long a move takes at the given share of the joints' greatest speeds (the cell's by default), s."""
    share = detector.cell.speed if speed is None else speed
    fastest = np.array([j.max_speed or np.pi for j in detector.robot.joints])
    legs = np.abs(np.diff(np.atleast_2d(path), axis=0))
    return float((legs / (share * fastest)).max(axis=1).sum()) if len(legs) else 0.0


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
    told = f"the sample at {np.round(place, 4).tolist()} m (base frame) lies inside"
    point = coal.Sphere(1e-6)
    here = coal.Transform3s(np.eye(3), place.copy())
    inside = {o.name for o in detector.cell.obstacles if o.holds_sample}
    for shape in _world(detector).shapes:
        if shape.kind == "base" and _in_column(detector, shape, place):
            raise CellError(
                f"{told} the robot's base or what is below it (within {shape.radius:.3f} m of axis 1); an obstacle "
                "that reaches the foot of the base says what is there"
            )
        if shape.kind != "obstacle" or shape.name in inside:
            continue
        geometry = shape.geometry if shape.hull is None else shape.hull
        if distance_of(point, here, geometry, shape.at(np.eye(4))) <= 0:
            raise CellError(f"{told} {shape.name}; an obstacle that may hold it says holds_sample = true")


def _in_column(detector: Detector, base: Shape, place: Array) -> bool:
    """Whether a place ``(3,)`` is in the base, up to the shoulder, or below an upright one that stands on who knows."""
    gravity = np.asarray(detector.cell.gravity)
    upright = gravity[2] < -0.5 * np.linalg.norm(gravity)
    obstacles = (s for s in _world(detector).shapes if s.kind == "obstacle")
    endless = upright and not any(carries(s, base, detector.cell.clearance) for s in obstacles)
    lowest, shoulder = -np.inf if endless else 0.0, detector.robot.joints[1].point[2]
    return bool(np.hypot(*place[:2]) <= base.radius and lowest <= place[2] <= shoulder)


@lru_cache(maxsize=8)
def _world(detector: Detector) -> _World:
    return _World(detector)
