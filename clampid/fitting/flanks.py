"""Flanks that follow the loads: a gear is in contact on the flank to which its torque presses it.

The torque depends on the fitted parameters, and the cost jumps where a joint's load changes its sign. Flanks are
therefore frozen during each search, and updated between searches until they no longer change. If a load is close to
zero they may cycle: with the flank frozen on one side, the fit moves the load to the other side, and back. Then the fit
with the smallest cost is kept. Each cost is computed on the flanks of its own fit.

An unloaded joint shows only the product of its compliance and its friction. Except for the flanks, both negative fit as
well as both positive. A search that started on the wrong side ends there; its mirror image is another start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

import numpy as np

from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array

__all__ = ["mirrored", "settled"]

FLANK_ROUNDS = 8
SAG_TOLERANCE = 1e-5  # of the largest torque by sag, which itself is a few thousandths of the loads


class Found(Protocol):
    """The result of a search."""

    @property
    def theta(self) -> Array:
        """The parameter vector ``(P,)``, SI."""


FoundT = TypeVar("FoundT", bound=Found)
Frozen = Sequence[FitProblem]


def settled(
    start: Array,
    frozen_at: Callable[[Array], Frozen],
    search: Callable[[Frozen, Array], FoundT],
    cost: Callable[[Frozen, Array], float],
) -> FoundT:
    """The result of searches with frozen flanks, repeated until the flanks stay, at most `FLANK_ROUNDS` times.

    Parameters
    ----------
    start
        Initial values ``(P,)``, SI.
    frozen_at
        Gives the problems with flanks frozen as a parameter vector determines them.
    search
        Gives the local minimum from a parameter vector, with frozen flanks.
    cost
        Gives the cost of a parameter vector with frozen flanks, prior included.
    """
    frozen = frozen_at(start)
    found = search(frozen, start)
    # Of earlier searches only the parameter vector is kept: the whole result needs as much memory as the rows.
    seen, ends = [frozen], [found.theta]
    for _ in range(FLANK_ROUNDS):
        moved = frozen_at(found.theta)
        if _same(frozen, moved):
            return found
        if any(_same(other, moved) for other in seen):
            break
        frozen = moved
        found = search(frozen, found.theta)
        seen.append(frozen)
        ends.append(found.theta)
    lowest = min(range(len(ends)), key=lambda k: cost(frozen_at(ends[k]), ends[k]))
    return found if lowest == len(ends) - 1 else search(seen[lowest], ends[lowest])


def mirrored(trial: FitProblem, theta: Array) -> Array | None:
    """The parameters ``(P,)`` with springs and friction made positive where both are negative; else None."""
    if not trial.chain.reads_flanks:
        return None
    below: dict[str, dict[str, list[int]]] = {"friction": {}, "spring": {}}
    for k, (slot, parameter) in enumerate(zip(trial.slots, trial.parameters, strict=True)):
        effect = trial.effects[slot.effect]
        spring = "joint_angle" in effect.acts and "torque" in effect.needs and theta[k] < parameter.bounds[0]
        if spring or theta[k] < trial.chain.least[k]:
            below["spring" if spring else "friction"].setdefault(slot.place, []).append(k)
    both = below["spring"].keys() & below["friction"].keys()
    index = [k for side in below.values() for place in both for k in side[place]]
    if not index:
        return None
    out = theta.copy()
    out[index] = -out[index]
    return out


def _same(a: Frozen, b: Frozen) -> bool:
    """Whether two sets of problems have the same flanks, and sag torques that differ by less than a tolerance."""
    return all(
        x is y or (_alike(x, y, "flank", 0.0) and _alike(x, y, "sag_torque", SAG_TOLERANCE))
        for x, y in zip(a, b, strict=True)
    )


def _alike(a: FitProblem, b: FitProblem, signal: str, share: float) -> bool:
    """Whether a signal differs by at most a share of its largest value."""
    x, y = (np.asarray(trial.rows.signals.get(signal, np.zeros(1))) for trial in (a, b))
    return float(np.abs(x - y).max(initial=0.0)) <= share * float(np.abs(y).max(initial=0.0))
