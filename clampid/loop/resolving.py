"""Effects that somebody asks for: at which places the rows identify them, and where a search for them starts.

A search starts as that of a diagnosis does, at one Gauss-Newton step towards the effect. Where gears may rest on either
flank there are several minima. From another start ``add`` would end in another one, with other errors than ``diagnose``
has said.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from clampid.diagnosis.linear_refit import step_towards
from clampid.effect import Effect
from clampid.evidence.candidates import named_candidates
from clampid.evidence.events import event_scores
from clampid.evidence.score import Scored, score
from clampid.evidence.space import space_of
from clampid.identification.fitted_stage import FittedStage
from clampid.slots import Slot, Term

__all__ = ["Resolved", "by_effect", "resolved"]


@dataclass(frozen=True)
class Resolved:
    """Terms place by place, where the rows identify them, and initial values of a fit with them."""

    terms: tuple[Term, ...]
    start: Mapping[Slot, float]


def by_effect(terms: Sequence[Term]) -> list[tuple[Term, ...]]:
    """Terms by their effect, in the order in which the effects come first: a diagnosis confirms one after the other."""
    return [tuple(t for t in terms if t.effect == name) for name in dict.fromkeys(t.effect for t in terms)]


def resolved(asked: Sequence[Term], fitted: FittedStage, effects: Mapping[str, Effect]) -> Resolved:
    """Resolve terms on a fit without them.

    Parameters
    ----------
    asked
        With a place, or without: then wherever these rows identify the effect.
    """
    values = fitted.model.values()
    if not asked:
        return Resolved((), values)
    estimate = fitted.estimate
    active = {slot.effect for slot in estimate.slots}
    out = {t: None for t in asked if effects[t.effect].aligns is not None and t.effect not in active}
    asked = [t for t in asked if effects[t.effect].aligns is None]
    absent = {  # somebody asks for them
        t.effect: replace(e, search=replace(e.search, opt_in=False)) for t in asked for e in (effects[t.effect],)
    }
    space = space_of(estimate)
    scored = [*score(space, named_candidates(estimate, absent)), *event_scores(estimate, space, absent)]
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
