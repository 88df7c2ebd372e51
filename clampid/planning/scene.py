"""Obstacles of a plan: collisions of the arm, and occlusion of its tracked points.

The world and the collision check are those of `ik` and of the server (:mod:`kinematics.collision`). A configuration
that is clear in a plan is therefore clear there. If no cell file describes what the flange carries, it is a capsule to
the farthest tracked point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import coal  # type: ignore[import-untyped]  # generated wrappers without types, as pin's
import numpy as np

from clampid.stages.rows import Array, Bools
from experiments.plans.errors import PlanError
from experiments.plans.model import Cell
from kinematics.collision.bodies import Carried, WorldDescription, carried_capsule, distance_of
from kinematics.collision.mesh import MeshError
from kinematics.collision.moves import move_clear
from kinematics.collision.obstacles import Obstacle, floor_at, rotation_to
from kinematics.collision.reading import read_world
from kinematics.collision.world import World

__all__ = ["Scene", "usual_floor"]

BEAM_RADIUS = 0.01  # m: of a line of sight
SHORTEST_BEAM = 1e-6  # m: a shorter line of sight has no direction
UPRIGHT = 0.7  # least cosine of the tilt at which the base's plane is taken as the floor


class Scene:
    """The arm of a cell among its obstacles.

    Parameters
    ----------
    cell
        Robot, tracked points and gravity.
    described
        Description of the world.
    assumed
        Assumptions in this description, in words.

    Raises
    ------
    PlanError
        A file of a mesh cannot be read.
    """

    def __init__(self, cell: Cell, described: WorldDescription, assumed: Sequence[str] = ()) -> None:
        self.cell, self.assumed = cell, tuple(assumed)
        try:
            self.world = World(cell.robot, described)
        except MeshError as error:
            raise PlanError(str(error)) from None
        # Shapes that can hide a point: all but half-spaces and the hand that carries the targets.
        self._hiding = [
            k
            for k, shape in enumerate(self.world.shapes)
            if shape.link < cell.robot.n and not isinstance(shape.geometry, coal.Halfspace)
        ]

    @classmethod
    def around(
        cls, cell: Cell, obstacles: Sequence[Obstacle] = (), floor: float | None = 0.0, radius: float | None = None
    ) -> Scene:
        """A scene of a floor and obstacles, with a tool that reaches to the farthest tracked point.

        Parameters
        ----------
        cell
            Robot, tracked points and gravity.
        obstacles
            Obstacles, base frame.
        floor
            Height of the floor above the base's origin, m, against gravity; None: no floor.
        radius
            Radius of all links and the tool, m; None: links as guessed from the arm's reach, the tool as the last one.

        Raises
        ------
        PlanError
            The radius is not above 0.
        """
        standing = () if floor is None else (floor_at(floor, _up(cell)),)
        described = replace(with_radius(WorldDescription(), cell, radius), obstacles=(*standing, *obstacles))
        carried = _tool(cell, float(described.radii(cell.robot)[1][-1]))
        return cls(cell, replace(described, carried=carried), (_thickness(described, cell),))

    @classmethod
    def of_cell_file(
        cls, cell: Cell, path: Path, obstacles: Sequence[Obstacle] = (), floor: float | None = None,
        radius: float | None = None,
    ) -> Scene:  # fmt: skip
        """A scene from a cell file of `ik` and `serve`; obstacles, floor and radius are added as in :meth:`around`.

        Raises
        ------
        PlanError
            The file is wrong or of another robot, or the radius is not above 0.
        """
        described = read_world(path, cell.robot, PlanError)
        more = () if floor is None else (floor_at(floor, _up(cell)),)
        described = replace(described, obstacles=(*described.obstacles, *more, *obstacles))
        scene = cls(cell, with_radius(described, cell, radius))
        if usual_floor(cell) is not None and not scene.world.stands_on:
            scene.assumed += (f"no floor: nothing in {path.name} reaches the foot of the base",)
        if scene.world.described.link_radii is None:
            scene.assumed += (_thickness(scene.world.described, cell),)
        return scene

    @classmethod
    def floor_only(cls, cell: Cell) -> Scene:
        """A scene with the base's plane as floor, if the robot stands upright; else an empty one."""
        return cls.around(cell, floor=usual_floor(cell))

    def clear(self, q: Array) -> Bools:
        """Whether configurations ``q`` ``(N, n)``, rad, are free of collisions ``(N,)``."""
        return self.world.clear(q)

    def way_clear(self, start: Array, end: Array) -> bool:
        """Whether a synchronous move of all joints from ``start`` to ``end`` ``(n,)``, rad, is free of collisions."""
        return move_clear(self.world, start, end)

    def unhidden(self, q: Array, points: Array, station: Array) -> Bools:
        """Whether all lines of sight to the tracked points are free of obstacles and of the arm ``(N,)``.

        The hand that carries the targets is left out: the acceptance angle of the targets accounts for it.

        Parameters
        ----------
        q
            Joint angles ``(N, n)``, rad.
        points
            Tracked points ``(N, t, 3)``, m, base frame.
        station
            Position of the instrument ``(3,)``, m, base frame.
        """
        placed = self.world.at(q)
        out = np.ones(len(q), dtype=bool)
        for i in range(len(q)):
            bodies = [(self.world.shapes[k].geometry, placed.place(i, k)) for k in self._hiding]
            rays = [_ray(station, point) for point in points[i]]
            out[i] = all(distance_of(*ray, *body) > 0 for ray in rays for body in bodies)
        return out


def usual_floor(cell: Cell) -> float | None:
    """Height of the floor, m, if none is given: that of the base's plane if the robot stands upright, else None."""
    return 0.0 if _up(cell)[2] > UPRIGHT else None


def with_radius(described: WorldDescription, cell: Cell, radius: float | None) -> WorldDescription:
    """The world with one radius, m, for all links; unchanged if ``radius`` is None.

    Raises
    ------
    PlanError
        The radius is not above 0.
    """
    if radius is None:
        return described
    if not radius > 0:
        raise PlanError(f"arm radius: expected metres above 0, found {radius:g}")
    return replace(described, link_radii=np.full(cell.robot.n, radius))


def _thickness(described: WorldDescription, cell: Cell) -> str:
    """The radii of base and links in words."""
    base, radii = described.radii(cell.robot)
    links = dict.fromkeys(f"{radius:.2g}" for radius in radii.tolist())
    return f"the arm is a chain of capsules; radius of the base {base:.2g} m, of the links {', '.join(links)} m"


def _up(cell: Cell) -> Array:
    """Unit vector against gravity ``(3,)``, base frame."""
    return np.asarray(-cell.gravity / np.linalg.norm(cell.gravity))


def _tool(cell: Cell, radius: float) -> Carried | None:
    """The tool as a capsule from the flange to the farthest tracked point, or else to the tool's centre of mass."""
    points = cell.targets.values() or (cell.tool_com,)
    return carried_capsule(max(points, key=lambda p: float(np.linalg.norm(p))), radius)


def _ray(start: Array, end: Array) -> tuple[Any, Any]:
    """The line of sight between two points, as a thin capsule."""
    length = float(np.linalg.norm(end - start))
    turn = rotation_to((end - start) / length) if length > SHORTEST_BEAM else np.eye(3)
    return coal.Capsule(BEAM_RADIUS, length), coal.Transform3s(turn, (start + end) / 2)
