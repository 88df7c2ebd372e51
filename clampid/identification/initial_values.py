"""Initial values of effects whose shape parameters have no gradient at zero amplitude.

An effect that aligns the curves of another gets its initial values from a fit of the other. The time of an event,
the position of an effect along a joint's angle, and its order come from a fit without the effect. The size of
amplitudes comes from a first fit with them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from clampid.effect import Effect, EffectError
from clampid.evidence.alignment import Alignment, alignment_of
from clampid.evidence.events import time_of
from clampid.evidence.of_size import sized
from clampid.evidence.orders import order_of
from clampid.evidence.scan import place_of
from clampid.fitting.solve import Estimate
from clampid.slots import Layout, Slot, Term

__all__ = ["initial_values"]

FitTerms = Callable[[Sequence[Term], Mapping[Slot, float]], Estimate]
"""A fit of some terms from some initial values, SI."""


def initial_values(
    terms: Sequence[Term],
    effects: Mapping[str, Effect],
    layout: Layout,
    start: Mapping[Slot, float],
    fit_terms: FitTerms,
) -> tuple[tuple[Term, ...], dict[Slot, float]]:
    """Terms and initial values with which a fit can start.

    * An effect at an unknown angle of a joint gets the likeliest angle, one of unknown order the likeliest order.
    * An event whose amplitudes have no initial value gets the likeliest time, even if a time is given.
    * An effect that aligns the curves of another, and has no initial value, gets the joints that share one curve. It
      replaces the other effect there. Joints that were not named and do not share the curve have a curve of their own.
    * An effect with amplitudes of unknown size gets the size with the largest evidence.

    Parameters
    ----------
    terms
        The wanted terms.
    effects
        Name → effect.
    layout
        Layout of the campaigns.
    start
        Slot → known initial value, SI.
    fit_terms
        Fits some terms to the rows.

    Returns
    -------
    terms, start
        The terms, and slot → initial value, SI.

    Raises
    ------
    EffectError
        No two joints, or not the named ones, have the same curve.
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
    start |= _sought(terms, effects, layout, start, fit_terms)
    return terms, start | _sizes(terms, effects, start, fit_terms)


def _sizes(
    terms: Sequence[Term], effects: Mapping[str, Effect], start: Mapping[Slot, float], fit_terms: FitTerms
) -> dict[Slot, float]:
    """Sizes of amplitudes that have no value yet, from a fit with all terms."""
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
    """Times, s, of events whose amplitudes have no initial value, found one after the other."""
    found: dict[Slot, float] = {}
    clock = {(name, e.event) for name, e in effects.items() if e.event is not None}
    known = {slot.effect for slot in start if (slot.effect, slot.parameter) not in clock}
    new = [t for t in dict.fromkeys(terms) if effects[t.effect].event is not None and t.effect not in known]
    for k, term in enumerate(new):
        without = [t for t in terms if t not in new[k:]]
        found |= time_of(fit_terms(without, {**start, **found}), effects[term.effect])
    return found


def _sought(
    terms: Sequence[Term],
    effects: Mapping[str, Effect],
    layout: Layout,
    start: Mapping[Slot, float],
    fit_terms: FitTerms,
) -> dict[Slot, float]:
    """Angles, rad, and orders of effects where they are unknown, found one joint after the other."""
    found: dict[Slot, float] = {}
    sought = {name: e.scanned or e.order for name, e in effects.items()}
    known = {(slot.effect, slot.place) for slot in start if sought[slot.effect] == slot.parameter}
    own = [t for t in dict.fromkeys(terms) if sought[t.effect] is not None]
    every = [Term(t.effect, p) for t in own for p in ([t.place] if t.place else layout.allowed(effects[t.effect]))]
    new = [t for t in every if (t.effect, t.place) not in known]
    rest = [t for t in terms if t not in own]
    for k, term in enumerate(new):
        before = [t for t in every if t not in new[k:]]
        without = fit_terms([*rest, *before], {**start, **found})
        effect = effects[term.effect]
        likeliest = place_of if effect.scanned is not None else order_of
        found |= likeliest(without, effect, str(term.place))
    return found


def _places(terms: Sequence[Term], name: str, layout: Layout, effects: Mapping[str, Effect]) -> list[str]:
    """The places at which the effect ``name`` is active."""
    own = [t.place for t in terms if t.effect == name]
    return list(layout.allowed(effects[name])) if None in own else [p for p in own if p is not None]


def _refusal(name: str, own: str, places: Sequence[str], found: Alignment | None) -> str:
    """The message of an error: the joints do not share a curve."""
    where = ", ".join(places)
    if found is None:
        return f"{name}: expected two joints or more that could share a curve, found {where or 'none'}"
    odds = ", ".join(f"joint{j + 1} {value:.1f}" for j, value in sorted(found.refused.items()))
    return (
        f"{name}: expected joints with the same curve of angle errors, found no evidence of one for {where} (logarithm "
        f"of the odds: {odds}); {own} gives each joint its own curve"
    )
