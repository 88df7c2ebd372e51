"""The loop of one stage: score, confirm, add, refit, and start again, until nothing more is confirmed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from scipy import optimize, stats

from clampid.accuracy import Floor, cross_validated, noise_floor, predicted, rms_of, size_of
from clampid.diagnosis.candidates import named_candidates
from clampid.diagnosis.confirm import cross_fitted_p, held_out_p, probe_held_out_p, stability
from clampid.diagnosis.probes import probes
from clampid.diagnosis.score import (
    Flips,
    Scored,
    Space,
    canonical,
    explained_together,
    flip_maxima,
    log_tail,
    score,
    space_of,
)
from clampid.diagnosis.separators import separating_measurement
from clampid.effect import Effect, Stage
from clampid.fit import Estimate
from clampid.fitted_stage import FittedStage
from clampid.slots import Slot, Term, find_parameter
from clampid.stages.experiment import experiment
from clampid.stages.rows import Array, Integers, Rows

__all__ = ["StageDiagnosis", "diagnose_stage"]

RATE = 0.025  # false alarms of each dictionary; named effects and probes share 5 %
HELD_OUT_RATE = 0.05
SAME = 20.0  # explained beyond another candidate less than this: these data cannot tell the two apart
CONFUSABLE, ALIASED = 0.8, 0.999
STABLE = 0.6
STANDS_IN = 0.9
FAR_OFF = 2.0  # noise floors: so much is not noise, even if the instrument's maker was an optimist
IMPOSSIBLE, SURE = 100.0, 4.0  # reasonable sizes that no effect has; standard errors by which that must be clear
ABLE = ("testable", "weak")
ROUNDS = 8
LISTED = 12
POWER = 0.9
GAUSSIAN = 300.0

Verdict = Literal["adequate", "missing", "ambiguous", "unknown"]
Refit = Callable[[Sequence[Term], FittedStage, Mapping[Slot, float]], FittedStage]


@dataclass
class StageDiagnosis:
    """What was found in one stage; :meth:`to_json` gives the contract's form."""

    stage: Stage
    unit: str
    verdict: Verdict = "adequate"
    noise_floor: float = 0.0
    before: float = 0.0
    after: float = 0.0
    candidates: list[dict[str, Any]] = field(default_factory=list)
    considered: list[dict[str, Any]] = field(default_factory=list)
    depends_on: list[str] = field(default_factory=list)
    outliers: list[dict[str, Any]] = field(default_factory=list)
    next_measurement: str | None = None
    omission: list[dict[str, Any]] = field(default_factory=list)
    testability: list[dict[str, Any]] = field(default_factory=list)
    summary: str = ""
    added: list[Term] = field(default_factory=list)
    fitted: FittedStage | None = None

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "verdict": self.verdict,
            "unit": self.unit,
            "noise_floor": self.noise_floor,
            "heldout_rms_before": self.before,
            "heldout_rms_after": self.after,
            "candidates": self.candidates,
            "considered": self.considered,
            "depends_on": self.depends_on,
            "outliers": self.outliers,
            "next_measurement": self.next_measurement,
            "omission": self.omission,
            "testability": self.testability,
            "summary": self.summary,
        }


@dataclass(frozen=True)
class _HeldOut:
    """Squared errors of held-out rows, in the stage's unit, with the units that share their noise."""

    rms: float
    squares: Array
    unit: Integers


