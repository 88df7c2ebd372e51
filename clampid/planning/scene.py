"""What the arm of a plan must not touch, and what hides its tracked points from an instrument.

The world and the check are those of `ik` and of the server (:mod:`kinematics.collision`), so that what is clear here is
clear there. Where no cell file says what the flange carries, it is a capsule to the farthest tracked point.
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

BEAM = 0.01  # m, radius of a line of sight
SHORTEST_BEAM = 1e-6  # m
UPRIGHT = 0.7  # cosine of the tilt up to which a base plane is a floor


class Scene:
    """The arm of a cell in a described world.

    Parameters
    ----------
    cell
        Robot, tracked points and gravity.
    described
        The world.
    assumed
        What of it nobody said, in words.

    Raises
    ------
    PlanError
        The file of a mesh is none.
    """

    def __init__(self, cell: Cell, described: WorldDescription, assumed: Sequence[str] = ()) -> None:
        self.cell, self.assumed = cell, tuple(assumed)
        try:
            self.world = World(cell.robot, described)
        except MeshError as error:
            raise PlanError(str(error)) from None
        # What hides a point: not half-spaces, and not the hand that carries the targets.
        self._hiding = [
            k
            for k, shape in enumerate(self.world.shapes)
            if shape.link < cell.robot.n and not isinstance(shape.geometry, coal.Halfspace)
        ]

    @classmethod
    def around(
        cls, cell: Cell, obstacles: Sequence[Obstacle] = (), floor: float | None = 0.0, radius: float | None = None
    ) -> Scene:
        """A floor, obstacles, and an arm that carries a tool as long as its farthest tracked point is away.

        Parameters
        ----------
        floor
            Height above the base's origin, m, along what gravity says is up; None: no floor.
        radius
            Of all links and the tool, m; None: links as guessed from the arm's reach, the tool as the last of them.

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
        """The world of a cell file of `ik` and `serve`; obstacles, a floor and a radius of the links beside it.

        Raises
        ------
        PlanError
            The file is wrong, or of another robot, or the radius is not above 0.
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
        """The base's plane as floor, if the robot stands upright."""
        return cls.around(cell, floor=usual_floor(cell))

    def clear(self, q: Array) -> Bools:
        """Whether configurations ``(N, n)``, rad, touch nothing ``(N,)``."""
        return self.world.clear(q)

    def way_clear(self, start: Array, end: Array) -> bool:
        """Whether a move, all joints in step, touches nothing on its way; ``(n,)`` rad each."""
        return move_clear(self.world, start, end)

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
        placed = self.world.at(q)
        out = np.ones(len(q), dtype=bool)
        for i in range(len(q)):
            bodies = [(self.world.shapes[k].geometry, placed.place(i, k)) for k in self._hiding]
            rays = [_ray(station, point) for point in points[i]]
            out[i] = all(distance_of(*ray, *body) > 0 for ray in rays for body in bodies)
        return out


def usual_floor(cell: Cell) -> float | None:
    """The height of the floor where nobody says, m: the base's plane if the robot stands upright, or none."""
    return 0.0 if _up(cell)[2] > UPRIGHT else None


def with_radius(described: WorldDescription, cell: Cell, radius: float | None) -> WorldDescription:
    """The world with all links of one radius, m; None: as it is.

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
    base, radii = described.radii(cell.robot)
    links = dict.fromkeys(f"{radius:.2g}" for radius in radii.tolist())
    return f"the arm is a chain of capsules; radius of the base {base:.2g} m, of the links {', '.join(links)} m"


def _up(cell: Cell) -> Array:
    return np.asarray(-cell.gravity / np.linalg.norm(cell.gravity))


def _tool(cell: Cell, radius: float) -> Carried | None:
    """What reaches from the flange to the farthest tracked point, or to the tool's centre of mass."""
    points = cell.targets.values() or (cell.tool_com,)
    return carried_capsule(max(points, key=lambda p: float(np.linalg.norm(p))), radius)


def _ray(start: Array, end: Array) -> tuple[Any, Any]:
    """The line of sight between two points, as a thin capsule."""
    length = float(np.linalg.norm(end - start))
    turn = rotation_to((end - start) / length) if length > SHORTEST_BEAM else np.eye(3)
    return coal.Capsule(BEAM, length), coal.Transform3s(turn, (start + end) / 2)
