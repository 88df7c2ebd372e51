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
from offline_ik.cell import Obstacle, reach_of
from offline_ik.errors import CellError

if TYPE_CHECKING:
    from offline_ik.detector import Detector

__all__ = ["PathReport", "check_path", "check_sample", "move_time"]

Array = npt.NDArray[np.float64]

RADII = (0.11, 0.10, 0.065, 0.07, 0.05, 0.04, 0.035)
"""Of the reach: base and links 1 to 6, a little more than what arms of this kind have."""
BASE_HEIGHT = 0.6  # of the shoulder's
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


@dataclass(frozen=True, eq=False)
class _Shape:
    """A body: which link carries it (0: the world or the base), where on it, and how far its points are from axes."""

    name: str
    link: int
    geometry: Any
    pose: Array
    extent: float  # of its own, from its link's joint, m
    radius: float = 0.0  # what it needs around its link, m


class _World:
    """All shapes of a detector's cell and the pairs of them that may not touch."""

    def __init__(self, detector: Detector) -> None:
        self.detector = detector
        robot = detector.robot
        points = np.array([*(j.point for j in robot.joints), robot.flange[:3, 3]])
        self.lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)  # (n,)
        self.shapes = [*(_obstacle(o) for o in detector.cell.obstacles), *_links(detector, points)]
        pairs = [(a, b) for i, a in enumerate(self.shapes) for b in self.shapes[i + 1 :]]
        self.pairs = [pair for pair in pairs if not self._may_touch(*pair)]
        # How far a unit of each joint can move points of each shape (shapes, n), m/rad.
        self.levers = {id(s): self._lever(s) for s in self.shapes}

    def _may_touch(self, a: _Shape, b: _Shape) -> bool:
        """Whether a pair is not checked: fixed to each other, or so close along the arm that they touch by design.

        What links that are joined by a short one may do to each other is what joint limits are for.
        """
        if a.link == b.link:
            return True
        if a.link == 0 and a.name != "base":
            return b.link == 1  # the robot stands on its pedestal
        between = float(self.lengths[a.link : b.link - 1].sum())
        return between < a.radius + b.radius + self.detector.cell.clearance

    def _lever(self, shape: _Shape) -> Array:
        out = np.zeros(len(self.lengths))
        for k in range(shape.link):
            out[k] = self.lengths[k : shape.link - 1].sum() + shape.extent
        return out

    def distances(self, q: Array) -> Array:
        """Of every pair ``(pairs,)`` at a posture ``(n,)``; negative: overlapping, m."""
        robot = self.detector.robot
        G = joint_transforms(robot.screws, np.asarray(robot.linkage) @ q)
        placed = {}
        for shape in self.shapes:
            T = G[shape.link] @ shape.pose
            placed[id(shape)] = coal.Transform3s(T[:3, :3].copy(), T[:3, 3].copy())
        request = coal.DistanceRequest()
        out = np.empty(len(self.pairs))
        for k, (a, b) in enumerate(self.pairs):
            out[k] = coal.distance(a.geometry, placed[id(a)], b.geometry, placed[id(b)], request, coal.DistanceResult())
        return out

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
        reasons[f"{a} and {b} would come within {1e3 * worst.clearance:.0f} mm at {worst.at:.3f} of the move"] = None
    return PathReport(
        tuple(reasons), worst.clearance, worst.between, worst.at, worst.base, move_time(detector, path)
    )  # fmt: skip