def diagnose_stage(
    fitted: FittedStage,
    effects: dict[str, Effect],
    refit: Refit,
    verification: Rows | None,
    seed: int,
    flips: int,
) -> StageDiagnosis:
    """Diagnose one fitted stage.

    Parameters
    ----------
    refit
        Fits the stage with other terms, from an earlier fit's values and given start values.
    """
    stage = fitted.estimate.experiment.stage
    result = StageDiagnosis(stage, "m" if stage == "poses" else "sigma")
    floor = noise_floor(fitted.estimate.experiment.rows, fitted.estimate.residual)
    result.noise_floor = floor.norm if stage == "poses" else 1.0
    result.outliers = _outliers(fitted.estimate)
    held = _held_out(fitted.estimate, verification, floor, seed)
    result.before = result.after = held.rms
    first = fitted.estimate
    rejected: set[str] = set()
    refused: list[dict[str, Any]] = []
    for number in range(ROUNDS):
        look = _look(fitted.estimate, effects, flips, seed + 2 * number, rejected)
        if number == 0:
            result.testability = _testability(look.named, look.named_null, effects)
            if look.fires and look.probe is not None:
                result.depends_on = list(look.probe.candidate.depends_on)
        best = look.best
        if best is None or look.stands_in:
            break
        rivals = _rivals(look.space, look.named, best, rejected)
        if rivals:
            _undecided(result, look, [best, *rivals], effects, held.rms)
            break
        terms = [*fitted.model.terms, *best.candidate.terms]
        trial = refit(terms, fitted, best.candidate.shapes)
        trial, kept = _pruned(trial, best.candidate.terms, fitted.model.terms, refit)
        new = _held_out(trial.estimate, verification, floor, seed)
        p_held = held_out_p(held.squares, new.squares, held.unit, seed)
        again = stability(look.space, look.named, best, look.folds, seed)
        if p_held > HELD_OUT_RATE or again < STABLE:
            rejected.add(best.candidate.label)
            reason = (
                "the held-out error does not fall" if again >= STABLE else "without a fifth of the rows it is not first"
            )
            refused.append({**_entry(best, look.named_null, effects, held.rms, new.rms), "reason": reason})
            continue
        entry = _entry(best, look.named_null, effects, held.rms, new.rms, trial.estimate, kept)
        entry |= {"stability": again, "p_held_out": p_held, "confusable_with": _confusable(look.named, best)}
        result.candidates.append(entry)
        result.added += kept
        result.verdict = "missing"
        fitted, held = trial, new
        result.after = held.rms
    result.considered = refused + _considered(look.named, look.named_null)
    excess = result.after > FAR_OFF * result.noise_floor
    if result.verdict != "ambiguous" and (excess or _something_left(look, fitted.estimate, verification, seed)):
        _unknown(result, look)
    result.candidates = _merged(result.candidates)
    result.omission = _omission(first, fitted.estimate)
    result.fitted = fitted
    result.summary = _summary(result)
    return result


def _undecided(
    result: StageDiagnosis, look: _Look, rivals: Sequence[Scored], effects: dict[str, Effect], before: float
) -> None:
    """Set down candidates that these rows cannot tell apart, and what would."""
    result.verdict = "ambiguous"
    for s in rivals:
        entry = _entry(s, look.named_null, effects, before, None, rivals=rivals)
        result.candidates.append({**entry, "alternative": True})
    result.next_measurement = separating_measurement(s.candidate.family for s in rivals)


def _unknown(result: StageDiagnosis, look: _Look) -> None:
    """Set down that something is left which no name explains, and on what it depends."""
    result.verdict = "unknown"
    result.depends_on = _variables(look)
    result.considered = _stand_ins(result.considered, look) + _considered(look.free, look.free_null, 5)


@dataclass(frozen=True)
class _Look:
    """One look at what is left: both dictionaries scored, with their nulls."""

    space: Space
    named: list[Scored]
    free: list[Scored]
    named_null: Flips
    free_null: Flips
    best: Scored | None
    probe: Scored | None
    folds: Integers

    @property
    def fires(self) -> bool:
        """Whether the best probe stands out of its null."""
        return self.probe is not None and self.free_null.p_familywise(self.probe.log_p) <= RATE

    @property
    def stands_in(self) -> bool:
        """Whether the best name explains so much less than a probe that it only stands in for something else."""
        if not self.fires or self.best is None or self.probe is None:
            return False
        less = self.probe.bic - self.best.bic > SAME
        return less and self.best.explained < STANDS_IN * self.probe.explained


def _look(estimate: Estimate, effects: dict[str, Effect], flips: int, seed: int, rejected: set[str]) -> _Look:
    space = space_of(estimate)
    free = score(space, probes(estimate))
    free_null = flip_maxima(space, free, flips, seed + 1)
    fired = {s.candidate.name for s in free if s.freedom and free_null.p_familywise(s.log_p) <= RATE}
    named = score(space, named_candidates(estimate, effects, fired))
    named_null = flip_maxima(space, named, flips, seed)
    named = [s if _plausible(s, effects, space.scale) else replace(s, state="implausible") for s in named]
    best = _best([s for s in named if s.candidate.label not in rejected])
    if best is not None and named_null.p_familywise(best.log_p) > RATE:
        best = None
    folds = estimate.experiment.rows.fold[estimate.whitened.entry]
    return _Look(space, named, free, named_null, free_null, best, _best(free), folds)


def _something_left(look: _Look, estimate: Estimate, verification: Rows | None, seed: int) -> bool:
    """Whether a probe fires, again without a fifth of the rows, and on rows that no fit has seen."""
    if not look.fires or look.probe is None or stability(look.space, look.free, look.probe, look.folds, seed) < STABLE:
        return False
    if verification is None:
        return cross_fitted_p(estimate, look.probe, seed) <= HELD_OUT_RATE
    return probe_held_out_p(estimate, verification, look.probe.candidate.label, seed) <= HELD_OUT_RATE


