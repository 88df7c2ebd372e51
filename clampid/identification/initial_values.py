"""Initial values of effects whose parameters have no gradient at zero.

Of one that aligns another's curves, that other is fitted in its place, and its curves are aligned; of one that happens
once, the fit without it says when; of one with amplitudes of unknown size, a first fit says which size.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from clampid.effect import Effect, EffectError
from clampid.evidence.alignment import Alignment, alignment_of
from clampid.evidence.events import time_of
from clampid.evidence.of_size import sized
from clampid.evidence.scan import place_of
from clampid.fitting.solve import Estimate
from clampid.slots import Layout, Slot, Term

__all__ = ["initial_values"]

FitTerms = Callable[[Sequence[Term], Mapping[Slot, float]], Estimate]


def initial_values(
    terms: Sequence[Term],
    effects: Mapping[str, Effect],
    layout: Layout,
    start: Mapping[Slot, float],
    fit_terms: FitTerms,
) -> tuple[tuple[Term, ...], dict[Slot, float]]:
    """Terms and start values with which a fit can begin.

    An effect that sits somewhere along a joint's angle gets its likeliest place there.

    An event whose amplitudes have no start value yet gets the time at which it is likeliest, whatever time is given.

    An effect that aligns another's curves and has no start value yet gets its joints, and takes the other's place
    there; joints that were not named and do not share the curve have, or keep, one of their own.

    An effect with amplitudes of a size that has no value yet gets the size of the largest evidence.

    Parameters
    ----------
    start
        What is known of the values.
    fit_terms
        Fits some terms to the rows.

    Raises
    ------
    EffectError
        No two joints, or not those named, have the same curve.
    """
    terms, start = tuple(terms), dict(start)
    known = {slot.effect for slot in start}
    for name in dict.fromkeys(t.effect for t in terms):
        effect = effects[name]
        if effect.aligns is None or name in known:
            continue
        named = [t.place for t in terms if t.effect == name and t.place is not None]
        places = named or list(layout.allowed(effect))
        rest = tuple(t for t in terms if t.effect not in (name, effect.aligns))
        apart = _places(terms, effect.aligns, layout, effects)
        curves = tuple(Term(effect.aligns, p) for p in dict.fromkeys([*places, *apart]))
        estimate = fit_terms((*rest, *curves), start)
        found = alignment_of(estimate, effect, places)
        shared = [] if found is None else [f"joint{j + 1}" for j in found.joints]
        if found is None or not shared or (named and set(shared) != set(named)):
            raise EffectError(_refusal(name, effect.aligns, places, found))
        own = [p for p in dict.fromkeys([*apart, *places]) if p not in shared]
        terms = (*rest, *(Term(name, p) for p in shared), *(Term(effect.aligns, p) for p in own))
        start |= estimate.values() | found.values(effect)
    start |= _times(terms, effects, start, fit_terms)
    start |= _middles(terms, effects, layout, start, fit_terms)
    return terms, start | _sizes(terms, effects, start, fit_terms)


def _sizes(
    terms: Sequence[Term], effects: Mapping[str, Effect], start: Mapping[Slot, float], fit_terms: FitTerms
) -> dict[Slot, float]:
    """Sizes of amplitudes that have no value yet, with all amplitudes counted in them."""
    known = {(slot.effect, slot.parameter) for slot in start}
    names = dict.fromkeys(t.effect for t in terms)
    unsized = [n for n in names if effects[n].sized_by is not None and (n, effects[n].sized_by) not in known]
    if not unsized:
        return {}
    estimate = fit_terms(terms, start)
    found: dict[Slot, float] = {}
    for name in unsized:
        found |= sized(estimate, name)
    return found


def _times(
    terms: Sequence[Term], effects: Mapping[str, Effect], start: Mapping[Slot, float], fit_terms: FitTerms
) -> dict[Slot, float]:
    """When events happened that have no start value yet, one after the other."""
    found: dict[Slot, float] = {}
    clock = {(name, e.event) for name, e in effects.items() if e.event is not None}
    known = {slot.effect for slot in start if (slot.effect, slot.parameter) not in clock}
    new = [t for t in dict.fromkeys(terms) if effects[t.effect].event is not None and t.effect not in known]
    for k, term in enumerate(new):
        without = [t for t in terms if t not in new[k:]]
        found |= time_of(fit_terms(without, {**start, **found}), effects[term.effect])
    return found


def _middles(
    terms: Sequence[Term],
    effects: Mapping[str, Effect],
    layout: Layout,
    start: Mapping[Slot, float],
    fit_terms: FitTerms,
) -> dict[Slot, float]:
    """Where effects sit along a joint's angle that have no start value yet, one joint after the other."""
    found: dict[Slot, float] = {}
    known = {(slot.effect, slot.place) for slot in start if effects[slot.effect].scanned == slot.parameter}
    scanned = [t for t in dict.fromkeys(terms) if effects[t.effect].scanned is not None]
    every = [Term(t.effect, p) for t in scanned for p in ([t.place] if t.place else layout.allowed(effects[t.effect]))]
    new = [t for t in every if (t.effect, t.place) not in known]
    rest = [t for t in terms if t not in scanned]
    for k, term in enumerate(new):
        before = [t for t in every if t not in new[k:]]
        without = fit_terms([*rest, *before], {**start, **found})
        found |= place_of(without, effects[term.effect], str(term.place))
    return found


def _places(terms: Sequence[Term], name: str, layout: Layout, effects: Mapping[str, Effect]) -> list[str]:
    """Where an effect is active."""
    own = [t.place for t in terms if t.effect == name]
    return list(layout.allowed(effects[name])) if None in own else [p for p in own if p is not None]


def _refusal(name: str, own: str, places: Sequence[str], found: Alignment | None) -> str:
    """Why the joints do not share a curve."""
    where = ", ".join(places)
    if found is None:
        return f"{name}: expected two joints or more that could share a curve, found {where or 'none'}"
    odds = ", ".join(f"joint{j + 1} {value:.1f}" for j, value in sorted(found.refused.items()))
    return (
        f"{name}: these rows do not say that the angle errors of {where} are one curve (logarithm of the odds to share "
        f"one: {odds}); {own} gives each joint a curve of its own"
    )
