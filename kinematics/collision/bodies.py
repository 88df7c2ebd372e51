"""
The bodies of a world: the arm's links as capsules, what its flange carries, obstacles; which pairs may not touch.

Neighbouring links meet at the joint between them: what they may do to each other is what joint limits are for. Links
that touch in most of all postures are neighbours too: they are drawn so (a description's points lie anywhere on the
axes), not built so. What the flange carries is no link. It is checked against every link but its own carrier, and
where the capsule of the forearm, whose round end is a guess, would reach into it at any posture of the wrist, that end
is cut back.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, Literal

import coal  # type: ignore[import-untyped]
import numpy as np

from kinematics.collision.obstacles import Obstacle, rotation_to
from kinematics.poe import joint_transforms
from kinematics.robot import RobotDescription
from kinematics.typing_ import Array

__all__ = [
    "CLEARANCE",
    "Carried",
    "Shape",
    "WorldDescription",
    "carried_box",
    "carried_capsule",
    "carries",
    "checked_pairs",
    "distance_of",
    "points_of",
    "shapes_of",
]

CLEARANCE = 0.02  # m, kept between bodies where nobody says
RADII = (0.11, 0.10, 0.065, 0.07, 0.05, 0.04, 0.035)
"""Of the reach: base and links 1 to 6, a little more than what arms of this kind have."""
BASE_HEIGHT = 0.6  # of the shoulder's
LOWEST_BASE = 1e-3  # m, of its height
SHORTEST_LINK = 1e-6  # m: shorter ones have no body
CUT = 0.25  # of a link's radius: the steps in which its end is cut back
QUARTERS = (0.0, 0.5 * np.pi, -0.5 * np.pi, np.pi)  # rad: a straight wrist is one of these
TOUCH_AS_DRAWN = 0.5  # share of all postures: links that touch in more of them are neighbours
POSTURES = 200  # random ones, by which that is told
UNLIMITED = np.pi  # rad, or m: taken for limits that are not described
FOOT = 2e-3  # m, height of the disc at the base's foot


@dataclass(frozen=True, eq=False)
class Carried:
    """
    What the flange carries.

    Attributes
    ----------
    name
        ``detector``, or ``tool``.
    size
        m: edges of a box ``(3,)``, or radius and length of a capsule along z ``(2,)``.
    pose
        ``(4, 4)``: its middle in the flange's frame.
    """

    name: Literal["detector", "tool"]
    size: tuple[float, ...]
    pose: Array


@dataclass(frozen=True, eq=False)
class WorldDescription:
    """
    What stands around a robot, how thick its links are, and what its flange carries.

    Attributes
    ----------
    obstacles
        In the robot's base frame.
    base_radius, link_radii
        m, and ``(n,)`` m; None: guessed from the arm's reach.
    clearance
        Kept between bodies, m.
    carried
        None: nothing with a body.
    """

    obstacles: tuple[Obstacle, ...] = ()
    base_radius: float | None = None
    link_radii: Array | None = None
    clearance: float = CLEARANCE
    carried: Carried | None = None

    def radii(self, robot: RobotDescription) -> tuple[float, Array]:
        """Of the base and of the links ``(n,)``, m: the stated ones, or guessed from the arm's reach."""
        guessed = np.interp(np.linspace(0, 1, robot.n + 1), np.linspace(0, 1, len(RADII)), RADII) * robot.reach
        base = float(guessed[0]) if self.base_radius is None else self.base_radius
        return base, guessed[1:] if self.link_radii is None else self.link_radii


@dataclass(frozen=True, eq=False)
class Shape:
    """
    A body.

    Attributes
    ----------
    kind
        ``obstacle``, ``base``, ``link``, ``detector`` or ``tool``.
    link
        Which link carries it; 0: the world or the base.
    geometry
        Of `coal`, m.
    pose
        ``(4, 4)``: where it is at the zero posture, base frame.
    extent
        How far its points are from its link's joint, m.
    radius
        What it needs around its link, m.
    hull
        Of a mesh, which has no inside: its convex hull, of `coal`.
    """

    name: str
    kind: str
    link: int
    geometry: Any
    pose: Array
    extent: float
    radius: float = 0.0
    hull: Any = field(default=None)

    def at(self, motion: Array) -> Any:
        """Its place for `coal`, its link moved ``(4, 4)`` from the zero posture."""
        T = motion @ self.pose
        return coal.Transform3s(T[:3, :3].copy(), T[:3, 3].copy())

    @property
    def on_flange(self) -> bool:
        """Whether the flange carries it."""
        return self.kind in ("detector", "tool")


