"""The error of the nominal robot, which every model must improve."""

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
    """The error of each stage with the description alone.

    Poses: rms of position errors, m, with base and targets (or the flange's target) fitted to the same rows, because
    nobody can know these from a description. Several campaigns count together. Torques in free air: rms in units of
    each motor's noise, with the described masses and no friction. Clamped torques have none: a description has no
    springs.

    Parameters
    ----------
    model
        For what was rejected and how large a motor's noise is.

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
    """Root mean square and number of points; None where distances were measured instead."""
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
    """Root mean square of the position errors of the robot as described, m, of points that count ``(N,)``.

    Base and targets, or the flange's target, are fitted to these points.
    """
    error = as_sent(rows.without(~good), effects).residual[good, :3]
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def _torques(opened: ModelOnCampaign) -> tuple[float, int]:
    """Root mean square in units of the motors' noise, and number of rows."""
    rows = opened.rows("free_air")
    found = opened.fit_problem("free_air", rows)
    floor = noise_floor(rows, predicted(found, only_of(opened.stages, "moving").theta))
    nothing = found.start()[: len(found.slots)]
    return rms_of(rows, predicted(found, nothing), floor), len(rows)
