"""What the arm must not touch: the floor, itself, and obstacles of simple shapes; distances by coal.

The arm is a chain of capsules from each joint's point to the next one's, then to the flange and to the farthest tracked
point: what a description tells of a robot's body. Source of the distances: coal (Pan, Chitta, Manocha, FCL, ICRA 2012;
Montaut et al., GJK++, 2023), which comes with pin.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import coal  # type: ignore[import-untyped]  # generated wrappers without types, as pin's
import numpy as np

from clampid.stages.rows import Array, Bools
from experiments.plans.errors import PlanError
from experiments.plans.model import Cell
from kinematics.poe import joint_transforms
from kinematics.reading import read_text, toml_of
from kinematics.section import Section

__all__ = ["Obstacle", "Scene", "read_obstacles"]

RADIUS = 0.08  # m, of the arm's capsules
CLEARANCE = 0.02  # m, kept from everything
ALONG = 0.1  # rad between the configurations of a move that are looked at
ALWAYS = 0.5  # parts of the arm that touch in more of all postures are neighbours
BEAM = 0.01  # m, radius of a line of sight
TINY = 1e-6  # m: shorter parts have no body of their own
HALL = 100.0  # m: beyond, millimetres
MOST_TURNED = 4.0 * np.pi  # rad: beyond, degrees
UPRIGHT = 0.7  # cosine of the tilt up to which a base plane is a floor


@dataclass(frozen=True)
class Obstacle:
    """A shape at a place.

    Attributes
    ----------
    name
        For messages.
    kind
        ``box``, ``sphere`` or ``cylinder`` (its axis along z before it is turned).
    size
        m: edges ``(3,)``, radius ``(1,)``, radius and length ``(2,)``.
    centre
        ``(3,)`` m, base frame.
    rotation
        ``(3, 3)``.
    """

    name: str
    kind: str
    size: Array
    centre: Array
    rotation: Array

    @cached_property
    def solid(self) -> tuple[Any, Any]:
        """Shape and pose for coal."""
        match self.kind:
            case "box":
                shape = coal.Box(*map(float, self.size))
            case "sphere":
                shape = coal.Sphere(float(self.size[0]))
            case _:
                shape = coal.Cylinder(*map(float, self.size))
        return shape, coal.Transform3s(self.rotation, self.centre)


def read_obstacles(path: Path, cell: Cell) -> tuple[Obstacle, ...]:
    """Read obstacles from TOML: tables ``[[box]]``, ``[[sphere]]``, ``[[cylinder]]``, base frame, m and rad.

    Each has ``centre_m``; a box ``size_m`` (three edges), the others ``radius_m``, a cylinder ``length_m``; optional
    ``name``, and ``turn_rad``, a rotation vector.

    Raises
    ------
    PlanError
        The file is missing, no TOML, or a key is missing, unknown or wrong.
    """
    if not path.is_file():
        raise PlanError(f"{path}: expected a file of obstacles, found no such file")
    try:
        root = Section(toml_of(read_text(path)), str(path), error=PlanError)
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise PlanError(f"{path}: expected TOML, found {error}") from error
    found = []
    for kind in ("box", "sphere", "cylinder"):
        for number, one in enumerate(root.sections(kind, optional=True), 1):
            if kind == "box":
                size = one.vector("size_m", 3, 0.0, HALL, "m")
            else:
                size = np.array([one.number("radius_m", 0.0, HALL, "m", above=True)])
            if kind == "cylinder":
                size = np.r_[size, one.number("length_m", 0.0, HALL, "m", above=True)]
            turn = one.vector("turn_rad", 3, -MOST_TURNED, MOST_TURNED, "rad", np.zeros(3))
            centre = one.vector("centre_m", 3, -HALL, HALL, "m")
            found.append(Obstacle(one.text("name", default=f"{kind} {number}"), kind, size, centre, _rotation(turn)))
            one.done()
    root.done()
    return tuple(found)


def _rotation(turn: Array) -> Array:
    from kinematics.screws import exp_so3

    return np.asarray(exp_so3(turn))


class Scene:
    """Floor, obstacles and the arm itself.

    Parameters
    ----------
    cell
        Robot, tracked points and gravity.
    obstacles
        What stands around.
    floor
        Height of the floor above the base's origin, m, along what gravity says is up; None: no floor.
    radius
        Of the arm's capsules, m.
    """

    def __init__(
        self, cell: Cell, obstacles: Sequence[Obstacle] = (), floor: float | None = 0.0, radius: float = RADIUS
    ) -> None:
        if not radius > 0:
            raise PlanError(f"arm radius: expected metres above 0, found {radius:g}")
        self.cell, self.obstacles, self.floor, self.radius = cell, tuple(obstacles), floor, radius
        self.up = -cell.gravity / np.linalg.norm(cell.gravity)
        self.assumed: tuple[str, ...] = (f"the arm is a chain of capsules of radius {radius:g} m",)
        robot = cell.robot
        ends = [np.asarray(j.point) for j in robot.joints] + [robot.flange[:3, 3]]
        points = cell.targets.values() or (cell.tool_com,)
        far = max(points, key=lambda p: float(np.linalg.norm(p)))
        ends.append(robot.flange[:3, :3] @ far + robot.flange[:3, 3])
        self._ends = np.array(ends)  # (n + 2, 3) at the zero pose
        self._of = np.minimum(np.arange(1, len(ends)), robot.n)  # which link each capsule moves with

    @classmethod
    def floor_only(cls, cell: Cell) -> Scene:
        """The base's plane as floor, if the robot stands upright."""
        up = -cell.gravity / np.linalg.norm(cell.gravity)
        return cls(cell, floor=0.0 if up[2] > UPRIGHT else None)

    def placed(self, q: Array) -> tuple[Array, Array]:
        """Rotation ``(N, n + 1, 3, 3)`` and centre ``(N, n + 1, 3)``, m, of every capsule at q ``(N, n)``, rad."""
        chain = q @ np.asarray(self.cell.robot.linkage).T
        G = joint_transforms(self.cell.robot.screws, chain)[:, self._of]
        turn, centre = self._capsules_at_zero
        return G[..., :3, :3] @ turn, np.einsum("nkij,kj->nki", G[..., :3, :3], centre) + G[..., :3, 3]

    def clear(self, q: Array) -> Bools:
        """Whether configurations ``(N, n)``, rad, touch nothing ``(N,)``."""
        turn, centre = self.placed(q)
        out = np.ones(len(q), dtype=bool)
        if self.floor is not None:
            # The first link stands on the floor; what moves after it must not reach it.
            lowest = centre @ self.up - np.abs(turn[..., 2] @ self.up) * self._lengths / 2 - self.radius
            out = lowest[:, 1:].min(axis=1, initial=np.inf) > self.floor + CLEARANCE
            out &= (centre[:, 0] + turn[:, 0, :, 2] * self._lengths[0] / 2) @ self.up > self.floor
        for i in np.flatnonzero(out):
            out[i] = self._distance_kept(turn[i], centre[i])
        return out

    def way_clear(self, start: Array, end: Array) -> bool:
        """Whether a move, all joints in step, touches nothing on its way; ``(n,)`` rad each."""
        steps = max(2, int(np.ceil(np.max(np.abs(end - start)) / ALONG)) + 1)
        return bool(self.clear(start + np.linspace(0.0, 1.0, steps)[:, None] * (end - start)).all())

    def unhidden(self, q: Array, points: Array, station: Array) -> Bools:
        """Whether neither obstacles nor the arm stand between an instrument and tracked points ``(N,)``.

        Parameters
        ----------
        q
            ``(N, n)`` rad.
        points
            ``(N, t, 3)`` m, base frame.
        station
            ``(3,)`` m, base frame.

        The hand that carries the targets is left out: what it hides is said by where the targets look.
        """
        turn, centre = self.placed(q)
        out = np.ones(len(q), dtype=bool)
        solids = [obstacle.solid for obstacle in self.obstacles]
        inner = np.flatnonzero(self._lengths[: self.cell.robot.n - 1] > TINY)
        for i in range(len(q)):
            arm = [(self._shapes[k], coal.Transform3s(turn[i, k], centre[i, k])) for k in inner]
            rays = [_ray(station, point) for point in points[i]]
            out[i] = all(_distance(*ray, *solid) > 0 for ray in rays for solid in (*solids, *arm))
        return out

    def _distance_kept(self, turn: Array, centre: Array) -> bool:
        poses = [coal.Transform3s(R, c) for R, c in zip(turn, centre, strict=True)]
        shapes = self._shapes
        for obstacle in self.obstacles:
            solid = obstacle.solid
            if any(_distance(shapes[k], poses[k], *solid) < CLEARANCE for k in range(1, len(shapes))):
                return False
        return all(_distance(shapes[a], poses[a], shapes[b], poses[b]) >= CLEARANCE for a, b in self._pairs)

    @cached_property
    def _lengths(self) -> Array:
        return np.asarray(np.linalg.norm(np.diff(self._ends, axis=0), axis=1))

    @cached_property
    def _shapes(self) -> tuple[Any, ...]:
        return tuple(coal.Capsule(self.radius, float(length)) for length in self._lengths)

    @cached_property
    def _capsules_at_zero(self) -> tuple[Array, Array]:
        """Rotations ``(n + 1, 3, 3)``, z along each capsule, and centres ``(n + 1, 3)`` at the zero pose."""
        rotations = []
        for a, b, length in zip(self._ends[:-1], self._ends[1:], self._lengths, strict=True):
            if length < TINY:
                rotations.append(np.eye(3))
                continue
            rotations.append(_along((b - a) / length))
        return np.array(rotations), (self._ends[:-1] + self._ends[1:]) / 2

    @cached_property
    def _pairs(self) -> tuple[tuple[int, int], ...]:
        """Parts of the arm that could hit each other: not neighbours, and not always close together."""
        robot = self.cell.robot
        slides = np.array([joint.kind == "prismatic" for joint in robot.joints])
        slides &= np.isfinite(robot.lower) & np.isfinite(robot.upper)  # rad would be metres, and nothing near
        low, high = np.where(slides, robot.lower, -np.pi), np.where(slides, robot.upper, np.pi)
        turn, centre = self.placed(np.random.default_rng(0).uniform(low, high, (200, robot.n)))
        poses = [[coal.Transform3s(R, c) for R, c in zip(*row, strict=True)] for row in zip(turn, centre, strict=True)]
        shapes, pairs = self._shapes, []
        for a, b in combinations(np.flatnonzero(self._lengths > TINY), 2):
            close = [_distance(shapes[a], pose[a], shapes[b], pose[b]) < CLEARANCE for pose in poses]
            if b - a > 1 and np.mean(close) < ALWAYS:
                pairs.append((int(a), int(b)))
        return tuple(pairs)


def _along(z: Array) -> Array:
    """A rotation ``(3, 3)`` whose third column is the unit vector ``z``."""
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _ray(start: Array, end: Array) -> tuple[Any, Any]:
    """The line of sight between two points, as a thin capsule."""
    length = float(np.linalg.norm(end - start))
    turn = _along((end - start) / length) if length > TINY else np.eye(3)
    return coal.Capsule(BEAM, length), coal.Transform3s(turn, (start + end) / 2)


def _distance(one: Any, at: Any, other: Any, there: Any) -> float:
    return float(coal.distance(one, at, other, there, coal.DistanceRequest(), coal.DistanceResult()))