def carried_box(size: tuple[float, float, float], mount: Array) -> Carried:
    """A detector's box: its edges, m, behind the plane of ``mount`` ``(4, 4)``, whose z is the detector's normal."""
    return Carried("detector", size, np.asarray(mount) @ _placed(np.array([0.0, 0.0, -0.5 * size[2]])))


def carried_capsule(end: Array, radius: float) -> Carried | None:
    """A tool of one radius from the flange to ``end`` ``(3,)``, m, flange frame; None where there is no way."""
    length = float(np.linalg.norm(end))
    if length < SHORTEST_LINK:
        return None
    along, start = np.asarray(end) / length, min(radius, length)  # nothing of it reaches back behind the flange
    return Carried("tool", (radius, length - start), _placed(0.5 * (start + length) * along, along))


def distance_of(a: Any, a_at: Any, b: Any, b_at: Any) -> float:
    """Between two geometries at their places, m; negative: overlapping."""
    return float(coal.distance(a, a_at, b, b_at, coal.DistanceRequest(), coal.DistanceResult()))


def points_of(robot: RobotDescription) -> Array:
    """Where each link begins, and where the last one ends ``(n + 1, 3)``, m, at the zero posture in the base frame."""
    return np.array([*(j.point for j in robot.joints), robot.flange[:3, 3]])


def shapes_of(robot: RobotDescription, described: WorldDescription) -> list[Shape]:
    """
    Obstacles, base, links and what the flange carries.

    Raises
    ------
    MeshError
        The file of a mesh is none.
    """
    points, n = points_of(robot), robot.n
    base, radii = described.radii(robot)
    height = max(BASE_HEIGHT * abs(float(points[1][2])), LOWEST_BASE)
    out = [Shape(o.name, "obstacle", 0, o.geometry, np.asarray(o.pose), 0.0, hull=o.hull) for o in described.obstacles]
    out.append(Shape("base", "base", 0, coal.Cylinder(base, height), _placed(np.array([0, 0, height / 2])), 0.0, base))
    for k in range(n):
        # Where link 1 begins, the base is around it; below the foot there is none of it.
        start = _raised(points[k], points[k + 1], float(radii[k])) if k == 0 else points[k]
        if np.linalg.norm(points[k + 1] - points[k]) < SHORTEST_LINK:
            continue
        out.append(_capsule(k + 1, points[k], start, points[k + 1], float(radii[k])))
    if described.carried is not None:
        out.append(_carried(described.carried, robot, points[n - 1]))
    return out


def checked_pairs(
    described: WorldDescription, robot: RobotDescription, shapes: list[Shape]
) -> Iterator[tuple[Shape, Shape]]:
    """Pairs of a world's shapes that may not touch, the one nearer to the base first."""
    clearance, lengths = described.clearance, np.linalg.norm(np.diff(points_of(robot), axis=0), axis=1)
    base, moved = next(s for s in shapes if s.kind == "base"), _many_postures(robot)
    for i, a in enumerate(shapes):
        for b in shapes[i + 1 :]:
            if a.link == b.link or (a.kind == "obstacle" and b.link == 1 and carries(a, base, clearance)):
                continue
            close = float(lengths[a.link : b.link - 1].sum()) < a.radius + b.radius + clearance
            if a.kind == "obstacle" or (not close and not _touch_as_drawn(a, b, moved, clearance)):
                yield a, b
            elif not close:
                continue
            elif a.kind == "link" and b.on_flange:
                cut = _cut(robot, a, b, float(lengths[a.link - 1]), clearance)
                if cut is not None and (b.kind == "detector" or not _touch_as_drawn(cut, b, moved, clearance)):
                    yield cut, b


