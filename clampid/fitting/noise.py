"""The noise model of a stage: standard deviations and autocorrelations, and the whitening of residual and Jacobian.

Poses have independent noise of known relative size. Torques of logs and sweeps have correlated noise, so residual and
Jacobian both pass the filter of `clampid.stages.prewhitening`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Protocol

import numpy as np
import numpy.typing as npt

from clampid.chain.piecewise import runs_of
from clampid.fitting.anisotropy import relative_axes
from clampid.fitting.wander import Filter, Filters, Level, waves_of
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
from clampid.stages.rows import POSE_CHANNELS, Array, Integers, Rows

__all__ = ["Late", "Noise", "SparseColumns", "Whitened", "groups_of", "initial_noise", "learn_noise", "put_columns"]

LONG_MEMORY_LAG = ORDER // 2 + 1  # from this lag on, an autocorrelation is taken as that of a slow level
MAD_TO_STD = 1.4826  # standard deviation over median absolute deviation, of a normal distribution


class Late(Protocol):
    """A whitened Jacobian that is computed when it is first used."""

    def __hash__(self) -> int:
        """Hash by identity: the last dense Jacobians are cached."""

    def dense(self) -> Array:
        """J ``(M, P)``."""

    def normal(self) -> Array:
        """J'J ``(P, P)``, computed without J."""


@dataclass(frozen=True)
class Whitened:
    """Whitened residual and Jacobian: one entry for each used number, or for each group of them.

    Attributes
    ----------
    residual
        ``(M,)``, in units of the noise.
    source
        The Jacobian ``(M, P)``, or what computes it when it is first used. Of the latter only the last few are kept: a
        diagnosis remembers dozens of fits, and a Jacobian of hundreds of amplitudes takes 100 MB.
    entry
        Row ``(M,)`` that each entry came from; the middle row of a group.
    channel
        Column ``(M,)`` of ``measured`` that each entry came from.
    filters
        Of poses: what took the wandering level of their coordinates; None if they have none.
    """

    residual: Array
    source: Array | Late
    entry: Integers
    channel: Integers
    filters: Filters | None = None

    @property
    def jacobian(self) -> Array:
        """The whitened Jacobian ``(M, P)``."""
        return self.source if isinstance(self.source, np.ndarray) else _dense(self.source)

    @cached_property
    def normal(self) -> Array:
        """J'J ``(P, P)``."""
        J = self.source
        return np.asarray(J.T @ J) if isinstance(J, np.ndarray) else J.normal()

    def moved(self, step: Array) -> Whitened:
        """The same after a ``step`` ``(P,)`` of the parameters, for a model that is linear in them."""
        there = replace(self, residual=self.residual - self.jacobian @ step)
        there.__dict__["normal"] = self.normal
        return there

    def with_jacobian_of(self, other: Whitened) -> Whitened:
        """The residual of this, with the Jacobian of ``other``, which has the same rows."""
        return replace(self, source=other.source)


@dataclass(frozen=True)
class SparseColumns:
    """A Jacobian ``(N, m, P)``, channel by channel without the columns that are zero there.

    Most parameters of a log act on one motor only.

    Attributes
    ----------
    channels
        For each channel the numbers ``(k,)`` of its columns, ascending, and these ``(N, k)``.
    width
        Number of columns P.
    """

    channels: tuple[tuple[Integers, Array], ...]
    width: int

    @staticmethod
    def of(jacobian: Array) -> SparseColumns:
        """The columns of ``(N, m, P)`` that are not zero."""
        touched = [np.flatnonzero(np.any(jacobian[:, c], axis=0)) for c in range(jacobian.shape[1])]
        return SparseColumns(tuple((k, jacobian[:, c, k]) for c, k in enumerate(touched)), jacobian.shape[2])


@lru_cache(maxsize=2)  # the Jacobians of the fit under test and of the fit that it is compared with
def _dense(late: Late) -> Array:
    """The Jacobian ``(M, P)``; the last two are cached."""
    return late.dense()


