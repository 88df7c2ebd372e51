"""Noise: what the residual of a right model looks like, and how to make it white.

Poses: independent numbers of known relative size. Torques, whether of a log or of a sweep, follow each other closely
and are correlated, so that residual and columns alike pass the filter of `clampid.stages.prewhitening`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Protocol

import numpy as np
import numpy.typing as npt

from clampid.fitting.anisotropy import relative_axes
from clampid.fitting.wander import course_of
from clampid.stages.prewhitening import (
    ENOUGH_PAIRS,
    ORDER,
    Grouping,
    Predictors,
    Whitener,
    autocorrelation,
    lag_products,
    settled,
)
from clampid.stages.row_constants import LogConstants
from clampid.stages.rows import Array, Integers, Rows

__all__ = ["Late", "Noise", "Whitened", "groups_of", "initial_noise", "learn_noise"]

LONG_MEMORY = ORDER // 2 + 1  # lags from which on an autocorrelation is a level's
NORMAL = 1.4826  # median absolute deviation to standard deviation of a normal


class Late(Protocol):
    """A whitened Jacobian that is made when it is asked for."""

    def __hash__(self) -> int:
        """Each its own."""

    def dense(self) -> Array:
        """J ``(M, P)``."""

    def normal(self) -> Array:
        """J'J ``(P, P)``, for which J need not be made."""


@dataclass(frozen=True)
class Whitened:
    """Whitened residual ``(M,)`` and Jacobian ``(M, P)``, one entry per used number, or per group of them.

    ``entry`` ``(M,)`` is the row, of a group the middle one, ``channel`` ``(M,)`` the column of ``measured`` that each
    entry came from. Of Jacobians that are made when they are asked for only the last few are kept: a diagnosis
    remembers dozens of fits, and one of hundreds of amplitudes has 100 MB.
    """

    residual: Array
    source: Array | Late
    entry: Integers
    channel: Integers

    @property
    def jacobian(self) -> Array:
        """``(M, P)``."""
        return self.source if isinstance(self.source, np.ndarray) else _made(self.source)

    @cached_property
    def normal(self) -> Array:
        """J'J ``(P, P)``."""
        J = self.source
        return np.asarray(J.T @ J) if isinstance(J, np.ndarray) else J.normal()

    def moved(self, step: Array) -> Whitened:
        """The same at parameters ``(P,)`` that are a step away, of a model that is linear in them."""
        there = Whitened(self.residual - self.jacobian @ step, self.source, self.entry, self.channel)
        there.__dict__["normal"] = self.normal
        return there

    def with_jacobian_of(self, other: Whitened) -> Whitened:
        """The residual of this, and the Jacobian of another one of the same rows."""
        return Whitened(self.residual, other.source, self.entry, self.channel)


@lru_cache(maxsize=2)  # of the fit that is judged, and of the one that it is judged against
def _made(late: Late) -> Array:
    return late.dense()


