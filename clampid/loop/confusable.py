"""Confusable pairs: an effect of a fit, and an absent effect that would explain the rows as well.

The two are confusable under three conditions. Without both of them, the fit's effect has strong evidence. Beyond what
the rest of the model absorbs, both have the same pattern. The fit with the absent effect instead is about as likely.
Evidence is strong from odds of e^10 on, and fits with smaller odds are about equally likely
(:data:`clampid.diagnosis.next_measurement.SAME` is twice the logarithm). A diagnosis does not find such pairs, because
it only searches for what a fit lacks: if an effect of the standard model explains what another one causes, nothing is
left to be found.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from clampid.diagnosis.candidate_scores import ABLE, CONFUSABLE
from clampid.diagnosis.next_measurement import SAME
from clampid.diagnosis.pruning import bic_gap
from clampid.effect import Effect, Stage
from clampid.evidence.candidates import Candidate, named_candidates
from clampid.evidence.columns import columns_from
from clampid.evidence.score import Scored, canonical, explained_together, score
from clampid.evidence.space import Space, space_of
from clampid.fitting.descent import newton_step
from clampid.fitting.noise import Whitened
from clampid.fitting.solve import Estimate, limits_of
from clampid.identification.fitted_stage import FittedStage, fit_stage
from clampid.models.model import StageModel
from clampid.role_slots import has_role
from clampid.roles import FRAMES, INERTIAL
from clampid.slots import Slot, Term

__all__ = ["Confusable", "confusable_pairs", "evidence_apart", "fitted_with"]

OPEN_PRIOR = 0.9  # share of the declared prior standard deviation: with less, other tables know the parameter already


@dataclass(frozen=True)
class Confusable:
    """Two effects that explain the same rows.

    Attributes
    ----------
    first, second
        The fit's effect, and the one that could replace it, each scored on the fit without both.
    without
        The fit without both.
    scale
        Standard deviation of the whitened residual of the fit with the first.
    apart
        Evidence for the first against the second: twice the logarithm of the odds.
    """

    first: Scored
    second: Scored
    without: Estimate
    scale: float
    apart: float

    @property
    def terms(self) -> tuple[Term, Term]:
        """The terms of both."""
        return self.first.candidate.terms[0], self.second.candidate.terms[0]


def confusable_pairs(
    fitted: FittedStage, searched: Collection[str], before: Mapping[Stage, StageModel]
) -> list[Confusable]:
    """Pairs of effects that the rows of a fit do not separate, or of which the absent one is the likelier.

    The pair whose first effect explains most comes first.

    Parameters
    ----------
    fitted
        The fit.
    searched
        Names of the effects to search for. Effects that a recorded temperature supersedes are searched as well,
        because the rows may not distinguish temperature from time.
    before
        The stages fitted before, whose values this one takes over.
    """
    estimate = fitted.estimate
    scale = space_of(estimate).scale
    absent = named_candidates(estimate, _looked_for(estimate.problem.effects, searched))
    absent = [c for c in absent if c.prior is None and len(c.terms) == 1]
    found = []
    for own in _own_candidates(estimate):
        without = _linear_without(estimate, own)
        space = replace(space_of(without), scale=scale)
        first = score(space, [own])[0]
        if first.state not in ABLE or first.bic < SAME:
            continue
        for second in _in_its_place(space, first, score(space, absent), estimate.problem.effects):
            apart = evidence_apart(fitted, first.candidate.terms[0], second.candidate.terms[0], before)
            if apart < SAME:
                found.append(Confusable(first, second, without, scale, apart))
    return sorted(found, key=lambda pair: -pair.first.explained)


def evidence_apart(fitted: FittedStage, first: Term, second: Term, before: Mapping[Stage, StageModel]) -> float:
    """Evidence for the first of two effects against the second: twice the logarithm of the odds of their fits.

    Everything else in the model is fitted in both. If one effect's amplitude comes out beyond its bounds, the evidence
    for the other one is infinite.
    """
    rest = [t for t in _by_place(fitted) if t not in (first, second)]
    fits = []
    for term in (first, second):
        terms = [*rest, term]
        same = {*terms} == {*_by_place(fitted)}
        fits.append(fitted if same else _fitted_to(fitted, terms, before))
    impossible = [_beyond(fit.estimate, term) for fit, term in zip(fits, (first, second), strict=True)]
    if impossible[0] != impossible[1]:
        return -np.inf if impossible[0] else np.inf
    odds = bic_gap([(fits[0].estimate, [first]), (fits[1].estimate, [second])], fitted.estimate.noise)
    return float(odds[1] - odds[0])


def fitted_with(fitted: FittedStage, more: Sequence[Term], before: Mapping[Stage, StageModel]) -> FittedStage:
    """Fit the same rows with further effects."""
    return _fitted_to(fitted, list(dict.fromkeys([*_by_place(fitted), *more])), before)


def _fitted_to(fitted: FittedStage, terms: Sequence[Term], before: Mapping[Stage, StageModel]) -> FittedStage:
    model = fitted.model
    others = model.carried_prior or before
    effects, start = fitted.estimate.problem.effects, model.values()
    return fit_stage(fitted.rows, effects, terms, others, start, model.held_out, last=fitted.estimate)


def _by_place(fitted: FittedStage) -> list[Term]:
    """The terms of a fit, one for each place; geometry stays one term, because its places depend on each other."""
    effects, out = fitted.estimate.problem.effects, []
    for term in fitted.model.terms:
        effect = effects[term.effect]
        places = [s.place for s in fitted.model.slots if s.effect == term.effect]
        whole = effect.per == "robot" or "link_frame" in effect.roles or not places
        out += [term] if term.place is not None or whole else [Term(term.effect, p) for p in dict.fromkeys(places)]
    return list(dict.fromkeys(out))


def _looked_for(effects: Mapping[str, Effect], searched: Collection[str]) -> dict[str, Effect]:
    return {
        name: replace(e, search=replace(e.search, superseded_by=None))
        for name, e in effects.items()
        if name in searched or e.search.superseded_by is not None
    }


def _own_candidates(estimate: Estimate) -> Iterator[Candidate]:
    """Each effect of a fit at each place, as a candidate for the fit without it.

    Left out are geometry and masses, which every arm has, and parameters that other tables know already.
    """
    problem, effects = estimate.problem, estimate.problem.effects
    shapes, fixed, declared = problem.shapes(), problem.fixed(), problem.prior_std()
    known = 1.0 / np.sqrt(np.maximum(np.diag(estimate.prior_precision), 1e-300)) < OPEN_PRIOR * declared
    groups: dict[tuple[str, str], list[int]] = {}
    for k, slot in enumerate(estimate.slots):
        if not has_role(slot, *FRAMES, *INERTIAL, effects=effects) and effects[slot.effect].event is None:
            groups.setdefault((slot.effect, slot.place), []).append(k)
    for (name, place), mine in groups.items():
        index = [k for k in mine if not shapes[k] and not fixed[k]]
        if not index or known[index].any():
            continue
        yield Candidate(
            name=name,
            family=effects[name].family,
            terms=(Term(name, place),),
            slots=tuple(estimate.slots[k] for k in index),
            shapes={estimate.slots[k]: float(estimate.theta[k]) for k in mine if shapes[k]},
            columns=columns_from(estimate.whitened, index),
            depends_on=(),
            places=(place,),
            reasonable=problem.sizes()[index],
            units=tuple(problem.parameters[k].unit for k in index),
            describes=effects[name].search.symptom_of,
        )


def _linear_without(estimate: Estimate, own: Candidate) -> Estimate:
    """The fit without one of its effects: everything else is refitted to first order about the fit with it."""
    white, slots = estimate.whitened, estimate.slots
    gone: set[Slot] = {s for s in slots if (s.effect, s.place) == (own.name, own.places[0])}
    count = len(slots)
    keep = np.array([k for k in range(len(estimate.theta)) if k >= count or slots[k] not in gone], dtype=int)
    amplitude = np.array([slots.index(s) for s in own.slots], dtype=int)
    left = white.residual + white.jacobian[:, amplitude] @ estimate.theta[amplitude]
    columns, precision = white.jacobian[:, keep], estimate.prior_precision[np.ix_(keep, keep)]
    moment = columns.T @ left + precision @ (estimate.prior_mean[keep] - estimate.theta[keep])
    problem = estimate.problem.with_slots([s for s in slots if s not in gone])
    free = ~limits_of(estimate.problem).resting(estimate.theta)[keep]
    step = newton_step(columns.T @ columns + precision, moment, problem.sizes(), 0.0, free)
    return replace(
        estimate,
        problem=problem,
        theta=estimate.theta[keep] + step,
        covariance=estimate.covariance[np.ix_(keep, keep)],
        whitened=Whitened(left - columns @ step, columns, white.entry, white.channel),
        prior_precision=precision,
        prior_mean=estimate.prior_mean[keep],
    )


def _in_its_place(space: Space, first: Scored, others: list[Scored], effects: Mapping[str, Effect]) -> list[Scored]:
    """Absent effects that explain what ``first`` explains, the likeliest first; one for each effect and place."""
    alike: dict[Term, Scored] = {}
    follows = partial(canonical, first)
    for other in sorted(others, key=lambda s: -s.bic):
        term, policy = other.candidate.terms[0], effects[other.candidate.name].search
        if other.state not in ABLE or term in alike or policy.refines == first.candidate.name:
            continue
        if other.candidate.name in first.candidate.describes or first.candidate.name in other.candidate.describes:
            continue  # a cause and its symptom: the diagnosis names the cause
        if other.explained < first.explained - SAME - other.freedom or other.bic < first.bic - SAME:
            continue
        both = explained_together(space, first, other)
        if follows(other) > CONFUSABLE and both - other.explained < SAME:
            alike[term] = other
    return list(alike.values())


def _beyond(estimate: Estimate, term: Term) -> bool:
    """Whether an amplitude of a term lies beyond its bounds by more than two standard errors."""
    shapes = estimate.problem.shapes()
    index = [k for k, s in enumerate(estimate.slots) if Term(s.effect, s.place) == term and not shapes[k]]
    return bool(np.any(estimate.beyond_bounds(2.0)[index]))
