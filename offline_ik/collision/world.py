"""The bodies of a cell at postures of its arm, and the distances of the pairs that may not touch.

Distances are `coal`'s, one pair at one posture. Spheres around the bodies bound them from below for all pairs at all
postures at once, so that most pairs need no exact distance. The geometry is the nominal arm's, whose millimetres the
cell's clearance covers.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import coal  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from kinematics.poe import joint_transforms
from offline_ik.collision.shapes import Shape, checked_pairs, shapes_of

if TYPE_CHECKING:
    from offline_ik.inverse.detector import Detector

__all__ = ["Placed", "World", "world_of"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


class World:
    """All shapes of a detector's cell and the pairs of them that may not touch.

    Attributes
    ----------
    shapes
        Some links a second time, cut back for one pair.
    pairs
        The one nearer to the base first.
    """

    def __init__(self, detector: Detector) -> None:
        robot = detector.robot
        self._screws, self._linkage = robot.screws, np.asarray(robot.linkage)
        points = np.array([*(j.point for j in robot.joints), robot.flange[:3, 3]])
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)  # (n,)
        shapes = shapes_of(detector)
        self.pairs: list[tuple[Shape, Shape]] = list(checked_pairs(detector, shapes, lengths))
        self.shapes: list[Shape] = list(dict.fromkeys([*shapes, *(a for a, _ in self.pairs)]))
        number = {id(shape): k for k, shape in enumerate(self.shapes)}
        self.sides = np.array([[number[id(a)], number[id(b)]] for a, b in self.pairs], dtype=np.int64).reshape(-1, 2)
        self._poses = np.array([shape.pose for shape in self.shapes])  # (shapes, 4, 4)
        self._links = np.array([shape.link for shape in self.shapes], dtype=np.int64)
        self.middles, self.radii = _spheres(self.shapes)
        # How far a unit of each joint can move points of each pair's outer shape against the inner one (pairs, n).
        self._levers = np.array([_levers(a, b, lengths) for a, b in self.pairs]).reshape(len(self.pairs), robot.n)

    def at(self, q: Array) -> Placed:
        """The bodies at postures ``(m, n)``, rad."""
        G = joint_transforms(self._screws, q @ self._linkage.T)
        return Placed(self, G[:, self._links] @ self._poses)

    def distances(self, q: Array) -> Array:
        """Of every pair ``(m, pairs)`` at postures ``(m, n)``; negative: overlapping, m."""
        placed = self.at(q)
        every = [[placed.distance(k, i) for i in range(len(self.pairs))] for k in range(len(q))]
        return np.array(every, dtype=float).reshape(len(q), len(self.pairs))

    def motion(self, step: Array) -> Array:
        """How far the shapes of every pair ``(pairs,)`` can come nearer in a step ``(n,)`` of the joints, m."""
        return np.asarray(self._levers @ np.abs(self._linkage @ step))


class Placed:
    """A world's shapes at ``m`` postures, their poses ``(m, shapes, 4, 4)``."""

    def __init__(self, world: World, poses: Array) -> None:
        self._world, self._poses = world, poses
        self._places: dict[tuple[int, int], coal.Transform3s] = {}

    def bounds(self) -> Array:
        """What the distance of every pair is at least ``(m, pairs)``, m."""
        world = self._world
        middles = (self._poses[..., :3, :3] @ world.middles[..., None])[..., 0] + self._poses[..., :3, 3]
        one, other = world.sides.T
        apart: Array = np.linalg.norm(middles[:, one] - middles[:, other], axis=-1)
        return apart - world.radii[one] - world.radii[other]

    def distance(self, posture: int, pair: int) -> float:
        """Of one pair at one of the postures, m; negative: overlapping."""
        (a, b), (i, j) = self._world.pairs[pair], self._world.sides[pair].tolist()
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        return float(
            coal.distance(a.geometry, self._place(posture, i), b.geometry, self._place(posture, j), request, result)
        )

    def _place(self, posture: int, shape: int) -> coal.Transform3s:
        place = self._places.get((posture, shape))
        if place is None:
            T = self._poses[posture, shape]
            place = self._places[posture, shape] = coal.Transform3s(T[:3, :3].copy(), T[:3, 3].copy())
        return place


@lru_cache(maxsize=8)
def world_of(detector: Detector) -> World:
    """The world of a detector, made once."""
    return World(detector)


def _spheres(shapes: list[Shape]) -> tuple[Array, Array]:
    """Middles ``(shapes, 3)``, in each shape's own frame, and radii ``(shapes,)`` of spheres around the shapes, m."""
    for shape in shapes:
        shape.geometry.computeLocalAABB()
    middles = np.array([np.asarray(shape.geometry.aabb_center, dtype=float).ravel() for shape in shapes])
    return middles, np.array([float(shape.geometry.aabb_radius) for shape in shapes])


def _levers(inner: Shape, outer: Shape, lengths: Array) -> Array:
    """How far a unit of each joint ``(n,)`` moves points of the outer shape as the inner one sees it, m/rad."""
    out = np.zeros(len(lengths))
    for k in range(inner.link, outer.link):
        out[k] = lengths[k : outer.link - 1].sum() + outer.extent
    return out
