"""
The bodies of a world at postures of its arm, and the distances of the pairs that may not touch.

Distances are `coal`'s, one pair at one posture (Pan, Chitta, Manocha, FCL, ICRA 2012; Montaut et al., GJK++, 2023).
Spheres around the bodies bound them from below for all pairs at all postures at once, so that most pairs need no exact
distance. The geometry is the nominal arm's, whose millimetres the clearance covers.
"""

from __future__ import annotations

from functools import cached_property

import coal  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from kinematics.collision.bodies import Shape, WorldDescription, carries, checked_pairs, points_of, shapes_of
from kinematics.poe import joint_transforms
from kinematics.robot import RobotDescription
from kinematics.typing_ import Array

__all__ = ["Placed", "World"]


class World:
    """
    All shapes of a described world and the pairs of them that may not touch.

    Attributes
    ----------
    shapes
        Some links a second time, cut back for one pair.
    pairs
        The one nearer to the base first.

    Raises
    ------
    MeshError
        The file of a mesh is none.
    """

    def __init__(self, robot: RobotDescription, described: WorldDescription) -> None:
        self.robot, self.described = robot, described
        shapes = shapes_of(robot, described)
        self.pairs: list[tuple[Shape, Shape]] = list(checked_pairs(described, robot, shapes))
        self.shapes: list[Shape] = list(dict.fromkeys([*shapes, *(a for a, _ in self.pairs)]))
        number = {id(shape): k for k, shape in enumerate(self.shapes)}
        self.sides = np.array([[number[id(a)], number[id(b)]] for a, b in self.pairs], dtype=np.int64).reshape(-1, 2)
        self._poses = np.array([shape.pose for shape in self.shapes])  # (shapes, 4, 4)
        self._links = np.array([shape.link for shape in self.shapes], dtype=np.int64)
        self.middles, self.radii = _spheres(self.shapes)
        self.levers = _Levers(robot, self.pairs)
        half = [k for k, (a, _) in enumerate(self.pairs) if isinstance(a.geometry, coal.Halfspace)]
        planes = np.array([self.pairs[k][0].pose for k in half]).reshape(-1, 4, 4)
        self.half_spaces = np.array(half, dtype=np.int64)  # the pairs that have one
        self.normals = planes[:, :3, 2]
        self.heights = np.einsum("ki,ki->k", self.normals, planes[:, :3, 3])  # of its surface along its normal, m

    @cached_property
    def stands_on(self) -> tuple[str, ...]:
        """Names of the obstacles that reach the foot of the base, so that the robot stands on them."""
        base = next(s for s in self.shapes if s.kind == "base")
        obstacles = (s for s in self.shapes if s.kind == "obstacle")
        return tuple(s.name for s in obstacles if carries(s, base, self.described.clearance))

    def at(self, q: Array) -> Placed:
        """The bodies at postures ``(m, n)``, rad."""
        G = joint_transforms(self.robot.screws, q @ np.asarray(self.robot.linkage).T)
        return Placed(self, G[:, self._links] @ self._poses)

    def distances(self, q: Array) -> Array:
        """Of every pair ``(m, pairs)`` at postures ``(m, n)``; negative: overlapping, m."""
        placed = self.at(q)
        every = [[placed.distance(k, i) for i in range(len(self.pairs))] for k in range(len(q))]
        return np.array(every, dtype=float).reshape(len(q), len(self.pairs))

    def clear(self, q: Array) -> npt.NDArray[np.bool_]:
        """Whether all bodies keep the clearance ``(m,)`` at postures ``(m, n)``, rad."""
        allowed, placed = self.described.clearance, self.at(q)
        bounds = placed.bounds()
        return np.array(
            [
                all(placed.distance(k, i) > allowed for i in np.flatnonzero(bounds[k] <= allowed).tolist())
                for k in range(len(q))
            ],
            dtype=bool,
        )

    def motion(self, start: Array, end: Array) -> Array:
        """How much nearer the shapes of every pair ``(pairs,)`` can come between postures ``(n,)``, straight, m."""
        return self.levers.between(start, end)


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
        half = world.half_spaces
        apart[:, half] = np.einsum("mki,ki->mk", middles[:, other[half]], world.normals) - world.heights
        return apart - world.radii[one] - world.radii[other]

    def distance(self, posture: int, pair: int) -> float:
        """Of one pair at one of the postures, m; negative: overlapping."""
        (a, b), (i, j) = self._world.pairs[pair], self._world.sides[pair].tolist()
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        return float(
            coal.distance(a.geometry, self.place(posture, i), b.geometry, self.place(posture, j), request, result)
        )

    def place(self, posture: int, shape: int) -> coal.Transform3s:
        """Where one of the shapes is at one of the postures, for `coal`."""
        place = self._places.get((posture, shape))
        if place is None:
            T = self._poses[posture, shape]
            place = self._places[posture, shape] = coal.Transform3s(T[:3, :3].copy(), T[:3, 3].copy())
        return place


def _spheres(shapes: list[Shape]) -> tuple[Array, Array]:
    """
    Middles ``(shapes, 3)``, in each shape's own frame, and radii ``(shapes,)`` of spheres around the shapes, m.

    Of a half-space, which no sphere surrounds, both are zero.
    """
    middles, radii = np.zeros((len(shapes), 3)), np.zeros(len(shapes))
    for k, shape in enumerate(shapes):
        if not isinstance(shape.geometry, coal.Halfspace):
            shape.geometry.computeLocalAABB()
            middles[k] = np.asarray(shape.geometry.aabb_center, dtype=float).ravel()
            radii[k] = float(shape.geometry.aabb_radius)
    return middles, radii


class _Levers:
    """
    How far the joints move points of each pair's outer shape as the inner one sees them.

    Joint k turns a point at most by its distance from the joint's own point: the lengths of the links between, the
    shape's extent, and what sliding joints between have travelled. A sliding joint moves it by its own step.
    """

    def __init__(self, robot: RobotDescription, pairs: list[tuple[Shape, Shape]]) -> None:
        self._linkage, n = np.asarray(robot.linkage), robot.n
        kinds = [joint.kind for joint in robot.joints]
        slides = np.array([kind == "prismatic" for kind in kinds])
        self._travels = np.where(slides, 1.0, [abs(joint.pitch) for joint in robot.joints])  # m per unit of the joint
        lengths = np.linalg.norm(np.diff(points_of(robot), axis=0), axis=1)
        self._fixed = np.zeros((len(pairs), n))
        self._between = np.zeros((len(pairs), n, n))  # whose travel takes the outer shape away from which joint
        for p, (inner, outer) in enumerate(pairs):
            for k in range(inner.link, outer.link):
                turned = 0.0 if slides[k] else lengths[k : outer.link - 1].sum() + outer.extent
                self._fixed[p, k] = turned + self._travels[k]
                self._between[p, k, k + 1 : outer.link] = 0.0 if slides[k] else 1.0

    def between(self, start: Array, end: Array) -> Array:
        """See :meth:`World.motion`."""
        first, last = self._linkage @ start, self._linkage @ end
        levers = self._fixed
        if self._travels.any():
            levers = levers + self._between @ (self._travels * np.maximum(np.abs(first), np.abs(last)))
        return np.asarray(levers @ np.abs(last - first))
