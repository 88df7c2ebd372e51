"""The thesis' worked example: displacement by arm-side friction on axis 5 at a lever of 153 mm.

A virtual robot has the springs that the thesis prints. They are identified from its clamped sweeps. The displacement
F·C₅₅·lever is then computed for the thesis' friction of 8.03 Nm in two ways: with spring 5 alone, C₅₅ = T₅₅²/k₅, and
with the whole matrix Tᵀ·diag(1/k)·T. Source:
the thesis, worked example and appendix, as read in appendix_data/DERIVATION.md.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from clampid.identification.identify import identify
from clampid.models.drives import Drives, drives_of, effective_compliance
from clampid.models.model import ModelError, StageModel
from clampid.role_slots import has_role
from clampid.stages.rows import Array
from experiments.campaign import read_campaign
from experiments.simulate import simulate
from experiments.virtual_robot import Plant
from kinematics.description import load_robot
from kinematics.robot import RobotDescription
from kinematics.transmission import Transmission

__all__ = ["AXIS", "FRICTION", "LEVER", "WorkedExample", "displacement", "worked_example"]

ROBOT = "kuka_kr20_r1810"
AXIS = 4  # from 0
FRICTION = 8.03  # Nm at the joint, arm side, as the thesis states it
LEVER = 0.153  # m, from axis 5 to the flange


@dataclass(frozen=True)
class WorkedExample:
    """The example with the printed constants, and with those identified from the campaign.

    Attributes
    ----------
    printed_spring
        ``(n,)`` Nm/rad at the motors.
    printed_alone, printed_full
        m: displacement by the printed constants, spring 5 alone and the whole matrix.
    drives
        Result of the clamped sweeps.
    alone, full
        m, value and standard error, as found.
    """

    printed_spring: Array
    printed_alone: float
    printed_full: float
    drives: Drives
    alone: tuple[float, float]
    full: tuple[float, float]

    def to_json(self) -> dict[str, Any]:
        """For programs; SI."""
        return {
            "printed": {
                "stiffness_Nm_rad": self.printed_spring.tolist(),
                "friction_Nm": FRICTION,
                "alone_m": self.printed_alone,
                "full_m": self.printed_full,
            },
            "found": {
                "drives": self.drives.to_json(),
                "alone_m": self.alone[0],
                "alone_std_m": self.alone[1],
                "full_m": self.full[0],
                "full_std_m": self.full[1],
            },
        }


def worked_example(
    folder: str | Path, seed: int = 0, *, working: Callable[[str], AbstractContextManager[None]] | None = None
) -> WorkedExample:
    """Measure the campaign on the virtual robot, identify the springs, and compute the displacements.

    Parameters
    ----------
    folder
        Where the campaign goes; new or empty.
    seed
        Which individual (all but the printed constants is drawn), programs and noise.
    working
        Progress of the long steps.

    Raises
    ------
    CampaignError
        The folder exists and is not empty.
    """
    step = working or (lambda text: nullcontext())
    robot = load_robot(ROBOT)
    if robot.motor_spring is None:
        raise ModelError(f"{robot.name}: expected the printed springs in its description, found none")
    spring = np.array(robot.motor_spring, dtype=float)

    def printed(plant: Plant) -> Plant:
        return replace(plant, drive=replace(plant.drive, spring=spring))

    with step("measuring"):
        simulate(folder, ROBOT, seed=seed, tables=("clamped",), alter=printed)
    with step("identifying"):
        clamped = identify(read_campaign(folder), seed=seed).stages["clamped"]
    own = Transmission(robot.transmission).joint_compliance(spring)
    alone, full = displacement(clamped, robot)
    return WorkedExample(
        printed_spring=spring,
        printed_alone=float(FRICTION * np.asarray(robot.transmission)[AXIS, AXIS] ** 2 / spring[AXIS] * LEVER),
        printed_full=float(FRICTION * own[AXIS, AXIS] * LEVER),
        drives=drives_of(clamped, robot),
        alone=alone,
        full=full,
    )


def displacement(clamped: StageModel, robot: RobotDescription) -> tuple[tuple[float, float], tuple[float, float]]:
    """Displacement by the friction on axis 5 at the lever, m, value and standard error: spring 5 alone, whole matrix.

    Parameters
    ----------
    clamped
        A stage with springs, in any order of its slots.
    robot
        Whose transmission joins motors and joints.
    """
    _, by = effective_compliance(clamped, robot)
    entry = by.reshape(robot.n, robot.n, -1)[AXIS, AXIS]
    own = [s.place == f"joint{AXIS + 1}" and has_role(s, "compliance") for s in clamped.slots]
    force = FRICTION * LEVER
    found = []
    for row in (np.where(own, entry, 0.0), entry):
        spread = float(np.sqrt(max(row @ clamped.covariance @ row, 0.0)))
        found.append((force * float(row @ clamped.theta), force * spread))
    return found[0], found[1]