def _best(scored: Sequence[Scored]) -> Scored | None:
    able = [s for s in scored if s.freedom and s.state in ABLE]
    return max(able, key=lambda s: s.bic, default=None)


def _plausible(s: Scored, effects: Mapping[str, Effect], scale: float) -> bool:
    """Whether what the score makes of the parameters is something they can be: of a possible size and sign."""
    value, spread = s.value, SURE * scale * s.spread
    alone = len(s.candidate.terms) < 2  # of several places, one step from zero may put a few on the wrong side
    for slot, v, sd in zip(s.candidate.slots, value, spread, strict=True):
        parameter = find_parameter(slot, effects)
        lower, upper = parameter.bounds
        if abs(v) - sd > IMPOSSIBLE * parameter.size or (alone and (v + sd < lower or v - sd > upper)):
            return False
    return True


def _rivals(space: Space, named: Sequence[Scored], best: Scored, rejected: set[str]) -> list[Scored]:
    """Other effects, or other places, that explain as well what the best one does."""
    found: dict[tuple[str, tuple[str, ...]], Scored] = {}
    mine = set(best.candidate.terms)
    for other in sorted(named, key=lambda s: -s.bic):
        theirs = set(other.candidate.terms)
        if (
            other is best
            or other.state not in ABLE
            or theirs <= mine
            or mine <= theirs
            or other.candidate.label in rejected
        ):
            continue
        if other.candidate.name == best.candidate.name and (theirs & mine):
            continue
        if other.candidate.family == best.candidate.family and other.candidate.places == best.candidate.places:
            continue  # variants of one effect at one place are one verdict
        if other.explained < best.explained - SAME - other.freedom:
            continue
        if other.candidate.prior is not None and other.bic < best.bic - SAME:
            continue  # what can follow anything explains what the simpler one does, and is no rival for it
        if explained_together(space, best, other) - other.explained < SAME and canonical(best, other) > CONFUSABLE:
            found.setdefault((other.candidate.name, other.candidate.places), other)
    kept = [
        s for s in found.values() if not any(set(o.candidate.terms) < set(s.candidate.terms) for o in found.values())
    ]
    return kept[:4]


def _pruned(
    trial: FittedStage, new: Sequence[Term], before: Sequence[Term], refit: Refit
) -> tuple[FittedStage, list[Term]]:
    """Drop the places of a new effect that do not pay for their parameters (Wald's statistic against BIC)."""
    if len(new) < 2:
        return trial, list(new)
    estimate = trial.estimate
    rows = max(len(estimate.whitened.residual), 2)
    assumed = estimate.experiment.prior_std() <= estimate.experiment.sizes()
    kept = []
    for term in new:
        index = [k for k, s in enumerate(estimate.slots) if s.effect == term.effect and s.place == term.place]
        if not index:
            continue
        theta, covariance = estimate.theta[index], estimate.covariance[np.ix_(index, index)]
        cost = len(index) * float(np.log(rows))
        if assumed[index].all():  # what the rows narrowed the prior by
            prior = estimate.experiment.prior_std()[index]
            cost = -float(np.linalg.slogdet(covariance / np.outer(prior, prior))[1])
        if float(theta @ np.linalg.pinv(covariance, hermitian=True) @ theta) > cost:
            kept.append(term)
    if not kept or len(kept) == len(new):
        return trial, list(new)
    return refit([*before, *kept], trial, {}), kept


def _held_out(estimate: Estimate, verification: Rows | None, floor: Floor, seed: int) -> _HeldOut:
    count = len(estimate.slots)
    if verification is not None:
        trial = experiment(verification, estimate.experiment.effects, estimate.slots)
        rows, residual = verification, predicted(trial, estimate.theta[:count])
    else:
        rows, residual = cross_validated(estimate, estimate.experiment.rows, seed)
    size, counts = size_of(rows, residual, floor)
    squares = np.where(counts, size**2, 0.0)
    if squares.ndim == 2:
        squares = squares.sum(axis=1)
    return _HeldOut(rms_of(rows, residual, floor), squares, rows.unit)


def _entry(
    s: Scored,
    null: Flips,
    effects: dict[str, Effect],
    before: float,
    after: float | None,
    estimate: Estimate | None = None,
    kept: Sequence[Term] | None = None,
    rivals: Sequence[Scored] = (),
) -> dict[str, Any]:
    places = [t.place for t in kept if t.place] if kept is not None else list(s.candidate.places)
    return {
        "effect": s.candidate.family,
        "name": s.candidate.name,
        "where": places,
        "alternative": False,
        "p_value": float(np.exp(max(s.log_p, -690.0))),
        "p_familywise": null.p_familywise(s.log_p),
        "heldout_rms_before": before,
        "heldout_rms_after": after,
        "parameters": _parameters(s, effects, estimate),
        "confusable_with": _confusable(rivals, s) if rivals else [],
        "explained": s.explained,
        "retained": s.retained,
        "state": s.state,
    }


