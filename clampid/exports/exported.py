"""What every export states: its file, its temperature, and its error against the whole model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clampid.exports.form_error import Flange, LeftOut, Measured, left_out, measured_error
from clampid.models.model import Model
from experiments.campaign import Campaign
from kinematics.robot import RobotDescription

__all__ = ["EXACT", "Exported", "checked"]

EXACT = 1e-9  # m and rad: what an export may differ from the model, read back


@dataclass(frozen=True, eq=False)
class Exported:
    """A file of the calibrated robot, read back, and what it leaves of the model.

    Attributes
    ----------
    text
        The file.
    temperature
        Of all links, °C.
    difference
        By how much the file, read back, differs at most from the calibrated chain, m.
    left
        What it leaves of the whole model over the workspace.
    measured
        What it alone leaves of measured points; None without a campaign.
    fixed
        Combinations of parameters that the data do not determine; the file has them at their nominal value.
    """

    text: str
    temperature: float
    difference: float
    left: LeftOut
    measured: Measured | None
    fixed: tuple[str, ...] = ()

    @property
    def said(self) -> tuple[str, ...]:
        """What it leaves, in sentences."""
        lines = [str(self.left), f"not in it: {self.left.worth}"]
        lines += [] if self.measured is None else [f"this alone leaves {self.measured}"]
        return (*lines, *self.cautions)

    @property
    def cautions(self) -> tuple[str, ...]:
        """What the data do not determine, and what a reader may take for something else."""
        said = "not determined by the data, fixed at its nominal value: a combination of "
        return tuple(f"{said}{words}" for words in self.fixed)

    def to_json(self) -> dict[str, Any]:
        """For programs; SI but for the temperatures."""
        out = {"temperature_C": self.temperature, "difference_m": self.difference, **self.left.to_json()}
        out["held_at_nominal"] = list(self.fixed)
        out["measured"] = None if self.measured is None else self.measured.to_json()
        return out


def checked(
    form: Flange,
    model: Model,
    robot: RobotDescription,
    session: int,
    temperature: float,
    campaign: Campaign | None,
    user_effects: Path | None,
) -> tuple[LeftOut, Measured | None]:
    """What a form leaves of the whole model, and of measured points where there are any."""
    measured = None if campaign is None else measured_error(form, model, session, campaign)
    left = left_out(
        form, model, robot, session=session, temperature=temperature, campaign=campaign, user_effects=user_effects
    )
    return left, measured
