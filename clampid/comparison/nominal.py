"""Errors of the nominal robot, the reference that a model must improve on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from clampid.comparison.attained import as_sent
from clampid.effect import Effect, Stage
from clampid.fitting.accuracy import noise_floor, predicted, rms_of
from clampid.identification.model_on_campaign import ModelOnCampaign, on_campaign
from clampid.models.model import Model
from clampid.stages.rows import Bools, Rows
from clampid.stages.stage_kind import kind_of, only_of
from experiments.campaign import Campaign

__all__ = ["nominal_errors", "nominal_points"]


def nominal_errors(
    model: Model, campaigns: Campaign | Sequence[Campaign], user_effects: Path | None = None
) -> dict[Stage, float]:
    """The rms error of each stage with the robot description alone, over all campaigns.

    Poses: position errors, m, with base and targets fitted to the same rows, since a description does not have them.
    Free air: torque errors in units of each motor's noise, with the described masses and no friction. Clamped sweeps
    have none, since a description has no springs.

    Parameters
    ----------
    model
        The model whose outliers are left out, and whose residual gives the motors' noise.
    campaigns
        One or several campaigns.
    user_effects
        File or folder of the user's own effects.

    Raises
    ------
    ModelError
        The model does not fit the campaigns.
    """
    several = [campaigns] if isinstance(campaigns, Campaign) else list(campaigns)
    squares: dict[Stage, list[tuple[float, int]]] = {}
    for campaign in several:
        opened = on_campaign(model, campaign, user_effects)
        for stage in opened.stages:
            kind = kind_of(stage)
            if (kind.points or kind.moving) and opened.has(kind.tables) and not campaign.long:
                error = _points(opened) if kind.points else _torques(opened)
                if error is not None and np.isfinite(error[0]):
                    squares.setdefault(stage, []).append(error)
    return {
        stage: float(np.sqrt(sum(rms**2 * count for rms, count in found) / sum(count for _, count in found)))
        for stage, found in squares.items()
    }


def _points(opened: ModelOnCampaign) -> tuple[float, int] | None:
    """Rms position error, m, and number of points; None if no points were measured."""
    if "poses" not in opened.campaign.tables:
        return None
    rows = opened.rows("poses").points
    rejected = {(table, row) for _, table, row in only_of(opened.stages, "points").outliers}
    good = np.array([key not in rejected for key in zip(rows.table.tolist(), rows.row.tolist(), strict=True)])
    good &= rows.used[:, 0]
    if not good.any():
        return None
    return nominal_points(rows, opened.effects, good), int(good.sum())


def nominal_points(rows: Rows, effects: Mapping[str, Effect], good: Bools) -> float:
    """Rms position error of the described robot, m, over the points marked by ``good`` ``(N,)``.

    Base and targets are fitted to these points.
    """
    error = as_sent(rows.without(~good), effects).residual[good, :3]
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def _torques(opened: ModelOnCampaign) -> tuple[float, int]:
    """Rms torque error in units of the motors' noise, and number of rows."""
    rows = opened.rows("free_air")
    found = opened.fit_problem("free_air", rows)
    floor = noise_floor(rows, predicted(found, only_of(opened.stages, "moving").theta))
    nothing = found.start()[: len(found.slots)]
    return rms_of(rows, predicted(found, nothing), floor), len(rows)
