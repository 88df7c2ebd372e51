"""The virtual robot for the runner, in this process: plan, measure and identify without a robot."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from experiments.plans.errors import PlanError
from experiments.plans.model import Plan
from experiments.plans.motion import Array, Course
from experiments.plans.runner import run_plan
from experiments.virtual_robot import Hidden, Session
from kinematics.description import RobotDescription

__all__ = ["VirtualRobot", "run_virtually"]


class VirtualRobot:
    """An individual of a robot, as `experiments.plans.seam.RobotSeam` wants it.

    Parameters
    ----------
    robot
        The nominal robot.
    hidden
        Hidden effects of this individual: ``effect``, ``effect@joint3``, ``effect@joint3:2.0``.
    seed
        Which individual, and which noise.
    """

    def __init__(self, robot: RobotDescription, hidden: Sequence[str | Hidden] = (), *, seed: int = 0) -> None:
        try:
            asked = [Hidden.parse(item) if isinstance(item, str) else item for item in hidden]
            self.session = Session(robot, asked, seed=seed)
        except ValueError as error:  # the virtual robot says every refusal as a plain ValueError
            raise PlanError(str(error)) from error

    def declared(self) -> Mapping[str, Any]:
        """Gravity, tool, targets and instrument of the virtual cell."""
        return self.session.header()

    def log(self, course: Course, rate: float) -> pd.DataFrame:
        """Follow a course; the virtual robot logs at its own 10 Hz."""
        return self.session.log(course)

    def clamp(self, posture: Array) -> None:
        """Clamp the flange."""
        self.session.clamp(posture)

    def press(self, joint: int, offset: Array, dwell: float) -> Iterator[Mapping[str, float]]:
        """Give the readings one by one; a step is made only when its reading is requested."""
        # A later step changes nothing in an earlier one, so that all may be worked out at once.
        for row in self.session.sweep(joint, offset, dwell).to_dict("records"):
            yield {str(key): float(value) for key, value in row.items()}

    def release(self) -> None:
        """Open the clamp."""
        self.session.release()

    def visit(self, course: Course, targets: Sequence[str], measure_time: float) -> pd.DataFrame:
        """Go there and measure."""
        return self.session.visit(course, targets, measure_time)


def run_virtually(
    plan: Plan,
    folder: str | Path,
    hidden: Sequence[str | Hidden] = (),
    *,
    seed: int = 0,
    file_format: Literal["csv", "parquet"] = "parquet",
) -> Path:
    """Run a plan on a virtual robot and write the campaign.

    Parameters
    ----------
    plan
        The plan; its tool and targets are those of the virtual cell unless it was made for another.
    folder
        The campaign; new or empty.
    hidden
        Effects to hide.
    seed
        Which individual and noise.

    Raises
    ------
    PlanError
        The plan is beyond its limits, or an effect cannot be hidden.
    PlanStopped
        A step came to a limit when it was run.
    """
    return run_plan(plan, VirtualRobot(plan.cell.robot, hidden, seed=seed), folder, file_format=file_format)
