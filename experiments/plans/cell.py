"""The cell of a plan: from a campaign measured in it, or as in the example of the campaign format."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from experiments.campaign import Campaign
from experiments.header import Header, read_header
from experiments.plans.errors import PlanError
from experiments.plans.model import Cell
from kinematics.description import DescriptionError, load_robot

__all__ = ["POSITION_STD", "cell_like", "cell_of"]

GRAVITY = (0.0, 0.0, -9.81)
TOOL_MASS, TOOL_COM = 12.0, (0.0, 0.0, 0.08)
TARGETS = {"T1": (0.10, 0.0, 0.12), "T2": (-0.05, 0.0866, 0.12), "T3": (-0.05, -0.0866, 0.12)}
POSITION_STD = 5e-5  # m: a laser tracker with the robot's repeatability


def cell_of(robot: str, like: Path | None = None) -> tuple[Cell, tuple[str, ...]]:
    """The cell, and in words what had to be assumed.

    Parameters
    ----------
    robot
        Name of a bundled robot, or path of a description.
    like
        A campaign folder whose ``campaign.toml`` says robot, tool, targets, instrument and gravity.

    Raises
    ------
    PlanError
        There is no such robot, or the campaign is of another.
    CampaignError
        The campaign's header does not follow its contract.
    """
    try:
        description = load_robot(robot)
    except DescriptionError as error:
        raise PlanError(str(error)) from error
    if like is None:
        cell = Cell(
            robot=description,
            reference=robot,
            gravity=np.array(GRAVITY),
            tool_mass=TOOL_MASS,
            tool_com=np.array(TOOL_COM),
            targets={name: np.array(point) for name, point in TARGETS.items()},
            instrument="laser tracker",
            position_std=POSITION_STD,
        )
        assumed = (
            f"a tool of {TOOL_MASS:g} kg, {TOOL_COM[2]:g} m out of the flange, targets {', '.join(TARGETS)}, an "
            "upright robot (a campaign given as --like says what there is)"
        )
        return cell, (assumed,)
    header = read_header(like)
    if header.robot.name != description.name:
        raise PlanError(f"{like}: expected a campaign of {description.name}, found one of {header.robot.name}")
    return replace(cell_like(header), robot=description, reference=robot), ()


def cell_like(measured: Header | Campaign, unstated: float = POSITION_STD) -> Cell:
    """The cell in which a campaign was measured.

    Parameters
    ----------
    measured
        A campaign, or its header alone; the cell calls the robot by its name.
    unstated
        m: standard deviation of a position where the instrument states none of its own (polar ones).
    """
    return Cell(
        robot=measured.robot,
        reference=measured.robot.name,
        gravity=np.array(measured.gravity, dtype=float),
        tool_mass=measured.tool.mass,
        tool_com=np.array(measured.tool.com, dtype=float),
        targets={name: np.array(point) for name, point in measured.targets.items()},
        instrument=measured.instrument.name,
        position_std=measured.instrument.position_std or unstated,
    )