def _parameters(s: Scored, effects: dict[str, Effect], estimate: Estimate | None) -> list[dict[str, Any]]:
    if estimate is None:  # the score's own estimate: one step from zero
        value, spread = s.value, s.spread
        return [
            {"name": slot.label, "value": float(v), "std": float(sd), "unit": find_parameter(slot, effects).unit}
            for slot, v, sd in zip(s.candidate.slots, value, spread, strict=False)
        ]
    wanted: dict[str, set[str]] = {}
    for slot in (*s.candidate.slots, *s.candidate.shapes):
        wanted.setdefault(slot.effect, set()).add(slot.place)
    std = estimate.std
    return [
        {
            "name": slot.label,
            "value": float(estimate.theta[k]),
            "std": float(std[k]),
            "unit": find_parameter(slot, effects).unit,
        }
        for k, slot in enumerate(estimate.slots)
        if slot.place in wanted.get(slot.effect, set())
    ]


def _confusable(scored: Sequence[Scored], s: Scored) -> list[dict[str, Any]]:
    out: list[dict[str, Any]] = []
    for other in scored:
        if other.candidate.family == s.candidate.family or not other.freedom:
            continue
        square = canonical(s, other)
        if square > CONFUSABLE:
            out.append(
                {
                    "effect": other.candidate.family,
                    "where": list(other.candidate.places),
                    "cos2": square,
                    "aliased": square > ALIASED,
                }
            )
    return sorted(out, key=lambda c: -float(c["cos2"]))[:5]


def _considered(scored: Sequence[Scored], null: Flips, most: int = LISTED) -> list[dict[str, Any]]:
    able = sorted((s for s in scored if s.freedom), key=lambda s: -s.bic)[:most]
    return [
        {
            "effect": s.candidate.family,
            "name": s.candidate.name,
            "where": list(s.candidate.places),
            "p_value": float(np.exp(max(s.log_p, -690.0))),
            "p_familywise": null.p_familywise(s.log_p),
            "explained": s.explained,
            "retained": s.retained,
            "state": s.state,
            "depends_on": list(s.candidate.depends_on),
        }
        for s in able
    ]


def _stand_ins(considered: list[dict[str, Any]], look: _Look) -> list[dict[str, Any]]:
    """Mark names that merely absorb a part of what the best probe explains."""
    whole = look.probe.explained if look.probe is not None else 0.0
    share = {s.candidate.label: s.explained / whole for s in look.named if s.freedom and whole > 0}
    for entry in considered:
        label = entry["name"] + ("@" + ",".join(entry["where"]) if entry["where"] else "")
        if share.get(label, 0.0) > 0.2:
            entry["stand_in"] = f"absorbs {100 * min(share[label], 1.0):.0f} % of what is left"
    return considered


def _variables(look: _Look) -> list[str]:
    """The variables of the best probe, and of others at the same place that fire nearly as strongly."""
    if look.probe is None:
        return []
    names = dict.fromkeys(look.probe.candidate.depends_on)
    for s in sorted(look.free, key=lambda s: -s.bic):
        close = s.bic > 0.8 * look.probe.bic and s.candidate.places == look.probe.candidate.places
        if close and look.free_null.p_familywise(s.log_p) <= RATE:
            names |= dict.fromkeys(s.candidate.depends_on)
    return list(names)


def noncentrality(freedom: int, null: Flips) -> float:
    """The noncentrality that is found with 90 % power at this dictionary's size."""
    log_p = null.critical_log_p(RATE)
    most = 4.0 * (freedom - log_p) + 100.0
    critical = float(optimize.brentq(lambda x: float(log_tail(x, freedom)) - log_p, 0.0, most))

    def short(x: float) -> float:
        return float(stats.ncx2.sf(critical, freedom, x)) - POWER

    if critical > GAUSSIAN:  # far out the distribution of the statistic is narrow about its mean
        return critical + float(stats.norm.isf(1 - POWER)) * 2.0 * float(np.sqrt(critical))
    return float(optimize.brentq(short, 0.0, 10.0 * critical + 200.0))


