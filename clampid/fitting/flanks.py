"""Flanks that follow the loads: a gear rests where its torque presses, and the torque depends on what is fitted.

The cost jumps where a joint's load changes its side, so that no step can be taken across. Flanks are frozen in each
search, and follow between searches until they stay. If a load is about zero they may cycle: with the flank frozen on
one side the fit moves the load to the other, and back. Then the fit of least cost is kept; each cost is computed on the
fit's own flanks, as its predictions will be.

An unloaded joint shows the product of its spring's compliance and its friction, so that both below zero fit as well as
both above, but for the flanks. A search that began on the wrong side ends there; its mirror image is another start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

import numpy as np

from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array

__all__ = ["mirrored", "settled"]

FLANK_ROUNDS = 8
SAGS = 1e-5  # of the largest: what loads follow of where the arm stands is a few thousandths of them again


class Found(Protocol):
    """What a search has found."""

    @property
    def theta(self) -> Array:
        """Where ``(P,)``."""


FoundT = TypeVar("FoundT", bound=Found)
Frozen = Sequence[FitProblem]


def settled(
    start: Array,
    frozen_at: Callable[[Array], Frozen],
    search: Callable[[Frozen, Array], FoundT],
    cost: Callable[[Frozen, Array], float],
) -> FoundT:
    """Search with flanks frozen, from ``start`` ``(P,)``, for at most `FLANK_ROUNDS` rounds.

    Parameters
    ----------
    frozen_at
        The experiments with flanks frozen where a parameter vector puts them.
    search
        The lowest point downhill from a parameter vector, flanks frozen.
    cost
        What a parameter vector costs, prior included.
    """
    frozen = frozen_at(start)
    found = search(frozen, start)
    # Of the searches before the last one only their ends are kept: all that was found there is as large as the rows.
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
    """The parameters ``(P,)`` with springs and friction above zero at joints where both are below; None if at none."""
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
    return all(
        x is y or (_alike(x, y, "flank", 0.0) and _alike(x, y, "sag_torque", SAGS)) for x, y in zip(a, b, strict=True)
    )


def _alike(a: FitProblem, b: FitProblem, signal: str, share: float) -> bool:
    x, y = (np.asarray(trial.rows.signals.get(signal, np.zeros(1))) for trial in (a, b))
    return float(np.abs(x - y).max(initial=0.0)) <= share * float(np.abs(y).max(initial=0.0))
