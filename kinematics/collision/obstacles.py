"""What stands around an arm: bodies of simple shapes, half-spaces such as a floor, and meshes; read from TOML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import coal  # type: ignore[import-untyped]  # generated wrappers without types, as pin's
import numpy as np

from kinematics.collision.mesh import SHEET, Mesh, MeshError, read_mesh
from kinematics.section import Section
from kinematics.typing_ import Array

__all__ = [
    "FARTHEST_OBSTACLE",
    "SHAPES",
    "Obstacle",
    "ObstacleShape",
    "floor_at",
    "obstacles_of",
    "pose_of",
    "rotation_to",
    "sheets_among",
]

ObstacleShape = Literal["box", "cylinder", "sphere", "capsule", "half_space", "mesh"]

FARTHEST_OBSTACLE = 100.0  # m: of an obstacle, and of its edges; beyond, millimetres
LONGEST_PATH = 4096  # characters
SHORTEST_DIRECTION = 1e-9
MOST_SKEWED = 1e-6  # cosine between two directions that are perpendicular but for rounding
SHAPES: Mapping[ObstacleShape, int] = {"box": 3, "cylinder": 2, "sphere": 1, "capsule": 2, "half_space": 0, "mesh": 0}
"""Each shape and how many sizes it has."""


@dataclass(frozen=True)
class Obstacle:
    """
    A thing in the robot's way.

    Attributes
    ----------
    size
        m. Box: x, y, z edges; cylinder and capsule: radius, length along z; sphere: radius; half-space and mesh: none.
    pose
        ``(4, 4)``: its middle in the robot's base frame. A half-space is all that lies below z = 0 of its own.
    file
        Of a mesh (STL, OBJ, DAE; m).
    holds_sample
        The sample may lie inside (a cryostat's shroud, a stage drawn as one box).
    """

    name: str
    shape: ObstacleShape
    size: tuple[float, ...]
    pose: Array
    file: Path | None = None
    holds_sample: bool = False

    @cached_property
    def geometry(self) -> Any:
        """
        Its surface, of `coal`, m.

        Raises
        ------
        MeshError
            Its file is no mesh.
        """
        match self.shape:
            case "box":
                return coal.Box(*self.size)
            case "cylinder":
                return coal.Cylinder(*self.size)
            case "capsule":
                return coal.Capsule(*self.size)
            case "sphere":
                return coal.Sphere(*self.size)
            case "half_space":
                return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
            case "mesh":
                return self.mesh.surface()

    @cached_property
    def hull(self) -> Any:
        """Of a mesh, which has no inside: its convex hull, of `coal`; None of the others."""
        return self.mesh.hull() if self.shape == "mesh" else None

    @property
    def mesh(self) -> Mesh:
        """The mesh in its file; raises MeshError where there is none."""
        if self.file is None:
            raise MeshError(f"obstacle {self.name}: expected the file of its mesh, found none")
        try:
            return read_mesh(self.file)
        except MeshError as error:
            raise MeshError(f"obstacle {self.name}: {self.file} is no mesh: {error}") from None

    @property
    def place(self) -> Any:
        """Where it is, for `coal`."""
        return coal.Transform3s(self.pose[:3, :3].copy(), self.pose[:3, 3].copy())


def rotation_to(z: Array) -> Array:
    """A rotation ``(3, 3)`` whose third column is the unit vector ``z`` ``(3,)``."""
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def floor_at(height: float, up: Array) -> Obstacle:
    """All that lies lower than ``height``, m, above the base's origin along the unit vector ``up`` ``(3,)``."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_to(up)
    pose[:3, 3] = height * np.asarray(up)
    return Obstacle("floor", "half_space", (), pose)


def obstacles_of(parts: list[Section], folder: Path) -> tuple[Obstacle, ...]:
    """
    Obstacles from the tables ``[[obstacle]]`` of a file in ``folder``; each must have a name of its own.

    Raises
    ------
    ValueError
        The sections' own: a key is missing, unknown or wrong, or a mesh has no file.
    """
    out: list[Obstacle] = []
    for count, at in enumerate(parts, 1):
        name, shape = at.text("name", default=f"obstacle {count}"), at.text("shape", tuple(SHAPES))
        if name in [o.name for o in out]:
            raise at.fault("name", "a name of its own", f"{name!r} twice")
        size: tuple[float, ...] = ()
        file = None
        if shape == "mesh":
            file = folder / at.text("file", longest=LONGEST_PATH)
            if not file.is_file():
                raise at.fault("file", f"a mesh at {file}", "none")
        elif SHAPES[shape]:
            size = tuple(at.vector("size_m", SHAPES[shape], 0.0, FARTHEST_OBSTACLE, "m", above=True).tolist())
        out.append(Obstacle(name, shape, size, pose_of(at, FARTHEST_OBSTACLE), file, at.flag("holds_sample", False)))
        at.done()
    return tuple(out)


def pose_of(at: Section, most: float) -> Array:
    """A pose ``(4, 4)`` from ``position_m``, at most ``most`` off, and the directions ``x`` and ``z``; y follows."""
    z, x = at.vector("z", default=np.array([0.0, 0.0, 1.0])), at.vector("x", default=np.array([1.0, 0.0, 0.0]))
    lengths = float(np.linalg.norm(x)), float(np.linalg.norm(z))
    if min(lengths) < SHORTEST_DIRECTION or abs(float(x @ z)) > MOST_SKEWED * lengths[0] * lengths[1]:
        raise at.fault("", "x and z perpendicular directions", f"{x.tolist()} and {z.tolist()}")
    x, z = x / lengths[0], z / lengths[1]
    out = np.eye(4)
    out[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    out[:3, 3] = at.vector("position_m", 3, -most, most, "m", np.zeros(3))
    return out


def sheets_among(obstacles: tuple[Obstacle, ...]) -> list[str]:
    """What to say of meshes that are flat."""
    flat = [o.name for o in obstacles if o.shape == "mesh" and o.mesh.thickened]
    return [f"obstacle {name}: the mesh is flat; it counts as a sheet {1e3 * SHEET:g} mm thick" for name in flat]