def _testability(named: Sequence[Scored], null: Flips, effects: dict[str, Effect]) -> list[dict[str, Any]]:
    """For each candidate its state and the smallest parameter that is found with 90 % probability."""
    out, factor = [], {}
    for s in named:
        if s.freedom and s.freedom not in factor:
            factor[s.freedom] = np.sqrt(noncentrality(s.freedom, null))
        limits: list[dict[str, Any]] = []
        together = s.candidate.prior is not None  # too many to be found one by one: so many times the assumed size
        if together and s.freedom:
            information = float(np.sum(s.kept**2 / np.maximum(1.0 - s.kept, 1e-9)))
            name = f"{s.candidate.name}, in assumed sizes"
            limits.append({"name": name, "limit": float(factor[s.freedom] / np.sqrt(information)), "unit": ""})
        for slot, unit_limit in zip(s.candidate.slots, s.unit_limit, strict=True):
            if together:
                break
            limit = float(unit_limit * factor[s.freedom]) if s.freedom and np.isfinite(unit_limit) else None
            limits.append({"name": slot.label, "limit": limit, "unit": find_parameter(slot, effects).unit})
        entry = {"effect": s.candidate.family, "name": s.candidate.name, "where": list(s.candidate.places)}
        out.append({**entry, "state": s.state, "retained": s.retained, "limits": limits})
    return out


def _outliers(estimate: Estimate) -> list[dict[str, Any]]:
    rows = estimate.experiment.rows
    width = 3 if rows.stage == "poses" else rows.robot.n
    return [
        {
            "table": str(rows.table[i]),
            "row": int(rows.row[i]),
            "size": float(np.linalg.norm(estimate.residual[i, :width])),
        }
        for i in np.flatnonzero(estimate.outliers)
    ]


def _merged(candidates: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Confirmed steps of one effect at several places as one candidate, where its first step stood."""
    out: list[dict[str, Any]] = []
    for c in candidates:
        same = next((o for o in out if o["name"] == c["name"] and not o["alternative"] and not c["alternative"]), None)
        if same is None:
            out.append(c)
            continue
        same["where"] = list(dict.fromkeys([*same["where"], *c["where"]]))
        known = {p["name"] for p in same["parameters"]}
        same["parameters"] += [p for p in c["parameters"] if p["name"] not in known]
        same["heldout_rms_after"] = c["heldout_rms_after"]
    return out


def _omission(before: Estimate, after: Estimate) -> list[dict[str, Any]]:
    """What the omission had done to the parameters that were fitted anyway: shifts beyond their standard error."""
    if before is after:
        return []
    std = after.std
    new: dict[Slot, int] = {slot: k for k, slot in enumerate(after.slots)}
    out: list[dict[str, Any]] = []
    for k, slot in enumerate(before.slots):
        if slot not in new:
            continue
        shift = float(before.theta[k] - after.theta[new[slot]])
        spread = float(std[new[slot]])
        if spread > 0 and abs(shift) > 2 * spread:
            out.append(
                {
                    "name": slot.label,
                    "shift": shift,
                    "std": spread,
                    "unit": find_parameter(slot, dict(before.experiment.effects)).unit,
                }
            )
    return sorted(out, key=lambda o: -abs(float(o["shift"])) / float(o["std"]))[:10]


def _summary(result: StageDiagnosis) -> str:
    scale, unit = (1e6, "µm") if result.unit == "m" else (1.0, "σ of the motors' noise")

    def shown(x: float) -> str:
        return f"{x * scale:.3g} {unit}"

    def words(c: Mapping[str, Any]) -> str:
        return str(c["effect"]).replace("_", " ") + (f" at {', '.join(c['where'])}" if c["where"] else "")

    confirmed = [words(c) for c in result.candidates if not c["alternative"]]
    floor = f"noise floor {shown(result.noise_floor)}"
    start = ""
    if confirmed:
        fall = f"the held-out error falls from {shown(result.before)} to {shown(result.after)} ({floor})"
        start = f"Missing: {'; '.join(confirmed)}; with it {fall}. "
    match result.verdict:
        case "adequate":
            return (
                f"Nothing can be seen to be missing: the held-out error is {shown(result.before)}, {floor}; effects "
                "above the listed limits would have been found with 90 % probability."
            )
        case "missing":
            return start + "Beyond that nothing stands out of the noise."
        case "ambiguous":
            rest = [words(c) for c in result.candidates if c["alternative"]]
            return start + f"These data cannot tell apart: {'; '.join(rest)}. To part them: {result.next_measurement}."
        case _:
            error = "" if confirmed else f" (held-out error {shown(result.after)}, {floor})"
            return (
                f"{start}Structure is left that no known effect explains; it depends on "
                f"{', '.join(result.depends_on)}{error}."
            )