class _Worst:
    """The least distances met while intervals are halved."""

    def __init__(self, world: _World, allowed: float) -> None:
        self.world, self.allowed = world, allowed
        self.clearance, self.between, self.at, self.base = np.inf, ("", ""), 0.0, np.inf
        self.hit: tuple[str, str] | None = None
        self._forearm = np.array([a.name == "base" and b.link in (4, 5) for a, b in world.pairs], dtype=bool)

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
    """Refuse a sample that lies in an obstacle or in the robot's own base.

    Raises
    ------
    CellError
        It does.
    """
    convention = detector.cell.convention
    at = np.eye(4)
    at[:3, 3] = convention.sample
    place = detector.to_base(at)[:3, 3]
    point = coal.Sphere(1e-6)
    here = coal.Transform3s(np.eye(3), place.copy())
    fixed = [s for s in _world(detector).shapes if s.link == 0]
    inside = {o.name for o in detector.cell.obstacles if o.holds_sample}
    for shape in fixed:
        if shape.name in inside:
            continue
        there = coal.Transform3s(shape.pose[:3, :3].copy(), shape.pose[:3, 3].copy())
        geometry = getattr(shape.geometry, "convex", None) or shape.geometry  # a mesh has no inside, its hull has
        if coal.distance(point, here, geometry, there, coal.DistanceRequest(), coal.DistanceResult()) <= 0:
            raise CellError(
                f"the sample at {np.round(place, 4).tolist()} m (base frame) lies inside {shape.name}; an obstacle "
                "that may hold it says holds_sample = true"
            )


@lru_cache(maxsize=8)
def _world(detector: Detector) -> _World:
    return _World(detector)


def _links(detector: Detector, points: Array) -> list[_Shape]:
    robot, cell = detector.robot, detector.cell
    n, reach = robot.n, reach_of(robot)
    guessed = np.interp(np.linspace(0, 1, n + 1), np.linspace(0, 1, len(RADII)), RADII) * reach
    radii = guessed[1:] if cell.radius is None else cell.radius
    base = float(guessed[0]) if cell.base_radius is None else cell.base_radius
    height = max(BASE_HEIGHT * abs(float(points[1][2])), 1e-3)
    out = [_Shape("base", 0, coal.Cylinder(base, height), _placed(np.array([0, 0, height / 2])), 0.0, base)]
    for k in range(n):
        vector = points[k + 1] - points[k]
        length = float(np.linalg.norm(vector))
        if length < 1e-6:
            continue
        pose = _placed(0.5 * (points[k] + points[k + 1]), vector / length)
        own = float(radii[k])
        out.append(_Shape(f"link {k + 1}", k + 1, coal.Capsule(own, length), pose, length + own, own))
    if cell.size is not None:
        x, y, z = cell.size
        pose = np.asarray(robot.flange) @ detector.solver.mount
        pose = pose @ _placed(np.array([0, 0, -0.5 * z]))
        extent = float(np.linalg.norm(pose[:3, 3] - points[n - 1]) + 0.5 * np.linalg.norm(cell.size))
        out.append(_Shape("detector", n, coal.Box(x, y, z), pose, extent))
    return out


def _obstacle(obstacle: Obstacle) -> _Shape:
    match obstacle.shape:
        case "box":
            geometry = coal.Box(*obstacle.size)
        case "cylinder":
            geometry = coal.Cylinder(*obstacle.size)
        case "capsule":
            geometry = coal.Capsule(*obstacle.size)
        case "sphere":
            geometry = coal.Sphere(*obstacle.size)
        case "mesh":
            try:
                geometry = coal.MeshLoader().load(str(obstacle.file), np.ones(3))
                geometry.buildConvexHull(True, "Qt")
            except (RuntimeError, ValueError) as error:
                why = " ".join(str(error).partition("message:")[2].split()) or str(error)
                raise CellError(f"obstacle {obstacle.name}: {obstacle.file} is no mesh: {why}") from None
    return _Shape(obstacle.name, 0, geometry, np.asarray(obstacle.pose), 0.0)


def _placed(middle: Array, z: Array | None = None) -> Array:
    """A pose at ``middle`` with its z axis along ``z``."""
    out = np.eye(4)
    out[:3, 3] = middle
    if z is not None:
        x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
        x /= np.linalg.norm(x)
        out[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    return out
