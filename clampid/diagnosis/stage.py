"""The diagnosis of one stage: the result of a search as a verdict with its evidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from clampid.diagnosis.candidate_scores import CandidateScores
from clampid.diagnosis.confirmed import Confirmed
from clampid.diagnosis.drift import drift_beside, drift_of
from clampid.diagnosis.entries import (
    considered_of,
    entry_of,
    merged,
    variables_elsewhere,
    variables_of,
    with_stand_ins,
)
from clampid.diagnosis.few_rows import estimates_share
from clampid.diagnosis.folds import Folds
from clampid.diagnosis.held_out import HeldOut
from clampid.diagnosis.next_measurement import NextPlan
from clampid.diagnosis.rejected import evidence_of
from clampid.diagnosis.remains import remains_of
from clampid.diagnosis.residual_excess import excess_over_floor, one_sided, one_sided_words
from clampid.diagnosis.result import StageDiagnosis, Step
from clampid.diagnosis.search import Searched, search
from clampid.diagnosis.separators import separating_measurement, something_else
from clampid.diagnosis.testability import testability_of
from clampid.diagnosis.trial import Bench
from clampid.diagnosis.unknown_shape import shape_of
from clampid.diagnosis.wandering import WANDERS
from clampid.diagnosis.words import listed_outliers, more_rows_words, omission_of, outliers_of, summary_of
from clampid.effect import Effect
from clampid.evidence.candidates import label_of
from clampid.evidence.score import Scored
from clampid.fitting.fit import agreeing_rows
from clampid.fitting.solve import Estimate
from clampid.identification.fitted_stage import FittedStage
from clampid.stages.rows import Rows
from clampid.stages.stage_kind import kind_of
from clampid.stages.temperatures import reads_temperatures

__all__ = ["diagnose_stage"]

WANDERS_MORE = 1.2  # times the variance: less changes no standard error by more than a tenth
FAR_OFF = 2.0  # of the largest plausible noise: more is not noise, even if the stated accuracies are optimistic

Propose = Callable[[Estimate, Sequence[Scored], float], NextPlan | None]


def diagnose_stage(fitted: FittedStage, bench: Bench, propose: Propose | None = None) -> StageDiagnosis:
    """Diagnose one fitted stage.

    Parameters
    ----------
    bench
        Inputs of every trial: effects, other fits, rows to verify by, seeds.
    propose
        Looks for measurements that separate candidates, given the fit, the candidates and the residual's scale.
    """
    judged_by, outcome = _searched(fitted, bench)
    drift = drift_of(outcome.fitted.estimate) if fitted.estimate.problem.kind.points else None
    as_slow: list[str] = []  # variables that describe what is left, and perhaps only because they change as slowly
    steady = drift is None or outcome.wander is None
    beside = drift if steady else drift_of(outcome.fitted.estimate, outcome.wander)
    left = outcome.left
    if beside is not None and left is not None and left.scores.fires and left.scores.probe is not None:
        beside = drift_beside(left.estimate, left.scores.space, left.scores.probe)
    del left
    if beside is not None and beside.block > 1:  # once more, now that it is known how long what is left goes on
        as_slow = variables_of(outcome.scores) if outcome.scores.fires else []
        del outcome  # as large as its rows
        judged_by, outcome = _searched(fitted, replace(bench, block=beside.block))
    result = _verdict(fitted, judged_by, outcome, propose)
    slow = all(name == "time" or reads_temperatures(name) for name in result.depends_on)
    if drift is not None and drift.clocked and result.verdict == "unknown" and slow:
        result.depends_on = list(dict.fromkeys(["time", *result.depends_on, *as_slow]))
        result.summary = " ".join([summary_of(result), *result.warnings])
    if drift is not None:
        _warn(result, drift.sentence)
    elif result.scores is not None and result.scores.wander is not None:  # a drift says as much, and more
        _warn(result, WANDERS)
    return result


def _warn(result: StageDiagnosis, sentence: str) -> None:
    """Add a warning, to the summary too."""
    result.warnings.append(sentence)
    result.summary = f"{result.summary} {sentence}"


def _searched(fitted: FittedStage, bench: Bench) -> tuple[Bench, Searched]:
    """The result of a search, and the bench with the parts of the rows that were held out.

    If whole runs would not test a candidate on trial, the search starts again with parts of runs held out. It also
    starts again if the readings wander clearly more in the last fit than where something was found: the missing effect
    had hidden part of their wandering, so that slow changes were confirmed too easily.
    """
    outcome = search(bench, fitted)
    if isinstance(outcome, Folds):
        return _searched(fitted, replace(bench, folds=outcome))
    wander = outcome.wander
    if bench.wander is None and wander is not None and wander.variance > WANDERS_MORE * outcome.least_wander:
        return _searched(fitted, replace(bench, wander=wander))
    return bench, outcome


def _verdict(fitted: FittedStage, bench: Bench, outcome: Searched, propose: Propose | None) -> StageDiagnosis:
    """The verdict on a search, with its evidence."""
    stage, effects, floor = fitted.estimate.problem.stage, bench.effects, bench.floor
    verification = bench.verification
    result = StageDiagnosis(stage, kind_of(stage).error_unit)
    result.folds, first, begun, fitted = bench.folds, fitted.estimate, fitted.rows, outcome.fitted
    result.noise_floor = floor.norm if kind_of(stage).points else 1.0
    held_out, scores, probe = outcome.held_out, outcome.scores, outcome.first_scores.probe
    result.before, result.after = outcome.before.rms, held_out.rms
    result.depends_on = list(probe.candidate.depends_on) if outcome.first_scores.fires and probe is not None else []
    refused = _set_down(result, outcome.steps, outcome.refused, effects, fitted.estimate)
    if outcome.taken or outcome.undecided:
        _undecided(result, outcome, effects, bench, propose)
    result.in_order = list(result.steps)
    for one, step in zip(reversed(outcome.taken), reversed(result.alike), strict=True):
        result.in_order.insert(one.after, step)
    # Of what is not in the model now: before a large effect was added, its residual hid much of what shows without it.
    result.testability = testability_of(scores.named, scores.named_null, effects, first.problem.rows.robot)
    result.considered = [*refused, *considered_of(scores.named, scores.named_null)]
    result.outliers = _rejected(fitted.estimate, verification, held_out)
    few = estimates_share(fitted.estimate, verification is not None)
    _judge_what_is_left(result, outcome, bench, few)
    if result.verdict == "adequate":
        result.depends_on = []  # what fired brought nothing on rows that no fit has seen
    result.candidates = merged(result.candidates)
    result.agreeing, result.rows = agreeing_rows(fitted.estimate), len(first.problem.rows)
    result.omission, result.fitted, result.scores = omission_of(first, fitted.estimate), fitted, scores
    result.warnings += more_rows_words(begun, fitted.rows)
    _in_words(result, scores, floor.source, first.problem.rows, effects, few)
    return result


def _judge_what_is_left(result: StageDiagnosis, outcome: Searched, bench: Bench, few: float) -> None:
    """The verdict ``unknown`` where what is left matters, or a note of it.

    With candidates that these rows do not distinguish, that is what is left beside any of them. ``few``: by how much
    errors of the estimates alone enlarge the held-out error (:func:`clampid.diagnosis.few_rows.estimates_share`).
    """
    if outcome.left is None:
        return
    estimate, scores, held_out, _ = bench.beside_what_stands_out(outcome.left)
    points = estimate.problem.kind.points
    excess = held_out.rms > FAR_OFF * few * (bench.floor.most if points else 1.0)
    tested = None if bench.verification is None else held_out.rows
    left = remains_of(scores, estimate, held_out, replace(bench.falls(scores), verification=tested))
    if excess or (left is not None and left.matters):
        _unknown(result, scores if left is None else scores.seen_by(left.probe), estimate, bench.seed)
    elif left is not None:
        result.remains.append(left)


def _rejected(estimate: Estimate, verification: Rows | None, held_out: HeldOut) -> list[dict[str, Any]]:
    """Rows that the last fit and the table verification are without: what the first fit lacked moved rows, too."""
    if verification is None:
        return outliers_of(estimate)
    wrong = np.any(verification.used & ~held_out.rows.used, axis=1)
    return [*outliers_of(estimate), *listed_outliers(verification, held_out.residual, wrong)]


def _set_down(
    result: StageDiagnosis,
    steps: Sequence[Confirmed],
    last: Sequence[dict[str, Any]],
    effects: dict[str, Effect],
    estimate: Estimate,
) -> list[dict[str, Any]]:
    """Record the confirmed steps; return the refused candidates, those of the ``last`` round too, not confirmed."""
    for confirmed in steps:
        entry = confirmed.entry(effects, estimate)
        result.candidates.append(entry)
        result.steps.append(confirmed.step(entry))
        result.verdict = "missing"
    labels = {confirmed.label for confirmed in steps}
    refused = {
        label_of(entry["name"], entry["where"]): entry for entry in [*(r for c in steps for r in c.refused), *last]
    }
    return [entry for label, entry in refused.items() if label not in labels]


def _in_words(
    result: StageDiagnosis, scores: CandidateScores, source: str, rows: Rows, effects: dict[str, Effect], few: float
) -> None:
    """Record the verdict in words, with reasons for an error above the floor, and joints approached from one side."""
    if result.verdict in ("adequate", "missing"):
        result.floor_excess = excess_over_floor(
            result.after, result.noise_floor, source, len(result.outliers), scores.free, few
        )
    result.one_sided = one_sided(rows)
    said = one_sided_words(result.one_sided, rows, effects)
    result.warnings += [found.sentence for found in result.agreeing]
    result.warnings += [said] if said else []
    judged = [] if result.folds is None else [result.folds.sentence]
    result.summary = " ".join([summary_of(result), *judged, *result.warnings])


def _undecided(
    result: StageDiagnosis, outcome: Searched, effects: dict[str, Effect], bench: Bench, propose: Propose | None
) -> None:
    """Record candidates that these rows cannot distinguish, and a measurement that distinguishes the first group."""
    result.verdict = "ambiguous"
    fitted, taken = outcome.fitted, {id(t.group): t for t in outcome.taken}
    groups = [*(t.group for t in outcome.taken), *outcome.undecided]
    for number, group in enumerate(groups, start=1):
        here, entries = taken.get(id(group)), []
        for s in group.members:
            before, after = result.after, None
            if here is not None:
                fitted_along = s is group.members[0]
                before, after = here.before.rms, here.held_out.rms if fitted_along else bench.alone(here.base, s)
            elif number == 1:  # those beside them were found in another fit
                after = bench.alone(fitted, s)
            scores = group.scores
            entry = entry_of(
                s, scores.named_null, effects, (before, after), rivals=group.members, scale=scores.space.scale
            )
            entries.append({**entry, "alternative": True, "group": number})
        result.candidates += entries
        if here is not None:
            evidence = evidence_of(entries[0], group.members[0], group.scores, ())
            result.alike.append(Step(group.members[0].candidate.terms, evidence, here.fitted))
    first = groups[0]
    result.next_measurement = separating_measurement((s.candidate.family for s in first.members), effects, result.stage)
    base = outcome.taken[0].base if outcome.taken else fitted
    proposed = None if propose is None else propose(base.estimate, first.members, first.scores.space.scale)
    if proposed is not None:
        never = [tuple(label.partition("@")[0] for label in pair[:2]) for pair in proposed.never]
        result.ask_for(proposed, [something_else(pair, effects, result.stage) for pair in never])
    if not kind_of(result.stage).points:
        left = outcome.undecided
        result.open = bench.with_undecided(left, fitted, fitted)[0] if left else fitted


def _unknown(result: StageDiagnosis, scores: CandidateScores, estimate: Estimate, seed: int) -> None:
    """Record that no name explains the rest, with its variables and shape if a probe is significant."""
    result.verdict = "unknown"
    here = variables_of(scores) if scores.fires else []
    result.depends_on = list(dict.fromkeys([*here, *(variables_elsewhere(scores) if here else [])]))
    result.considered = with_stand_ins(result.considered, scores) + considered_of(scores.free, scores.free_null, 5)
    if scores.fires and scores.probe is not None:
        result.shape = shape_of(estimate, scores.space, scores.probe, here, seed)
