"""The loop of one stage: score, confirm, add, refit, and start again, until nothing more is confirmed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from clampid.accuracy import noise_floor
from clampid.diagnosis.confirm import cross_fitted_p, event_p, probe_held_out_p, stability
from clampid.diagnosis.entries import (
    confusable_with,
    considered_of,
    entry_of,
    merged,
    variables_of,
    with_stand_ins,
)
from clampid.diagnosis.look import Look, look_at, rivals_of
from clampid.diagnosis.next_measurement import NextPoses
from clampid.diagnosis.result import StageDiagnosis
from clampid.diagnosis.score import Scored
from clampid.diagnosis.separators import separating_measurement
from clampid.diagnosis.testability import testability_of
from clampid.diagnosis.trial import HeldOut, Refit, held_out, pruned
from clampid.diagnosis.unknown_shape import shape_of
from clampid.diagnosis.words import omission_of, outliers_of, summary_of
from clampid.effect import Effect
from clampid.fit import Estimate
from clampid.fitted_stage import FittedStage
from clampid.stages.rows import Rows

__all__ = ["diagnose_stage"]

HELD_OUT_RATE = 0.05
STABLE = 0.6
MOSTLY = 0.5
FAR_OFF = 2.0  # noise floors: so much is not noise, even if the instrument's maker was an optimist
ROUNDS = 8

Propose = Callable[[Estimate, Sequence[Scored], float], NextPoses | None]


def diagnose_stage(
    fitted: FittedStage,
    effects: dict[str, Effect],
    refit: Refit,
    verification: Rows | None,
    seed: int,
    flips: int,
    propose: Propose | None = None,
) -> StageDiagnosis:
    """Diagnose one fitted stage.

    Parameters
    ----------
    refit
        Fits the stage with other terms, from an earlier fit's values and given start values.
    propose
        Looks for measurements that part candidates, given the fit, the candidates and the residual's scale.
    """
    stage = fitted.estimate.experiment.stage
    result = StageDiagnosis(stage, "m" if stage == "poses" else "sigma")
    floor = noise_floor(fitted.estimate.experiment.rows, fitted.estimate.residual)
    result.noise_floor = floor.norm if stage == "poses" else 1.0
    result.outliers = outliers_of(fitted.estimate)
    held = held_out(fitted.estimate, verification, floor, seed)
    result.before = result.after = held.rms
    first = fitted.estimate
    rejected: set[str] = set()
    refused: list[dict[str, Any]] = []
    look = look_at(fitted.estimate, effects, flips, seed)
    result.testability = testability_of(look.named, look.named_null, effects)
    if look.fires and look.probe is not None:
        result.depends_on = list(look.probe.candidate.depends_on)
    for number in range(1, ROUNDS + 1):
        best = look.best(rejected)
        if best is None or look.only_stands_in(best):
            break
        rivals = rivals_of(look.space, look.named, best, rejected)
        if rivals:
            _undecided(result, look, [best, *rivals], effects, fitted.estimate, propose)
            break
        terms = [*fitted.model.terms, *best.candidate.terms]
        trial = refit(terms, fitted, best.candidate.shapes)
        trial, kept = pruned(trial, best.candidate.terms, fitted.model.terms, refit)
        new = held_out(trial.estimate, verification, floor, seed)
        p_held, falls = _falls(best, trial.estimate, held, new, seed)
        again = stability(look.space, look.named, best, look.folds, seed)
        if not falls or again < STABLE:
            rejected.add(best.candidate.label)
            reason = (
                "the held-out error does not fall" if again >= STABLE else "without a fifth of the rows it is not first"
            )
            refused.append({**entry_of(best, look.named_null, effects, held.rms, new.rms), "reason": reason})
            continue
        entry = entry_of(best, look.named_null, effects, held.rms, new.rms, trial.estimate, kept)
        entry |= {"stability": again, "p_held_out": p_held, "confusable_with": confusable_with(look.named, best)}
        result.candidates.append(entry)
        result.added += kept
        result.verdict = "missing"
        fitted, held = trial, new
        result.after = held.rms
        look = look_at(fitted.estimate, effects, flips, seed + 2 * number)
    result.considered = refused + considered_of(look.named, look.named_null)
    excess = result.after > FAR_OFF * result.noise_floor
    if result.verdict != "ambiguous" and (excess or _something_left(look, fitted.estimate, verification, seed)):
        _unknown(result, look, fitted.estimate, seed)
    result.candidates = merged(result.candidates)
    result.omission = omission_of(first, fitted.estimate)
    result.fitted = fitted
    result.summary = summary_of(result)
    return result


def _falls(best: Scored, trial: Estimate, held: HeldOut, new: HeldOut, seed: int) -> tuple[float, bool]:
    """One-sided p of the fall of the held-out error, and whether that confirms a candidate.

    No other sweep tells of an event; other blocks of its own do.

    What is told by a prior, such as a tool other than declared that the links' masses can stand for, need not lower an
    error that the model without it reaches, too; it must not raise it.
    """
    if trial.experiment.effects[best.candidate.name].event is not None:
        p = event_p(trial, best.candidate.name, seed)
        return p, p <= HELD_OUT_RATE
    p = held.p_above(new, new.noise, seed)
    told = best.assumed > MOSTLY and new.p_above(held, new.noise, seed) > HELD_OUT_RATE
    return p, p <= HELD_OUT_RATE or told


def _undecided(
    result: StageDiagnosis,
    look: Look,
    rivals: Sequence[Scored],
    effects: dict[str, Effect],
    estimate: Estimate,
    propose: Propose | None,
) -> None:
    """Set down candidates that these rows cannot tell apart, and what would."""
    result.verdict = "ambiguous"
    for s in rivals:
        entry = entry_of(s, look.named_null, effects, result.after, None, rivals=rivals)
        result.candidates.append({**entry, "alternative": True})
    result.next_measurement = separating_measurement(s.candidate.family for s in rivals)
    if propose is not None:
        result.ask_for(propose(estimate, rivals, look.space.scale))


def _unknown(result: StageDiagnosis, look: Look, estimate: Estimate, seed: int) -> None:
    """Set down that something is left which no name explains, and on what it depends and how, if a probe tells."""
    result.verdict = "unknown"
    result.depends_on = variables_of(look) if look.fires else []
    result.considered = with_stand_ins(result.considered, look) + considered_of(look.free, look.free_null, 5)
    if look.fires and look.probe is not None:
        result.shape = shape_of(estimate, look.space, look.probe, result.depends_on, seed)


def _something_left(look: Look, estimate: Estimate, verification: Rows | None, seed: int) -> bool:
    """Whether a probe fires, and brings something on rows that no fit has seen.

    Which probe is first without a fifth of the rows is not asked: of an error of several joints, each part of the rows
    may show another joint's share best.
    """
    if not look.fires or look.probe is None:
        return False
    if verification is None:
        return cross_fitted_p(estimate, look.probe, seed) <= HELD_OUT_RATE
    return probe_held_out_p(estimate, verification, look.probe.candidate.label, seed) <= HELD_OUT_RATE
