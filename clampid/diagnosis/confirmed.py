"""Confirmed steps, and the removal of earlier steps that a later one makes needless.

A step is confirmed on top of those before it. A shape close to the true one may be confirmed first; the true one comes
later and explains the same. So steps forward are followed by steps back, as in stepwise regression. Source: Efroymson,
Multiple regression analysis, in Mathematical Methods for Digital Computers, 1960.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from clampid.diagnosis.held_out import HELD_OUT_RATE, HeldOut
from clampid.diagnosis.pruning import needless
from clampid.diagnosis.rejected import evidence_of
from clampid.diagnosis.result import Step
from clampid.diagnosis.trial import Bench
from clampid.diagnosis.tried import Tried
from clampid.effect import Effect
from clampid.fitting.solve import Estimate
from clampid.identification.fitted_stage import FittedStage

__all__ = ["Confirmed", "with_needed_only"]


@dataclass(frozen=True)
class Confirmed:
    """A step, the model and its held-out errors before it, and the candidates refused before it, as listed."""

    tried: Tried
    base: FittedStage
    before: HeldOut
    refused: tuple[dict[str, Any], ...] = ()

    @property
    def label(self) -> str:
        """For people: the effect and where it is."""
        return self.tried.best.candidate.label

    def entry(self, effects: dict[str, Effect], estimate: Estimate) -> dict[str, Any]:
        """As the contract lists it, its parameters those of the last fit."""
        return self.tried.entry(effects, self.before.rms, estimate)

    def step(self, entry: dict[str, Any]) -> Step:
        """For the ledger."""
        evidence = evidence_of(entry, self.tried.best, self.tried.scores, self.refused)
        return Step(tuple(self.tried.kept), evidence, self.tried.fitted)


def with_needed_only(bench: Bench, steps: Sequence[Confirmed], again: set[str]) -> list[Confirmed]:
    """Drop earlier steps that, with the last one, neither justify their parameters nor lower the held-out error.

    Parameters
    ----------
    again
        Labels of steps that were dropped before: confirmed once more they stay. Those dropped now are added.
    """
    kept = list(steps)
    for earlier in steps[:-1]:
        last = kept[-1]
        if earlier.label in again or _carries(bench, earlier, kept):
            continue
        slim = needless(last.tried.fitted, earlier.tried.kept, bench.refit)
        if slim is None:
            continue
        without, now = bench.held_out(slim), last.tried.held_out
        if without.p_above(now, now.noise, bench.seed) <= HELD_OUT_RATE:
            continue
        again.add(earlier.label)
        kept = _without(bench, kept, earlier, replace(last.tried, fitted=slim, held_out=without))
    return kept


def _carries(bench: Bench, earlier: Confirmed, steps: Sequence[Confirmed]) -> bool:
    """Whether another step refines this one."""
    name = earlier.tried.best.candidate.name
    return any(bench.effects[t.effect].search.refines == name for s in steps for t in s.tried.kept if s is not earlier)


def _without(bench: Bench, steps: Sequence[Confirmed], dropped: Confirmed, last: Tried) -> list[Confirmed]:
    """The steps without one of them: those between it and the last one are fitted again on top of what was before."""
    at = steps.index(dropped)
    out, base, held_out = list(steps[:at]), dropped.base, dropped.before
    for step in steps[at + 1 : -1]:
        fitted = bench.refit([*base.model.terms, *step.tried.kept], step.tried.fitted, {})
        tried = replace(step.tried, fitted=fitted, held_out=bench.held_out(fitted))
        out.append(replace(step, tried=tried, base=base, before=held_out))
        base, held_out = fitted, tried.held_out
    reason = f"it does not lower the held-out error once {last.best.candidate.label} is in the model"
    gone = replace(dropped.tried, before=dropped.before.rms).refusal(bench.effects, reason)
    refused = (*dropped.refused, *steps[-1].refused, gone)
    return [*out, replace(steps[-1], tried=last, base=base, before=held_out, refused=refused)]
