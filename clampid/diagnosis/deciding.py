"""Which further measurements decide most of the open pairs of effects, measurement by measurement.

The evidence between two effects is twice the logarithm of the odds of their fits. A pair is open until it exceeds a
bound. If the first effect is the true one, measurements raise the evidence by λ on average, with the standard deviation
2 √λ: λ is the sum of squares, in units of the noise, that a fit with the second effect, everything else fitted again,
leaves of the first (the T-criterion). If the second is true, it falls likewise. So the evidence so far and λ give the
chance that the measurements decide the pair. Proposals of every kind, poses after a rest as well as poses at once, are
compared by the number of pairs that they are expected to decide, for each measurement.

Sources: Atkinson & Fedorov, The design of experiments for discriminating between two rival models, Biometrika 62, 1975;
for the weights of the two models Ponce de Leon & Atkinson, Optimum experimental design for discriminating between two
rival models in the presence of prior information, Biometrika 78, 1991.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from clampid.diagnosis.refit_signals import Rivals, Signal, add_measurement, each_beside_another
from clampid.stages.rows import Array

__all__ = ["Deciding", "OpenPair", "chance_decided", "decide_most"]


@dataclass(frozen=True, eq=False)
class OpenPair:
    """Two effects that explain the same so far.

    Attributes
    ----------
    rivals
        The two in the rows so far.
    pool
        The same columns in measurements to choose from: ``(K, r, P)`` of what is fitted in any case, and ``(K, r, k)``
        of each of the two. A number in the pool is the same measurement for all pairs.
    evidence
        Of the first over the second so far; negative: the second is the likelier.
    """

    rivals: Rivals
    pool: tuple[Array, Sequence[Array]]
    evidence: float


@dataclass(frozen=True)
class Deciding:
    """Measurements chosen from a pool, and what they are expected to decide.

    Attributes
    ----------
    chosen
        Numbers in the pool, in the order of their choice.
    chances
        ``(pairs,)``: that the measurements decide each pair.
    before, after
        ``(pairs,)``: what the two leave unexplained of each other, the lesser one, in units of variance: now, and with
        the measurements.
    """

    chosen: tuple[int, ...]
    chances: Array
    before: Array
    after: Array

    @property
    def decided(self) -> float:
        """Expected number of pairs that are decided, for each measurement."""
        return float(self.chances.sum()) / len(self.chosen) if self.chosen else 0.0

    def likely(self, power: float) -> tuple[int, ...]:
        """Numbers of the pairs that are decided with a probability; where there are none, of the likeliest one."""
        return tuple(np.flatnonzero(self.chances >= min(power, float(self.chances.max()))).tolist())


def chance_decided(evidence: float, gain: Sequence[float], bound: float) -> float:
    """The chance that measurements raise the evidence between two effects above a bound.

    Parameters
    ----------
    evidence
        Of the first over the second so far, twice the logarithm of the odds.
    gain
        By how much the measurements raise it on average if the first is true, and lower it if the second is.
    """
    first = _chance_of_first(evidence)
    return first * _exceeds(evidence, gain[0], bound) + (1.0 - first) * _exceeds(-evidence, gain[1], bound)


def _chance_of_first(evidence: float) -> float:
    return float(1.0 / (1.0 + np.exp(-evidence / 2.0)))


def _exceeds(evidence: float, gain: float, bound: float) -> float:
    """The chance that evidence for the true effect then lies beyond the bound, for it or against it."""
    if gain <= 0.0:
        return float(abs(evidence) >= bound)
    mean, spread = evidence + gain, 2.0 * np.sqrt(gain)
    return float(stats.norm.sf((bound - mean) / spread) + stats.norm.cdf((-bound - mean) / spread))


def _needed(evidence: float, bound: float, power: float) -> float:
    """The average gain with which the evidence for the likelier effect exceeds the bound with a probability."""
    z = float(stats.norm.ppf(power))
    return float((z + np.sqrt(z**2 + max(bound - abs(evidence), 0.0))) ** 2)


class _Watched:
    """An open pair as measurements are added to it."""

    def __init__(self, pair: OpenPair, bound: float, power: float) -> None:
        both = each_beside_another(pair.rivals, *pair.pool)
        self.signals: list[Signal] = [both[0, 1], both[1, 0]]
        self.evidence, self.bound = pair.evidence, bound
        self.needed = _needed(pair.evidence, bound, power)
        first = _chance_of_first(pair.evidence)
        self.weights = np.array([first, 1.0 - first])
        self.before = self.left()

    def left(self) -> Array:
        return np.array([signal.left() for signal in self.signals])

    def raised(self) -> Array:
        """By how much the measurements added so far raise what is left, of either."""
        return np.maximum(self.left() - self.before, 0.0)

    def possible(self) -> bool:
        """Whether the whole pool decides it."""
        whole = np.array([signal.with_all(signal.normal.with_all()) for signal in self.signals])
        return bool(np.min(whole - self.before) >= self.needed)

    def reached(self) -> bool:
        """Whether the measurements added so far bring what it needs, on average over which of the two is true."""
        return bool(self.weights @ self.raised() >= self.needed)

    def gains(self) -> Array:
        """``(K,)``: the share of what it needs that each measurement of the pool brings."""
        both = [weight * signal.gains() for weight, signal in zip(self.weights, self.signals, strict=True)]
        return np.asarray(np.sum(both, axis=0) / self.needed)

    def chance(self) -> float:
        return chance_decided(self.evidence, self.raised().tolist(), self.bound)


def decide_most(
    pairs: Sequence[OpenPair], *, bound: float, power: float, batch: int, most: int, cost: Array | None = None
) -> Deciding:
    """Choose measurements for all open pairs together, one by one, and of their number the best.

    Every next measurement is the one that brings most of what the pairs still need, summed over the pairs. As many
    batches are taken as decide most pairs for each measurement. Pairs that not even the whole pool decides are left
    out.

    Parameters
    ----------
    bound
        Evidence that decides a pair.
    power
        A pair needs so much that it is decided with this probability.
    batch, most
        Measurements in a batch, and in all.
    cost
        ``(K,)``: what each measurement costs, such as seconds.
    """
    watched = [_Watched(pair, bound, power) for pair in pairs]
    able = [pair for pair in watched if pair.possible()]
    if not able:
        return Deciding((), np.zeros(len(pairs)), *[np.array([w.before.min() for w in watched])] * 2)
    pool = len(able[0].signals[0].pool_y)
    price = np.ones(pool) if cost is None else cost
    chosen: list[int] = []
    found: list[Deciding] = []
    while len(chosen) < min(most, pool):
        for _ in range(min(batch, most - len(chosen), pool - len(chosen))):
            needing = [pair for pair in able if not pair.reached()] or able
            gains = np.sum([pair.gains() for pair in needing], axis=0) / price
            gains[chosen] = -np.inf
            chosen.append(int(np.argmax(gains)))
            for pair in able:
                add_measurement(pair.signals, chosen[-1])
        chances = np.array([pair.chance() if pair in able else 0.0 for pair in watched])
        ends = [np.array([w.before.min() for w in watched]), np.array([w.left().min() for w in watched])]
        found.append(Deciding(tuple(chosen), chances, *ends))
        if all(pair.reached() for pair in able):
            break
    return max(found, key=lambda one: one.decided)
