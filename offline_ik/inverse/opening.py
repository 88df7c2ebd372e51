"""A detector from a model's file, or a model, and a cell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from clampid.models.described import robot_of
from clampid.models.model import Model, load_model
from kinematics.description import load_robot
from kinematics.robot import RobotDescription
from offline_ik.arm.identified import arm_of
from offline_ik.cell.cell import Cell, default_cell, read_cell
from offline_ik.errors import CellError
from offline_ik.inverse.detector import Detector

__all__ = ["open_detector"]


def open_detector(
    model: Model | str | Path,
    cell: Cell | str | Path | None = None,
    *,
    robot: RobotDescription | str | Path | None = None,
    user_effects: Path | None = None,
) -> Detector:
    """A model in a cell.

    Parameters
    ----------
    model
        A model or the path of its file.
    cell
        A cell or the path of its file; without one, the placeholder of :func:`offline_ik.cell.cell.default_cell`.
    robot
        The nominal robot, where it is not a bundled one.

    Raises
    ------
    ModelError, DescriptionError, CellError
        One of them cannot be read, or they do not fit each other.
    DetectorError
        The arm is none that can carry a detector: see :class:`Detector`.
    """
    loaded = model if isinstance(model, Model) else load_model(model)
    given = robot if robot is None or isinstance(robot, RobotDescription) else load_robot(robot)
    described = robot_of(loaded, given)
    if cell is None:
        cell = default_cell(described)
        if given is None:
            cell = replace(cell, assumed=(f"robot {described.name}, the model's", *cell.assumed))
    placed = cell if isinstance(cell, Cell) else read_cell(cell, described)
    arm = arm_of(
        loaded,
        robot=described,
        gravity=placed.gravity,
        tool_mass=placed.tool_mass,
        tool_com=placed.tool_com,
        session=placed.session,
        user_effects=user_effects,
    )
    try:
        return Detector(arm, placed)
    except CellError as error:
        if isinstance(cell, Cell):
            raise
        raise CellError(f"{cell}: {error}") from None
