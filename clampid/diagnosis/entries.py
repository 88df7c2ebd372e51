"""Candidates as a verdict lists them: evidence, estimates, look-alikes and stand-ins."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from clampid.diagnosis.candidate_scores import ALIASED, CONFUSABLE, DICTIONARY_FALSE_ALARMS, CandidateScores
from clampid.effect import WEAK_SPREAD, Effect
from clampid.evidence.candidates import label_of
from clampid.evidence.flips import Flips
from clampid.evidence.score import Scored, canonical, followed
from clampid.fitting.solve import Estimate
from clampid.slots import Slot, Term, beyond_limit, excludes_zero, fixed_slots, unit_of
from clampid.stages.rows import Array, Bools

__all__ = [
    "confusable_with",
    "considered_of",
    "entry_of",
    "merged",
    "variables_elsewhere",
    "variables_of",
    "with_stand_ins",
]

LISTED = 12
NEARLY = 0.8  # of the evidence of the best probe: others with as much are named beside it


def entry_of(
    s: Scored,
    null: Flips,
    effects: dict[str, Effect],
    rms: tuple[float, float | None],
    estimate: Estimate | None = None,
    kept: Sequence[Term] | None = None,
    rivals: Sequence[Scored] = (),
    scale: float = 1.0,
) -> dict[str, Any]:
    """A candidate as the contract lists it.

    Parameters
    ----------
    rms
        Held-out rms without it and with it, in the stage's unit; None where it was not fitted.
    estimate
        The fit with it, for its parameters; None: the score's own estimate, one step from zero.
    kept
        The terms that justify their parameters; None: all of the candidate's.
    rivals
        Candidates that these rows cannot distinguish from it.
    scale
        Of the whitened residual that was scored.
    """
    places = [t.place for t in kept if t.place] if kept is not None else list(s.candidate.places)
    effect = effects.get(s.candidate.name)  # a probe is none
    when = {} if estimate is None or effect is None else _when(estimate, effect)
    return {
        "effect": s.candidate.family,
        "name": s.candidate.name,
        "where": places,
        "alternative": False,
        "p_value": float(np.exp(max(s.log_p, -690.0))),
        "p_familywise": null.p_familywise(s.log_p),
        "heldout_rms_before": rms[0],
        "heldout_rms_after": rms[1],
        "parameters": _parameters(s, effects, estimate, scale),
        "confusable_with": confusable_with(rivals, s) if rivals else [],
        "explained": s.explained,
        "from_prior": s.assumed,
        "retained": s.retained,
        "state": s.state,
        **when,
        **({} if effect is None else effect.caveat_json),
    }


def _when(estimate: Estimate, effect: Effect) -> dict[str, Any]:
    """Of an event, before which row of which table it happened, as ``when``; else nothing."""
    at = estimate.values().get(Slot(effect.name, str(effect.event), effect.at))
    if effect.event is None or at is None:
        return {}
    rows = estimate.problem.rows
    after = np.flatnonzero(rows.signals["sweep_progress"] > at)
    if not len(after):
        return {}
    first = after[np.argmin(rows.signals["sweep_progress"][after])]
    return {"when": {"table": str(rows.table[first]), "row": int(rows.row[first])}}


def _parameters(s: Scored, effects: dict[str, Effect], estimate: Estimate | None, scale: float) -> list[dict[str, Any]]:
    if estimate is None:
        value, std, identified = _one_step(s, scale)
        return [
            {"name": slot.label, "value": float(v), "std": float(sd), "unit": unit, "identified": bool(known)}
            for slot, unit, v, sd, known in zip(
                s.candidate.slots, s.candidate.units, value, std, identified, strict=False
            )
        ]
    wanted: dict[str, set[str]] = {}
    for slot in (*s.candidate.slots, *s.candidate.shapes):
        wanted.setdefault(slot.effect, set()).add(slot.place)
    std, identified, fixed = estimate.std, estimate.identified, fixed_slots(estimate.slots, estimate.problem.effects)
    every = estimate.problem.parameters
    return [
        {
            "name": slot.label,
            "value": float(estimate.theta[k]),
            "std": None if fixed[k] else float(std[k]),
            "unit": unit_of(slot, effects, estimate.problem.rows.robot),
            "identified": bool(identified[k]),
            "excludes_zero": excludes_zero(every[k], float(estimate.theta[k]), float(std[k])),
            "beyond_limit": beyond_limit(every[k], float(estimate.theta[k])),
        }
        for k, slot in enumerate(estimate.slots)
        if slot.place in wanted.get(slot.effect, set())
    ]


def _one_step(s: Scored, scale: float) -> tuple[Array, Array, Bools]:
    """The score's own estimate one step from zero: values, standard errors, and which parameters the rows determine.

    Directions of a candidate that the rows hardly determine would take any value. So each parameter has the weak prior
    of a fit: undetermined directions stay at zero, with the standard error of the prior.
    """
    c = s.candidate
    if c.reasonable is None or not s.freedom:  # with a prior of its own, or of no known size
        return s.value, s.spread, np.ones(len(s.value), dtype=bool)
    prior = WEAK_SPREAD * c.reasonable
    # In units of the prior, the amplitudes are B z with z ~ N(0, 1), where B holds the directions that rows determine.
    B = np.linalg.pinv(s.weights / prior[:, None])
    precision = B.T @ B / scale**2 + np.eye(len(prior))
    value = prior * np.linalg.solve(precision, B.T @ s.amplitude) / scale**2
    std = prior * np.sqrt(np.diag(np.linalg.inv(precision)))
    return value, std, std < c.reasonable


def confusable_with(scored: Sequence[Scored], s: Scored) -> list[dict[str, Any]]:
    """The five candidates of other families that are most correlated with a candidate."""
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


def considered_of(scored: Sequence[Scored], null: Flips, most: int = LISTED) -> list[dict[str, Any]]:
    """The best candidates with their evidence, confirmed or not."""
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


def with_stand_ins(considered: list[dict[str, Any]], scores: CandidateScores) -> list[dict[str, Any]]:
    """Mark names that merely absorb a part of what the best probe explains."""
    whole = scores.probe.explained if scores.probe is not None else 0.0
    share = {s.candidate.label: s.explained / whole for s in scores.named if s.freedom and whole > 0}
    for entry in considered:
        part = share.get(label_of(entry["name"], entry["where"]), 0.0)
        if part > 0.2:
            entry["stand_in"] = f"absorbs {100 * min(part, 1.0):.0f} % of what is left"
    return considered


def variables_of(scores: CandidateScores) -> list[str]:
    """The variables of the best probe, and of others at the same place that fire nearly as strongly."""
    return _variables(scores, lambda best, s: s.candidate.places == best.candidate.places)


def variables_elsewhere(scores: CandidateScores) -> list[str]:
    """Variables by which an error of another place explains nearly as much, and the same."""
    return _variables(scores, lambda best, s: followed(best, s) > CONFUSABLE)


def _variables(scores: CandidateScores, belongs: Callable[[Scored, Scored], bool]) -> list[str]:
    """The variables of the best probe, and of others that fire nearly as strongly, if they belong to it."""
    best = scores.probe
    if best is None:
        return []
    names = dict.fromkeys(best.candidate.depends_on)
    for s in sorted(scores.free, key=lambda s: -s.bic):
        close = s.bic > NEARLY * best.bic and scores.free_null.p_familywise(s.log_p) <= DICTIONARY_FALSE_ALARMS
        if close and belongs(best, s):
            names |= dict.fromkeys(s.candidate.depends_on)
    return list(names)


def merged(candidates: list[dict[str, Any]]) -> list[dict[str, Any]]:
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
