"""Which further measurements tell what the rows so far do not: the T-criterion, the other explanation fitted again.

If one of two candidates is what is there, of the size that the rows show, how much of it would a model with the other
one instead leave unexplained? And of a candidate that the rows cannot test: how much of it, of the size that is to be
found, would a model without it leave? That sum of squares, in units of the noise, is what measurements are to make
large. Source: Atkinson & Fedorov, The design of experiments for discriminating between two rival models, Biometrika 62,
1975.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy import linalg

from clampid.stages.rows import Array

__all__ = ["Parting", "Rivals", "Separation", "Showing", "part", "part_each", "show"]


@dataclass(frozen=True)
class Parting:
    """Measurements chosen from a pool.

    Attributes
    ----------
    chosen
        Numbers in the pool, in the order of their choice.
    before, after
        What the closest pair that can be parted leaves unexplained of each other, in units of variance: now, and with
        these.
    shared
        Share of its signal that the closest pair has in common, 0 to 1: now, and with these.
    never
        Pairs of candidates that the whole pool together does not part, the share that they would still have in common,
        and what they would leave unexplained of each other.
    """

    chosen: tuple[int, ...]
    before: float
    after: float
    shared: tuple[float, float] = (1.0, 1.0)
    never: tuple[tuple[int, int, float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class Rivals:
    """Candidates that may explain the same rows.

    Attributes
    ----------
    nuisance, columns
        Whitened columns ``(M, P)`` of what is fitted in any case, and ``(M, k)`` of each candidate, in the rows so far.
    values
        ``(k,)``: what the rows make of each candidate.
    precision
        ``(P, P)``: the prior of what is fitted in any case.
    """

    nuisance: Array
    columns: Sequence[Array]
    values: Sequence[Array]
    precision: Array


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


@dataclass(frozen=True)
class Separation:
    """Measurements chosen from a pool for several pairs at once.

    Attributes
    ----------
    chosen
        Numbers in the pool, in the order of their choice.
    pairs
        Numbers of the pairs that they were chosen for.
    before, after
        ``(pairs,)``: what the two of each of these leave unexplained of each other, in units of variance: now, and with
        the measurements.
    parted
        Whether that is enough for each of them.
    """

    chosen: tuple[int, ...]
    pairs: tuple[int, ...]
    before: Array
    after: Array
    parted: bool


RIDGE = 1e-10
"""Prior weight of a direction, in units of its own column's: what nothing determines must not explain a new row."""


class _Normal:
    """The normal matrix of what a model fits, as measurements are added. Signals of the same columns share it."""

    def __init__(self, X: Array, precision: Array, pool_X: Array) -> None:
        self.pool_X = pool_X
        self.A = X.T @ X + precision

    @cached_property
    def factor(self) -> tuple[Array, Array]:
        """The balance of its columns, and the lower Cholesky factor of the balanced matrix."""
        balance = 1.0 / np.sqrt(np.maximum(np.diag(self.A), 1e-300))
        A = self.A * np.outer(balance, balance)
        A[np.diag_indices_from(A)] += RIDGE
        return balance, linalg.cholesky(A, lower=True, overwrite_a=True, check_finite=False)

    def solved(self, b: Array) -> Array:
        """The fitted values of right-hand sides ``(P,)``."""
        balance, lower = self.factor
        return np.asarray(balance * linalg.cho_solve((lower, True), balance * b, check_finite=False))

    @cached_property
    def spread(self) -> Array:
        """Covariance ``(K, r, r)`` of each measurement of the pool as a fit predicts it, its own noise with it."""
        balance, lower = self.factor
        count, rows, width = self.pool_X.shape
        flat = (self.pool_X.reshape(-1, width) * balance).T
        half = linalg.solve_triangular(lower, flat, lower=True, overwrite_b=True, check_finite=False)
        half = half.reshape(width, count, rows)
        return np.asarray(np.einsum("pkr,pks->krs", half, half) + np.eye(rows))

    def add(self, k: int) -> None:
        """Add one measurement of the pool."""
        X = self.pool_X[k]
        self.A = self.A + X.T @ X
        for name in ("factor", "spread"):
            self.__dict__.pop(name, None)

    def with_all(self) -> _Normal:
        """The same with every measurement of the pool."""
        X = self.pool_X.reshape(-1, self.pool_X.shape[2])
        return _Normal(X, self.A, self.pool_X)