@dataclass(frozen=True)
class Noise:
    """Standard deviations and, for logs, the autoregression of each channel.

    Attributes
    ----------
    sigma
        Standard deviation of the whole noise of each number ``(N, m)``, SI, along the rows' axes of noise.
    autocorrelations
        Autocorrelation of the noise of each channel, lag 0 to 64; empty for white noise.
    together
        Number of consecutive rows of a log that are averaged; standard deviations and autocorrelations are those of
        the averages.
    counts
        Number of values from which the noise of each channel was estimated.
    level
        Slow noise of the coordinates of points, or of all motors of a log; None if they have none
        (:mod:`clampid.fitting.wander`). No fit estimates it: the residual of a missing effect may wander too.
    """

    sigma: Array
    autocorrelations: tuple[Array, ...] = ()
    together: int = 1
    counts: tuple[float, ...] = ()
    level: Level | None = None

    @property
    def of_short_memory(self) -> Noise:
        """A log's noise without the plateau of its autocorrelation, which a slow level causes.

        An autoregression treats a wandering level as noise that is independent after each stop of the motor. The level
        is therefore modelled separately. Its share is the mean autocorrelation from :data:`LONG_MEMORY_LAG` on.
        """
        sigma, found = self.sigma.copy(), []
        for channel, before in enumerate(self.autocorrelations):
            plateau = max(float(np.mean(before[LONG_MEMORY_LAG : ORDER + 1])), 0.0)
            rest = (before[: ORDER + 1] - plateau) / (1.0 - plateau)
            found.append(autocorrelation(rest, np.full(ORDER + 1, ENOUGH_PAIRS)))
            sigma[:, channel] *= np.sqrt(1.0 - plateau)
        return replace(self, sigma=sigma, autocorrelations=tuple(found))

    def settled(self, again: Noise) -> bool:
        """Whether the noise of a log has converged: ``again`` was learned from a fit that this noise weighted."""
        if not self.autocorrelations:
            return False
        ratios = np.median(again.sigma / self.sigma, axis=0)
        channels = zip(ratios, self.autocorrelations, again.autocorrelations, again.counts, strict=True)
        return all(settled(*channel) for channel in channels)

    def whiten(self, rows: Rows, residual: Array, jacobian: Array, filters: Filters | None = None) -> Whitened:
        """Whiten a residual ``(N, m)`` and a Jacobian ``(N, m, P)`` of these rows, both SI.

        ``filters``: of these poses by this noise, if they are known already.
        """
        residual, jacobian = rows.in_noise_axes(residual), rows.in_noise_axes(jacobian)
        if self.autocorrelations:
            return self.whiten_sparse(rows, residual, SparseColumns.of(jacobian))
        channel, entry = np.nonzero(rows.used.T)
        sigma, columns = self.sigma[entry, channel], jacobian[entry, channel]
        columns /= sigma[:, None]  # in place: the Jacobian of a long table is the largest array
        white = residual[entry, channel] / sigma
        filters = filters or self._filters(rows, entry, channel)
        if filters is not None:
            filters(white[:, None])
            filters(columns)
        return Whitened(white, columns, entry, channel, filters)

    def without_level(self, rows: Rows, white: Whitened) -> Whitened:
        """Poses that this noise has whitened but for its level, without it."""
        filters = self._filters(rows, white.entry, white.channel)
        if filters is None:
            return white
        residual, jacobian = white.residual.copy(), white.jacobian.copy()
        filters(residual[:, None])
        return replace(white, residual=residual, source=filters(jacobian), filters=filters)

    def _filters(self, rows: Rows, entry: Integers, channel: Integers) -> Filters | None:
        """What takes the wandering level of poses from columns ``(M, k)``; None if they have none.

        ``entry``, ``channel`` ``(M,)``: row and channel of each of their numbers.
        """
        if self.level is None:
            return None
        first, last = (np.searchsorted(channel, POSE_CHANNELS[0], side=side) for side in ("left", "right"))
        found: list[tuple[slice, Filter]] = []
        for own in (slice(int(a), int(b)) for a, b in zip(first, last, strict=True) if a < b):
            same = (f for before, f in found if np.array_equal(entry[before], entry[own]))
            found.append((own, next(same, None) or waves_of(rows, entry[own]).filter(self.level)))
        return Filters(tuple(found))

    def whiten_sparse(self, rows: Rows, residual: Array, jacobian: SparseColumns) -> Whitened:
        """The same of a log, from the columns that are not zero."""
        parts_r, parts_j, entries, channels = [], [], [], []
        for c, (numbers, columns) in enumerate(jacobian.channels):
            index = np.flatnonzero(rows.used[:, c])
            if not len(index):
                continue
            both = self.whiten_channel(rows, c, np.c_[residual[:, c], columns])
            j = np.zeros((len(both), jacobian.width))
            put_columns(j, numbers, both[:, 1:])
            parts_r.append(both[:, 0])
            parts_j.append(j)
            entries.append(self._middle(rows, index))
            channels.append(np.full(len(both), c))
        if not parts_r:
            return Whitened(np.zeros(0), np.zeros((0, jacobian.width)), np.zeros(0, np.int64), np.zeros(0, np.int64))
        return Whitened(
            np.concatenate(parts_r), np.concatenate(parts_j), np.concatenate(entries), np.concatenate(channels)
        )

    def whiten_channel(self, rows: Rows, channel: int, columns: Array) -> Array:
        """Whiten columns ``(N, k)`` of one channel: ``(used rows, k)``, or ``(groups, k)`` if rows are averaged."""
        index = np.flatnonzero(rows.used[:, channel])
        out = columns[index] / self.sigma[index, channel][:, None]
        if not self.autocorrelations:
            return np.asarray(out)
        groups = groups_of(rows, index, self.together)
        whitener = Whitener(groups.row, groups.stretch)
        means, entry = groups.mean(out), self._middle(rows, index)
        predictors = Predictors(self.autocorrelations[channel])
        if self.level is None:
            return whitener(means, predictors)
        if not self.level.goes_on:
            return waves_of(rows, entry).filter(self.level)(whitener(means, predictors))
        both = whitener(np.c_[means, np.ones(len(means))], predictors)  # a constant level passes the same filter
        return waves_of(rows, entry, both[:, -1]).filter(self.level)(both[:, :-1])

    def shown_level(self, rows: Rows, channel: int) -> Array:
        """How much the prewhitened numbers of a channel show of a constant level ``(k,)``: in poses all of it.

        The filter lets through another share of a level just after a stop of the motor, where it has fewer rows before.
        """
        return replace(self, level=None).whiten_channel(rows, channel, self.sigma[:, channel, None])[:, 0]

    def _middle(self, rows: Rows, index: Integers) -> Integers:
        """The row of each whitened value ``(g,)``: the used row itself, or the middle row of a group."""
        if not self.autocorrelations or self.together == 1:
            return index
        return np.asarray(index[groups_of(rows, index, self.together).first + self.together // 2])

    def at(self, chosen: npt.NDArray[np.int64]) -> Noise:
        """The noise of the rows with numbers ``chosen``."""
        return replace(self, sigma=self.sigma[chosen])


def put_columns(out: Array, numbers: Integers, columns: Array) -> None:
    """``out[:, numbers] = columns``, numbers ascending: in runs, which takes a tenth of the time of single columns."""
    first = 0
    for run in runs_of(numbers):
        last = first + run.stop - run.start
        out[:, run] = columns[:, first:last]
        first = last


def initial_noise(rows: Rows) -> Noise:
    """Noise before any fit: white, with the standard deviations that the rows state."""
    return Noise(rows.sigma)


def learn_noise(rows: Rows, residual: Array, absorbed: Array | None = None) -> Noise:
    """Noise estimated from the residual of a fit: one scale for each kind of channel, and autocorrelations of torques.

    In poses, positions share one scale, rotations another and distances a third. Each motor has its own. The scale is
    the rms of the used residuals. A fit is thus weighted by the total error, of instrument and model together. The
    axes of the instrument have different scales if the points of single visits show it
    (:mod:`clampid.fitting.anisotropy`); their mean square does not change.

    Parameters
    ----------
    rows
        The fitted rows.
    residual
        ``(N, m)``, SI.
    absorbed
        ``(N, m, P)``, SI: J L, a square root of the covariance of the fitted prediction, with L Lᵀ the covariance of
        the parameters. A fit absorbs the slow part of the noise, such as its mean over a sweep. The products of the
        residual are too small by this part: E[e e' | r] = r r' + J C J'. Source: one step of the EM algorithm for
        variance components: Dempster, Laird, Rubin, Maximum likelihood from incomplete data via the EM algorithm,
        J. R. Stat. Soc. B 39, 1977.
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
            sigma[:, c] *= max(np.sqrt(products[0] / pairs[0]), 1e-12)  # without averaging and absorption this is 1
        autocorrelations.append(autocorrelation(products, pairs))
        counts.append(float(pairs[0]))
    return Noise(sigma, tuple(autocorrelations), together, tuple(counts))


def groups_of(rows: Rows, index: Integers, together: int) -> Grouping:
    """Groups of ``together`` consecutive rows among ``index`` ``(k,)``; for a thinned log, by the rows of the whole."""
    place = index if together == 1 else rows.log.log_row[index]
    return Grouping.of(place, rows.stretch[index], together)
