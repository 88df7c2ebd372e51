"""The world of a detector's cell: its bodies, made once."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from kinematics.collision.mesh import MeshError
from kinematics.collision.obstacles import sheets_among
from kinematics.collision.world import World
from offline_ik.errors import CellError

if TYPE_CHECKING:
    from offline_ik.cell.cell import Cell
    from offline_ik.inverse.detector import Detector
    from offline_ik.inverse.detector_parts import DetectorParts

__all__ = ["sheets_of", "world_of"]


def world_of(detector: Detector) -> World:
    """The world of a detector, whatever its temperatures; made once.

    Raises
    ------
    CellError
        The file of a mesh is none.
    """
    return _world_of(detector.parts)


@lru_cache(maxsize=8)
def _world_of(parts: DetectorParts) -> World:
    try:
        return World(parts.robot, parts.cell.world)
    except MeshError as error:
        raise CellError(str(error)) from None


def sheets_of(cell: Cell) -> list[str]:
    """Notes on meshes that are flat."""
    return sheets_among(cell.obstacles)
