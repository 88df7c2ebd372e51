"""The null distribution of scores: the largest of all candidates under random signs of the residual's units.

The maximum over all candidates (Westfall and Young) controls false alarms over everything tested.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clampid.evidence.score import Scored, flip_moments, tail_of
from clampid.evidence.space import Space
from clampid.stages.rows import Array

__all__ = ["Flips", "with_null"]

LEAST_EXCESS = 1e-3  # of maxima under flips above their median: those of very few flips may all be one


@dataclass(frozen=True)
class Flips:
    """The null distribution of the smallest p-value: maxima ``(flips,)`` of -ln p over all candidates."""

    maxima: Array

    def p_familywise(self, log_p: float) -> float:
        """Familywise p-value: chance of so small a p-value of any candidate under the null; at least 1/(flips + 1)."""
        return float((1 + np.sum(self.maxima >= -log_p)) / (len(self.maxima) + 1))

    def critical_log_p(self, rate: float) -> float:
        """The ln p below which a candidate is significant at this familywise false-alarm rate."""
        return -float(np.quantile(self.maxima, 1 - rate))

    def log_p_at(self, p: float) -> float:
        """The largest ln p of a candidate that has this familywise p-value, or a smaller one."""
        beyond = int(np.floor(p * (len(self.maxima) + 1) + 1e-9)) - 1  # how many maxima may be as large
        rest = np.sort(self.maxima)[::-1][max(beyond, 0) :]
        return -float(np.nextafter(rest[0], np.inf)) if len(rest) else 0.0

    def joined(self, tests: int, seed: int) -> Flips:
        """The same with further tests that have p-values of their own: under the null, -ln p is exponential."""
        drawn = np.random.default_rng([seed, tests]).exponential(size=(len(self.maxima), tests))
        return Flips(np.maximum(self.maxima, drawn.max(axis=1, initial=0.0)))

    def sharing(self, others: Sequence[Scored], seed: int) -> tuple[list[Scored], Flips]:
        """Other candidates, tested by a null of their own, on this scale, and the null of which half is for them.

        If they were some more tests among many, they would have next to nothing of the false-alarm rate.
        """
        drawn = np.random.default_rng(seed).exponential(size=len(self.maxima))
        scale = _Scale(self.maxima, np.random.default_rng(seed).exponential(size=10_000))
        on_scale = [replace(s, log_p=min(-float(scale(np.array(-s.log_p))), 0.0)) if s.freedom else s for s in others]
        return on_scale, Flips(np.maximum(self.maxima, scale(drawn)))


def with_null(space: Space, scored: Sequence[Scored], flips: int, seed: int) -> tuple[list[Scored], Flips]:
    """The scores, and the null of their maxima by sign flips of units and normal draws of prior pseudo-rows.

    Where units are few there is a second statistic (:mod:`clampid.evidence.studentised`), and the more significant of
    the two counts, in each flip too. Its -ln p is put on the scale of the first one's, by the medians and mean excesses
    of both maxima.

    Parameters
    ----------
    space
        The residual on which the candidates were scored.
    scored
        The candidates, with their ``parts``.
    flips, seed
        Number of random flips, and their seed.

    Returns
    -------
    scored, null
        The former without what only the null needs.
    """
    chosen = [s for s in scored if s.freedom]
    if not chosen:
        return [s.remembered for s in scored], Flips(np.zeros(flips))
    signs = space.signs(flips, seed)
    amplitude = signs @ np.hstack([s.parts for s in chosen])
    kept, ends = np.concatenate([s.kept for s in chosen]), np.cumsum([0, *(s.freedom for s in chosen)])
    explained = np.add.reduceat(amplitude**2 * kept, ends[:-1], axis=1) / space.scale**2
    moments = [flip_moments(s.parts, s.kept, space.scale, space.drawn) for s in chosen]
    tails = [tail_of(m, x) for m, x in zip(moments, explained.T, strict=True)]
    maxima = -np.min(tails, axis=0)
    others = [(s.studentised, a, b) for s, a, b in zip(chosen, ends, ends[1:], strict=False)]
    second = [t.log_p(amplitude[:, a:b], signs) for t, a, b in others if t is not None]
    if not second:
        return [s.remembered for s in scored], Flips(maxima)
    by_rest = -np.min(second, axis=0)
    scale = _Scale(maxima, by_rest)
    return [s.by_either(scale).remembered for s in scored], Flips(np.maximum(maxima, scale(by_rest)))


class _Scale:
    """Puts -ln p of one statistic on the scale of another one's, by the maxima of both under flips."""

    def __init__(self, to: Array, of: Array) -> None:
        self._to, self._of = (self._tail(maxima) for maxima in (to, of))

    def __call__(self, minus_log_p: Array) -> Array:
        return np.asarray(self._to[0] + (minus_log_p - self._of[0]) * self._to[1] / self._of[1])

    @staticmethod
    def _tail(maxima: Array) -> tuple[float, float]:
        """Median, and mean excess above it."""
        median = float(np.median(maxima))
        above = maxima[maxima > median] - median
        return median, max(float(above.mean()) if len(above) else 0.0, LEAST_EXCESS)
