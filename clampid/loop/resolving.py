"""Requested effects: the places at which the rows identify them, and initial values of a fit with them.

The fit starts as in a diagnosis, at one Gauss-Newton step towards the effect. The cost has several minima where gears
may rest on either flank. From another start ``add`` would end in another minimum, with other errors than ``diagnose``
reports.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from clampid.diagnosis.linear_refit import step_towards
from clampid.effect import Effect
from clampid.evidence.candidates import named_candidates
from clampid.evidence.events import event_scores
from clampid.evidence.orders import order_scores
from clampid.evidence.scan import scan
from clampid.evidence.score import Scored, score
from clampid.evidence.space import space_of
from clampid.identification.fitted_stage import FittedStage
from clampid.slots import Slot, Term

__all__ = ["Resolved", "by_effect", "resolved"]

PERMUTATIONS = 20  # for p-values, which are not read here


@dataclass(frozen=True)
class Resolved:
    """The terms that the rows identify, place by place, and initial values of a fit with them, SI."""

    terms: tuple[Term, ...]
    start: Mapping[Slot, float]


def by_effect(terms: Sequence[Term]) -> list[tuple[Term, ...]]:
    """Terms grouped by effect, in the order of first mention: effects are added one after the other."""
    return [tuple(t for t in terms if t.effect == name) for name in dict.fromkeys(t.effect for t in terms)]


def resolved(asked: Sequence[Term], fitted: FittedStage, effects: Mapping[str, Effect]) -> Resolved:
    """Find where the rows of a fit identify some effects that it does not have.

    Parameters
    ----------
    asked
        Requested terms. Without a place: wherever these rows identify the effect.
    fitted
        The fit without them.
    effects
        All known effects, by name.
    """
    values = fitted.model.values()
    if not asked:
        return Resolved((), values)
    estimate = fitted.estimate
    active = {slot.effect for slot in estimate.slots}
    out = {t: None for t in asked if effects[t.effect].aligns is not None and t.effect not in active}
    asked = [t for t in asked if effects[t.effect].aligns is None]
    absent = {  # a request is what an opt-in effect waits for
        t.effect: replace(e, search=replace(e.search, opt_in=False)) for t in asked for e in (effects[t.effect],)
    }
    space = space_of(estimate)
    scored = [*score(space, named_candidates(estimate, absent)), *event_scores(estimate, space, absent)]
    scored += [*order_scores(estimate, space, absent), *scan(estimate, space, absent, PERMUTATIONS, seed=0)]
    shapes: dict[Slot, float] = {}
    best: dict[tuple[Term, ...], Scored] = {}
    for term in asked:
        effect = effects[term.effect]
        own = [s for s in scored if s.candidate.name == term.effect and s.freedom]
        if term.place is not None and effect.search.scope == "jointly":
            if own and term in own[0].candidate.terms:
                out[term] = None
            continue
        if term.place is not None and effect.per != "robot" and effect.search.scope != "together":
            own = [s for s in own if s.candidate.places == (term.place,)]
        for s in sorted(own, key=lambda s: s.explained):
            shapes |= dict(s.candidate.shapes)
            out |= dict.fromkeys(s.candidate.terms)
            best[s.candidate.terms] = s
    step = step_towards(estimate, *best.values()) if best else None
    return Resolved(tuple(out), values | (step.near.values() if step is not None and step.falls else shapes))