def _many_postures(robot: RobotDescription) -> Array:
    """How the links have moved from the zero posture at many postures within the limits ``(N, n + 1, 4, 4)``."""
    low = np.where(np.isfinite(robot.lower), robot.lower, -UNLIMITED)
    high = np.where(np.isfinite(robot.upper), robot.upper, UNLIMITED)
    q = np.random.default_rng(0).uniform(low, high, (POSTURES, robot.n))
    return joint_transforms(robot.screws, q @ np.asarray(robot.linkage).T)


def _touch_as_drawn(inner: Shape, outer: Shape, moved: Array, clearance: float) -> bool:
    """Whether two parts, whose sizes are guesses, touch in most of all postures; with a detector's body in all."""
    touch = [
        distance_of(inner.geometry, inner.at(G[inner.link]), outer.geometry, outer.at(G[outer.link])) <= clearance
        for G in moved
    ]
    return all(touch) if outer.kind == "detector" else float(np.mean(touch)) > TOUCH_AS_DRAWN


def carries(obstacle: Shape, base: Shape, clearance: float) -> bool:
    """Whether the robot stands on an obstacle: it reaches the foot of the base."""
    foot = coal.Cylinder(base.radius, FOOT)
    still = np.eye(4)
    return distance_of(obstacle.geometry, obstacle.at(still), foot, replace(base, pose=still).at(still)) <= clearance


def _cut(robot: RobotDescription, link: Shape, carried: Shape, length: float, clearance: float) -> Shape | None:
    """
    A link's capsule with its outer end cut back until what the flange carries is clear of it at a posture of the wrist.

    None: it never is, so that the two are one body for all that is said.
    """
    n = robot.n
    turned = np.array(list(product(QUARTERS, repeat=n - link.link)))
    turned = np.where([joint.kind == "prismatic" for joint in robot.joints[link.link :]], 0.0, turned)
    q = np.hstack([np.zeros((len(turned), link.link)), turned])
    places = [carried.at(G[carried.link]) for G in joint_transforms(robot.screws, q)]
    shift = np.eye(4)
    for back in np.arange(0.0, length, CUT * link.radius):
        shift[2, 3] = -0.5 * back
        shape = replace(link, geometry=coal.Capsule(link.radius, length - back), pose=link.pose @ shift)
        here = shape.at(np.eye(4))
        if max(distance_of(shape.geometry, here, carried.geometry, at) for at in places) > clearance:
            return shape
    return None


def _carried(carried: Carried, robot: RobotDescription, joint: Array) -> Shape:
    """What the flange carries; ``joint`` ``(3,)``: the last one's point."""
    pose = np.asarray(robot.flange) @ carried.pose
    apart = float(np.linalg.norm(pose[:3, 3] - joint))
    if len(carried.size) == 3:
        extent = apart + 0.5 * float(np.linalg.norm(carried.size))
        return Shape(carried.name, carried.name, robot.n, coal.Box(*carried.size), pose, extent)
    radius, length = carried.size
    geometry = coal.Capsule(radius, length)
    return Shape(carried.name, carried.name, robot.n, geometry, pose, apart + radius + 0.5 * length, radius)


def _capsule(number: int, joint: Array, start: Array, end: Array, radius: float) -> Shape:
    vector = end - start
    length = float(np.linalg.norm(vector))
    pose = _placed(0.5 * (start + end), vector / length)
    extent = float(np.linalg.norm(end - joint)) + radius
    return Shape(f"link {number}", "link", number, coal.Capsule(radius, length), pose, extent, radius)


def _raised(start: Array, end: Array, radius: float) -> Array:
    """The place between two points at which a ball of the radius just stands on the foot's plane z = 0."""
    rise = float(end[2] - start[2])
    share = (radius - float(start[2])) / rise if rise > 0 else 0.0
    return np.asarray(start + min(max(share, 0.0), 0.99) * (end - start))


def _placed(middle: Array, z: Array | None = None) -> Array:
    """A pose at ``middle`` with its z axis along ``z``."""
    out = np.eye(4)
    out[:3, 3] = middle
    if z is not None:
        out[:3, :3] = rotation_to(z)
    return out