@dataclass(frozen=True)
class Noise:
    """Standard deviations and, for logs, the autoregression of each channel.

    Attributes
    ----------
    sigma
        ``(N, m)``: standard deviation of each number, all of its noise, SI; along the rows' axes of noise.
    autocorrelations
        Per channel that of its noise, lag 0 to 64; empty for white noise.
    together
        Rows of a log of which the mean is one number to the noise: standard deviation and autocorrelation are of these.
    counts
        Of how many numbers each channel's noise was learned.
    wander
        ``(m,)`` or empty: by how much each channel's level wanders, variance per step over that of a number
        (:mod:`clampid.fitting.wander`). No fit learns it: what a model lacks may wander too.
    """

    sigma: Array
    autocorrelations: tuple[Array, ...] = ()
    together: int = 1
    counts: tuple[float, ...] = ()
    wander: tuple[float, ...] = ()

    @property
    def of_short_memory(self) -> Noise:
        """A log's noise without the plateau of its autocorrelation: that is a level's, which is to be taken apart.

        An autoregression takes a level that wanders for noise that is forgotten at each stop of the motor, and counts
        it as new in each move. What lags beyond :data:`LONG_MEMORY` have in common is the level's.
        """
        sigma, found = self.sigma.copy(), []
        for channel, before in enumerate(self.autocorrelations):
            plateau = max(float(np.mean(before[LONG_MEMORY : ORDER + 1])), 0.0)
            rest = (before[: ORDER + 1] - plateau) / (1.0 - plateau)
            found.append(autocorrelation(rest, np.full(ORDER + 1, ENOUGH_PAIRS)))
            sigma[:, channel] *= np.sqrt(1.0 - plateau)
        return replace(self, sigma=sigma, autocorrelations=tuple(found))

    def settled(self, again: Noise) -> bool:
        """Whether a log's noise learned ``again`` from a fit that was weighted by this one is still the same."""
        if not self.autocorrelations:
            return False
        ratios = np.median(again.sigma / self.sigma, axis=0)
        channels = zip(ratios, self.autocorrelations, again.autocorrelations, again.counts, strict=True)
        return all(settled(*channel) for channel in channels)

    def whiten(self, rows: Rows, residual: Array, jacobian: Array) -> Whitened:
        """Whiten a residual ``(N, m)`` and a Jacobian ``(N, m, P)`` of these rows."""
        residual, jacobian = rows.in_noise_axes(residual), rows.in_noise_axes(jacobian)
        if not self.autocorrelations:
            channel, entry = np.nonzero(rows.used.T)
            sigma, columns = self.sigma[entry, channel], jacobian[entry, channel]
            columns /= sigma[:, None]  # in place: a long table's Jacobian is its largest array
            white = residual[entry, channel] / sigma
            for number in np.flatnonzero(self.wander).tolist():
                own = channel == number
                both = self._steady(rows, number, entry[own], np.c_[white[own], columns[own]])
                white[own], columns[own] = both[:, 0], both[:, 1:]
            return Whitened(white, columns, entry, channel)
        parts_r, parts_j, entries, channels = [], [], [], []
        for c in range(residual.shape[1]):
            used = rows.used[:, c]
            index = np.flatnonzero(used)
            if not len(index):
                continue
            own = jacobian[:, c]
            touched = np.any(own, axis=0)  # most columns of a log touch one motor only
            both = self.whiten_channel(rows, c, np.c_[residual[:, c], own[:, touched]])
            r, j = both[:, 0], np.zeros((len(both), jacobian.shape[2]))
            j[:, touched] = both[:, 1:]
            parts_r.append(r)
            parts_j.append(j)
            entries.append(self._middle(rows, index))
            channels.append(np.full(len(both), c))
        if not parts_r:
            return Whitened(np.zeros(0), np.zeros((0, jacobian.shape[2])), np.zeros(0, np.int64), np.zeros(0, np.int64))
        return Whitened(
            np.concatenate(parts_r), np.concatenate(parts_j), np.concatenate(entries), np.concatenate(channels)
        )

    def whiten_channel(self, rows: Rows, channel: int, columns: Array) -> Array:
        """Whiten columns ``(N, k)`` of one channel: ``(used rows, k)``, or as many as there are groups of them."""
        index = np.flatnonzero(rows.used[:, channel])
        out = columns[index] / self.sigma[index, channel][:, None]
        if not self.autocorrelations:
            return np.asarray(out)
        groups = groups_of(rows, index, self.together)
        whitener = Whitener(groups.row, groups.stretch)
        white = whitener(groups.mean(out), Predictors(self.autocorrelations[channel]))
        return self._steady(rows, channel, self._middle(rows, index), white)

    def _steady(self, rows: Rows, channel: int, entry: Integers, white: Array) -> Array:
        """Whitened columns ``(k, c)`` of one channel without what its level wanders."""
        if not self.wander or self.wander[channel] == 0.0:
            return white
        return course_of(rows, entry).innovations(white, self.wander[channel])[0]

    def _middle(self, rows: Rows, index: Integers) -> Integers:
        """The rows ``(g,)`` that stand for what is whitened of the used rows ``(k,)``."""
        if not self.autocorrelations or self.together == 1:
            return index
        return np.asarray(index[groups_of(rows, index, self.together).first + self.together // 2])

    def at(self, chosen: npt.NDArray[np.int64]) -> Noise:
        """The noise of some of the rows."""
        return Noise(self.sigma[chosen], self.autocorrelations, self.together, self.counts, self.wander)


def initial_noise(rows: Rows) -> Noise:
    """What is known before any fit: the rows' own standard deviations, white."""
    return Noise(rows.sigma)


def learn_noise(rows: Rows, residual: Array, absorbed: Array | None = None) -> Noise:
    """Noise from a fit's residual ``(N, m)``: one scale per kind of channel, and for logs their autoregression.

    In poses positions share one scale, rotations another and distances a third; each motor has its own. The scale is
    the rms of the used residuals, so that a fit is weighted by what its model leaves, whichever of instrument and model
    that is. Along the axes of the instrument it differs where points of one visit say so
    (:mod:`clampid.fitting.anisotropy`); their mean square stays.

    Parameters
    ----------
    absorbed
        ``(N, m, P)``: a square root of the covariance of what the fit predicts, J L with L Lᵀ the covariance of its
        parameters. A fit takes the slow part of the noise for its own, such as the mean over a sweep, so that the
        residual's products fall short of the noise's by just that: E[e e' | r] = r r' + J C J'. Source: Dempster,
        Laird, Rubin, Maximum likelihood from incomplete data via the EM algorithm, J. R. Stat. Soc. B 39, 1977, for
        variance components; one step of it.
    """
    sigma = rows.sigma.copy()
    for inside in map(list, rows.kind.channels(residual.shape[1])):
        used = rows.used[:, inside]
        if inside and used.any():
            white = (rows.in_noise_axes(residual)[:, inside] / rows.sigma[:, inside])[used]
            sigma[:, inside] = rows.sigma[:, inside] * max(float(np.sqrt(np.mean(white**2))), 1e-12)
    if rows.kind.points:
        sigma[:, :3] *= relative_axes(rows, residual)
        return Noise(sigma)
    autocorrelations, counts, together = [], [], rows.log.together if isinstance(rows.constants, LogConstants) else 1
    for c in range(residual.shape[1]):
        index = np.flatnonzero(rows.used[:, c])
        x = residual[:, c, None] if absorbed is None else np.c_[residual[:, c], absorbed[:, c]]
        taken = groups_of(rows, index, together)
        products, pairs = lag_products(taken.mean(x[index] / sigma[index, c, None]), taken.row, taken.stretch)
        if (absorbed is not None or together > 1) and pairs[0]:
            sigma[:, c] *= max(np.sqrt(products[0] / pairs[0]), 1e-12)  # the residual alone, row by row, has scale 1
        autocorrelations.append(autocorrelation(products, pairs))
        counts.append(float(pairs[0]))
    return Noise(sigma, tuple(autocorrelations), together, tuple(counts))


def groups_of(rows: Rows, index: Integers, together: int) -> Grouping:
    """The groups of some rows ``(k,)``; of a log that is thinned, by their places in the whole of it."""
    place = index if together == 1 else rows.log.log_row[index]
    return Grouping.of(place, rows.stretch[index], together)
