"""Which parameters the rows of a stage identify, and which were known before."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from clampid.effect import Effect, Stage
from clampid.identification.carried import carried_over, with_log_friction
from clampid.models.model import StageModel
from clampid.role_slots import has_role
from clampid.stages.fit_problem import parameter_in
from clampid.stages.rows import Array, Bools, Rows
from clampid.stages.stage_kind import known_of

__all__ = ["known_before", "known_here"]

LARGEST_VARIANCE_LEFT = 0.5
"""Share of the variance before: rows that leave no more than this at least double the information."""


def known_here(
    stage: StageModel, before: Mapping[Stage, StageModel], rows: Rows, effects: Mapping[str, Effect]
) -> Bools:
    """Which parameters ``(P,)`` these rows identify: the rows at least double the information on them.

    Parameters
    ----------
    stage
        The fitted stage.
    before
        Stages fitted before, whose values it takes over.
    rows
        Its rows.
    effects
        All known effects, by name.
    """
    std = np.sqrt(np.diag(stage.covariance))
    assumed = np.minimum(_assumed(stage, before, rows, effects), _carried(stage, before, rows, effects))
    return np.asarray(np.array(stage.identified, dtype=bool) & (std**2 <= LARGEST_VARIANCE_LEFT * assumed**2))


def known_before(
    stage: StageModel, before: Mapping[Stage, StageModel], rows: Rows, effects: Mapping[str, Effect]
) -> Bools:
    """Which parameters ``(P,)`` earlier tables or the description know better than their declared prior."""
    return np.asarray(_carried(stage, before, rows, effects) < _assumed(stage, before, rows, effects))


def _assumed(stage: StageModel, before: Mapping[Stage, StageModel], rows: Rows, effects: Mapping[str, Effect]) -> Array:
    """Declared prior standard deviations ``(P,)``, SI; of friction in poses that which a log leaves open."""
    rows = with_log_friction(rows, before, effects)
    return np.array([parameter_in(rows, slot, effects).prior_std for slot in stage.slots])


def _carried(stage: StageModel, before: Mapping[Stage, StageModel], rows: Rows, effects: Mapping[str, Effect]) -> Array:
    """Standard deviations ``(P,)`` known from the description or an earlier stage, SI; infinite where from neither."""
    known: dict[object, float] = {}
    for prior in carried_over(rows, before, effects)[0]:
        known |= dict(zip(prior.slots, np.sqrt(np.diag(prior.covariance)).tolist(), strict=True))
    clamped = known_of(before, "solved")
    if clamped is not None and rows.kind.points:
        std = np.sqrt(np.diag(clamped.covariance))
        drives = [k for k, slot in enumerate(clamped.slots) if has_role(slot, "compliance", "clearance")]
        known |= {clamped.slots[k]: float(std[k]) for k in drives}
    return np.array([known.get(slot, np.inf) for slot in stage.slots])