class _Signal:
    """What a model leaves of a signal that it does not have, as measurements are added."""

    def __init__(self, normal: _Normal, X: Array, y: Array, pool_y: Array) -> None:
        self.normal, self.pool_y = normal, pool_y
        self.b, self.squares = X.T @ y, float(y @ y)

    def left(self) -> float:
        """Sum of squares that is left."""
        return max(self.squares - float(self.b @ self.normal.solved(self.b)), 0.0)

    def gains(self) -> Array:
        """By how much each measurement of the pool would raise it, the model fitted again."""
        left = self.pool_y - self.normal.pool_X @ self.normal.solved(self.b)
        return np.asarray(np.einsum("kr,kr->k", left, np.linalg.solve(self.normal.spread, left[..., None])[..., 0]))

    def add(self, k: int) -> None:
        """Add one measurement of the pool to the signal; `_Normal.add` adds it to what is fitted."""
        X, y = self.normal.pool_X[k], self.pool_y[k]
        self.b, self.squares = self.b + X.T @ y, self.squares + float(y @ y)

    def with_all(self, whole: _Normal) -> float:
        """What is left with every measurement of the pool; ``whole`` is what is fitted then."""
        X, y = self.normal.pool_X.reshape(-1, self.normal.pool_X.shape[2]), self.pool_y.ravel()
        b = self.b + X.T @ y
        return max(self.squares + float(y @ y) - float(b @ whole.solved(b)), 0.0)


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
    """Choose measurements that part candidates, greedily, always for the pair that is closest, in batches.

    Pairs that not even the whole pool parts are left out, unless that is all of them.

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
    signals = _each_beside_another(rivals, pool_nuisance, pool_columns)
    whole = {normal: normal.with_all() for normal in dict.fromkeys(s.normal for s in signals.values())}
    without = _Normal(nuisance, precision, pool_nuisance)
    whole[without] = without.with_all()
    alone = [
        _Signal(without, nuisance, D @ v, pool_D @ v)
        for D, v, pool_D in zip(columns, values, pool_columns, strict=True)
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
        _add(alone, k)
    after, end = _closest(able, alone)
    return Parting(tuple(chosen), before, after, (start, end), tuple(never))


def part_each(
    pairs: Sequence[Rivals],
    pools: Sequence[tuple[Array, Sequence[Array]]],
    *,
    enough: float,
    batch: int,
    most: int,
    cost: Array | None = None,
) -> Separation:
    """Choose measurements that part the two of each of several pairs, each pair beside a fit of its own.

    They are chosen as by `part`. Of pairs that the measurements allowed do not part together, the one that is farthest
    from it is left out, again and again; of those that not even the whole pool parts, all are. The last one is kept,
    if the whole pool parts it.

    Parameters
    ----------
    pairs
        Of two candidates each.
    pools
        Of each pair, the same columns in measurements to choose from: ``(K, r, P)``, and ``(K, r, k)`` of each
        candidate. A number in the pool is the same measurement for all pairs.
    enough, batch, most, cost
        As for `part`. Of a pair that leaves enough now already, ``enough`` more is aimed at.
    """
    wanted = []
    for number, (rivals, pool) in enumerate(zip(pairs, pools, strict=True)):
        signals = _each_beside_another(rivals, *pool).values()
        if min(signal.with_all(signal.normal.with_all()) for signal in signals) >= enough:
            wanted.append(number)
    while wanted:
        each = [list(_each_beside_another(pairs[k], *pools[k]).values()) for k in wanted]
        before = np.array([min(s.left() for s in two) for two in each])
        goal = np.where(before < enough, enough, before + enough)
        every = [s for two in each for s in two]
        chosen = _choose(every, np.repeat(goal, 2).tolist(), batch, most, cost)
        after = np.array([min(s.left() for s in two) for two in each])
        parted = bool(np.all(after >= goal))
        if parted or len(wanted) == 1:
            return Separation(tuple(chosen), tuple(wanted), before, after, parted)
        wanted.pop(int(np.argmin(after / goal)))
    return Separation((), (), np.zeros(0), np.zeros(0), False)


def _each_beside_another(
    rivals: Rivals, pool_nuisance: Array, pool_columns: Sequence[Array]
) -> dict[tuple[int, int], _Signal]:
    """(a, b) → candidate a as a signal beside a fit that has b instead; those beside one b share what is fitted."""
    signals: dict[tuple[int, int], _Signal] = {}
    for b, column in enumerate(rivals.columns):
        width = column.shape[1]
        prior = linalg.block_diag(rivals.precision, np.zeros((width, width)))
        X, pool_X = np.c_[rivals.nuisance, column], np.concatenate([pool_nuisance, pool_columns[b]], axis=2)
        normal = _Normal(X, prior, pool_X)
        for a, (mine, value) in enumerate(zip(rivals.columns, rivals.values, strict=True)):
            if a != b:
                signals[a, b] = _Signal(normal, X, mine @ value, pool_columns[a] @ value)
    return signals


def _closest(signals: Mapping[tuple[int, int], _Signal], alone: Sequence[_Signal]) -> tuple[float, float]:
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
    """Choose measurements in which signals show, greedily, always for the one that is farthest from it, in batches.

    Parameters
    ----------
    nuisance, pool_nuisance
        As for `part`; what is known before any row are further rows of ``nuisance``.
    signals, pool_signals
        Whitened signals ``(M,)`` in the rows so far, of the size that is to be found, and ``(K, r)`` in the pool.
    enough
        What a model without it shall leave of each signal. Those of which the whole pool leaves less are given up.
    """
    count = nuisance.shape[1]
    normal = _Normal(nuisance, np.zeros((count, count)), pool_nuisance)
    found = [_Signal(normal, nuisance, y, pool_y) for y, pool_y in zip(signals, pool_signals, strict=True)]
    every = normal.with_all()
    before, whole = np.array([s.left() for s in found]), np.array([s.with_all(every) for s in found])
    able = [k for k in range(len(found)) if whole[k] >= enough[k]]
    chosen = _choose([found[k] for k in able], [enough[k] for k in able], batch, most, cost) if able else []
    for k, signal in enumerate(found):
        if k not in able:
            for measurement in chosen:
                signal.add(measurement)
    return Showing(tuple(chosen), before, np.array([s.left() for s in found]), whole)


def _add(signals: Sequence[_Signal], k: int) -> None:
    """Add a measurement of the pool to signals and, once each, to what is fitted beside them."""
    for signal in signals:
        signal.add(k)
    for normal in {id(s.normal): s.normal for s in signals}.values():
        normal.add(k)


def _choose(
    signals: Sequence[_Signal], enough: Sequence[float], batch: int, most: int, cost: Array | None
) -> list[int]:
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
            _add(signals, chosen[-1])
            share = reached()
    return chosen
