"""What trials of a stage of poses need, as diagnosis has it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from clampid.diagnosis.pruning import Refit
from clampid.diagnosis.trial import Bench
from clampid.fitting.accuracy import noise_floor
from clampid.identification.fitted_stage import FittedStage, fit_stage
from clampid.identification.model_on_campaign import ModelOnCampaign
from clampid.slots import Slot, Term


def refits(opened: ModelOnCampaign) -> Refit:
    """Fits of the poses with other terms."""
    rows = opened.rows("poses")

    def refit(terms: Sequence[Term], last: FittedStage, start: Mapping[Slot, float]) -> FittedStage:
        return fit_stage(rows, opened.effects, terms, {}, {**last.model.values(), **start}, last=last.estimate)

    return refit


def bench_of(opened: ModelOnCampaign, fitted: FittedStage, refit: Refit) -> Bench:
    floor = noise_floor(fitted.estimate.problem.rows, fitted.estimate.residual)
    return Bench(opened.effects, refit, None, floor, seed=0, flips=99)
