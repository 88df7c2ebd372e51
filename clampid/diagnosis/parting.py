"""Choice of further measurements by the T-criterion, the other explanation fitted again.

To distinguish two candidates: if one of them is true, with its estimated size, which sum of squares does a model with
the other one leave? To test a candidate: which sum of squares does a model without it leave, if it has the size that is
to be found? Measurements are chosen to make this sum, in units of the noise's variance, large. Source: Atkinson &
Fedorov, The design of experiments for discriminating between two rival models, Biometrika 62, 1975.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from clampid.diagnosis.refit_signals import Normal, Rivals, Signal, add_measurement, each_beside_another
from clampid.stages.rows import Array

__all__ = ["Parting", "Showing", "part", "show"]


@dataclass(frozen=True)
class Parting:
    """Measurements chosen from a pool.

    Attributes
    ----------
    chosen
        Numbers in the pool, in the order of their choice.
    before, after
        Sum of squares that the closest distinguishable pair leaves unexplained of each other, in units of variance:
        now, and with these.
    shared
        Share of its signal that the closest pair has in common, 0 to 1: now, and with these.
    never
        Pairs of candidates that the whole pool does not distinguish, their share in common, and the sum of squares
        that they leave unexplained of each other.
    """

    chosen: tuple[int, ...]
    before: float
    after: float
    shared: tuple[float, float] = (1.0, 1.0)
    never: tuple[tuple[int, int, float, float], ...] = ()


@dataclass(frozen=True)
class Showing:
    """Measurements chosen from a pool so that signals show.

    Attributes
    ----------
    chosen
        Numbers in the pool, in the order of their choice.
    before, after, most
        ``(s,)``: what a model without it leaves of each signal, in units of variance: now, with these, and with all.
    """

    chosen: tuple[int, ...]
    before: Array
    after: Array
    most: Array


def part(
    rivals: Rivals,
    pool_nuisance: Array,
    pool_columns: Sequence[Array],
    *,
    enough: float,
    batch: int,
    most: int,
    cost: Array | None = None,
) -> Parting:
    """Choose measurements that distinguish candidates, greedily, always for the closest pair, in batches.

    Pairs that the whole pool does not distinguish are left out, unless these are all.

    Parameters
    ----------
    rivals
        The candidates in the rows so far.
    pool_nuisance, pool_columns
        The same columns in measurements to choose from: ``(K, r, P)`` and ``(K, r, k)`` each.
    enough
        What the closest pair shall leave of each other; then no further batch is added.
    batch, most
        Measurements in a batch, and in all.
    cost
        ``(K,)``: what each measurement costs, such as seconds; the gain counts for what it costs.
    """
    nuisance, columns, values, precision = rivals.nuisance, rivals.columns, rivals.values, rivals.precision
    signals = each_beside_another(rivals, pool_nuisance, pool_columns)
    whole = {normal: normal.with_all() for normal in dict.fromkeys(s.normal for s in signals.values())}
    without = Normal(nuisance, precision, pool_nuisance)
    whole[without] = without.with_all()
    alone = [
        Signal(without, nuisance, D @ v, pool_D @ v) for D, v, pool_D in zip(columns, values, pool_columns, strict=True)
    ]
    never = []
    for a, b in combinations(range(len(columns)), 2):
        left = {k: signals[k].with_all(whole[signals[k].normal]) for k in ((a, b), (b, a))}
        if min(left.values()) < enough:
            share = max(_shared(rest, alone[k[0]].with_all(whole[without])) for k, rest in left.items())
            never.append((a, b, share, min(left.values())))
    hopeless = {frozenset(pair[:2]) for pair in never}
    able = {k: s for k, s in signals.items() if frozenset(k) not in hopeless} or signals
    before, start = _closest(able, alone)
    chosen = _choose(list(able.values()), [enough] * len(able), batch, most, cost)
    for k in chosen:
        add_measurement(alone, k)
    after, end = _closest(able, alone)
    return Parting(tuple(chosen), before, after, (start, end), tuple(never))


def _closest(signals: Mapping[tuple[int, int], Signal], alone: Sequence[Signal]) -> tuple[float, float]:
    """What the closest pair leaves unexplained of each other, and the share that it has in common."""
    left = {k: signal.left() for k, signal in signals.items()}
    closest = min(left, key=lambda k: left[k])
    return left[closest], _shared(left[closest], alone[closest[0]].left())


def _shared(left: float, alone: float) -> float:
    """The share of a signal that another candidate follows, of what a model without both leaves of it."""
    return float(np.clip(1.0 - left / alone, 0.0, 1.0)) if alone > 0.0 else 1.0


def show(
    nuisance: Array,
    signals: Sequence[Array],
    pool_nuisance: Array,
    pool_signals: Sequence[Array],
    enough: Sequence[float],
    *,
    batch: int,
    most: int,
    cost: Array | None = None,
) -> Showing:
    """Choose measurements that show signals, greedily, always for the weakest signal, in batches.

    Parameters
    ----------
    nuisance, pool_nuisance
        As for `part`; what is known before any row are further rows of ``nuisance``.
    signals, pool_signals
        Whitened signals ``(M,)`` in the rows so far, of the size that is to be found, and ``(K, r)`` in the pool.
    enough
        Sum of squares that a model without it shall leave of each signal. Signals below it with the whole pool are
        given up.
    """
    count = nuisance.shape[1]
    normal = Normal(nuisance, np.zeros((count, count)), pool_nuisance)
    found = [Signal(normal, nuisance, y, pool_y) for y, pool_y in zip(signals, pool_signals, strict=True)]
    every = normal.with_all()
    before, whole = np.array([s.left() for s in found]), np.array([s.with_all(every) for s in found])
    able = [k for k in range(len(found)) if whole[k] >= enough[k]]
    chosen = _choose([found[k] for k in able], [enough[k] for k in able], batch, most, cost) if able else []
    for k, signal in enumerate(found):
        if k not in able:
            for measurement in chosen:
                signal.add(measurement)
    return Showing(tuple(chosen), before, np.array([s.left() for s in found]), whole)


def _choose(signals: Sequence[Signal], enough: Sequence[float], batch: int, most: int, cost: Array | None) -> list[int]:
    """Add measurements to all signals until each leaves enough; their numbers."""
    pool = len(signals[0].pool_y)
    price = np.ones(pool) if cost is None else cost
    goal: Array = np.asarray(enough, dtype=float)
    chosen: list[int] = []

    def reached() -> Array:
        return np.asarray([signal.left() for signal in signals] / goal, dtype=float)

    share = reached()
    while share.min() < 1.0 and len(chosen) < min(most, pool):
        for _ in range(min(batch, most - len(chosen), pool - len(chosen))):
            gains = signals[int(np.argmin(share))].gains() / price
            gains[chosen] = -np.inf
            chosen.append(int(np.argmax(gains)))
            add_measurement(signals, chosen[-1])
            share = reached()
    return chosen
