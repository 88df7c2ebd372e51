"""Test whether a measurement's noise wanders (its zero moves slowly, at random), given the significant candidates.

Signs are flipped visit by visit, or block by block of a log. If the zero of a reading moves for minutes, blocks are not
independent, and every slow variable becomes falsely significant: an offset, a temperature, the time. But a missing
effect may be slow too. So readings count as wandering in two cases:

* in addition to the best significant name and probe (in logs, the best probe of each motor: a motor's probe explains no
  other motor's torque). If these explain all slow changes, none are left.
* if one parameter, the variance of the level, is likelier than the best name with all its parameters, and than the
  probes with theirs. Evidence is twice the log-likelihood, less the logarithm of the count for each parameter (Schwarz,
  Ann. Stat. 6, 1978).

A constant level of a motor's readings is no wandering: a level that begins anywhere explains an offset as well.

In neither case if a smooth function of time is likelier still, such as an instrument's drift with the time of day. That
is a systematic error, which may be found as a missing effect. Poses may have both: if a swing of one period is likelier
than none beside a level that wanders, the level is what wanders beside the swing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from clampid.evidence.columns import channel_starts
from clampid.evidence.score import Scored
from clampid.fitting.noise import Noise
from clampid.fitting.solve import Estimate
from clampid.fitting.wander import Filter, Level, larger, wander_of, waves_of
from clampid.stages.rows import POSE_CHANNELS, Array

__all__ = ["WANDERS", "known_to_wander", "level_beside", "of_level", "whitened_by"]

WANDERS = (
    "The readings wander: their level changes slowly and at random (chance below 1 %), so slow changes count less as "
    "evidence."
)

COSINES = 12  # half waves over the whole time of measurement, at most
PERIOD_STEP = 0.5  # half waves between the periods of a swing that are tried
# An effect of so many, as a curve over a joint's turn has, is not taken to explain a wandering.
MOST_PARAMETERS = 300
LARGEST_SHARE_OF_COLUMNS = 0.2  # of the numbers of a channel, that may be columns beside which it wanders


def level_beside(estimate: Estimate, beside: Sequence[Sequence[Scored]], least: Level | None = None) -> Level | None:
    """By how much the readings of an estimate wander, or None where that is not significant.

    The coordinates of a point wander alike, and so do the readings of a log's motors, each in units of its noise.

    Parameters
    ----------
    beside
        Significant candidates that may explain all slow changes, the most significant first, in groups whose members
        explain different readings.
    least
        By how much the readings are known to wander at least. If that is known, the level is one for the whole log;
        before, what changes at a stop of the motor may be a missing effect.
    """
    rows, white = estimate.problem.rows, estimate.whitened
    if rows.kind.solved or not len(white.residual):
        return None
    wanted = POSE_CHANNELS[0] if rows.kind.points else range(rows.measured.shape[1])
    channels = {int(white.channel[start]): slice(start, stop) for start, stop in channel_starts(white)}
    mine = {c: channels[c] for c in wanted if c in channels}
    goes_on = least is not None
    level = larger(_seen(estimate, mine, beside, goes_on), least) if mine else None
    return None if level is None else replace(level, goes_on=goes_on)


def of_level(estimate: Estimate, level: Level) -> Estimate:
    """The same estimate, its residual and Jacobian whitened by its noise with a level that wanders by so much."""
    noise, rows = replace(estimate.noise, level=level), estimate.problem.rows
    if rows.kind.points:
        return replace(estimate, noise=noise, whitened=noise.without_level(rows, estimate.whitened))
    return whitened_by(estimate, noise)


def known_to_wander(estimate: Estimate, level: Level) -> Estimate:
    """The same estimate of a log, whitened by a noise with short memory and a level that wanders by so much."""
    noise = estimate.noise.of_short_memory if estimate.noise.autocorrelations else estimate.noise
    return whitened_by(estimate, replace(noise, level=level))


def whitened_by(estimate: Estimate, noise: Noise) -> Estimate:
    """The same estimate, its residual and Jacobian whitened by another noise."""
    residual, jacobian = estimate.problem.residual(estimate.theta)
    return replace(estimate, noise=noise, whitened=noise.whiten(estimate.problem.rows, residual, jacobian))


def _seen(
    estimate: Estimate, mine: Mapping[int, slice], beside: Sequence[Sequence[Scored]], goes_on: bool
) -> Level | None:
    """By how much some channels, entries of each given, are seen to wander beside what stands out; None if not."""
    rows, white = estimate.problem.rows, estimate.whitened
    shown = {c: estimate.noise.shown_level(rows, c) if goes_on else None for c in mine}
    waves = [waves_of(rows, white.entry[own], shown[c]) for c, own in mine.items()]
    # All numbers of a visit share how well the robot repeats, which flicker noise of as many waves as visits imitates.
    flickers = not rows.kind.points
    residuals = [white.residual[own] for own in mine.values()]
    none = [np.ones((len(r), 1)) for r in residuals]
    if not mine or wander_of(waves, residuals, none, flickers=flickers) is None:
        return None  # not even by itself, which takes a hundredth of the time
    active = none
    if len(estimate.theta) <= MOST_PARAMETERS:
        active = [white.jacobian[own] for own in mine.values()]
    levels = _levels(estimate, mine)
    ends = np.cumsum([len(r) for r in residuals])[:-1]
    free = np.split(np.hstack([np.vstack(active), block_diag(*levels)]), ends)
    found = wander_of(waves, residuals, free, flickers=flickers)
    if found is None:
        return None
    evidence, beside_levels = found.gain - float(np.log(sum(map(len, residuals)))), _Beside(free, residuals)
    smooth, swing = _smoothest([rows.constants.time[white.entry[own]] for own in mine.values()], beside_levels)
    if evidence < smooth:
        return None
    if rows.kind.points:
        both = np.split(np.hstack([np.vstack(free), block_diag(*swing)]), ends)  # each channel swings by itself
        apart = wander_of(waves, residuals, both, flickers=flickers)
        if apart is not None and _stands_out(swing, free, residuals, [w.filter(apart.level) for w in waves]):
            return apart.level
    if not estimate.problem.kind.points:
        evidence += max(_Beside(active, residuals).evidence(levels), 0.0)
    if evidence < max((_evidence_of(group, mine) for group in beside), default=0.0):
        room, count = int(LARGEST_SHARE_OF_COLUMNS * max(map(len, residuals))), len(white.residual)
        extra = [np.zeros((count, 0))]
        for s in (s for group in beside for s in group):
            if s.candidate.columns.width <= room:
                extra.append(s.candidate.columns.dense(count))
                room -= s.candidate.columns.width
        columns = [np.hstack([a, *(e[own] for e in extra)]) for a, own in zip(free, mine.values(), strict=True)]
        found = wander_of(waves, residuals, columns, flickers=flickers)
    return None if found is None else found.level


def _levels(estimate: Estimate, mine: Mapping[int, slice]) -> list[Array]:
    """A constant error of each motor's readings ``(k, 1)``; of poses none: a shift of the base is fitted."""
    rows = estimate.problem.rows
    if rows.kind.points:
        return [np.zeros((own.stop - own.start, 0)) for own in mine.values()]
    return [estimate.noise.shown_level(rows, channel)[:, None] for channel in mine]


def _smoothest(times: Sequence[Array], beside: _Beside) -> tuple[float, list[Array]]:
    """The evidence of the likeliest smooth function of the time of measurement, and the likeliest swing of one period.

    Smooth are slow cosines, and swings. A period is that of all channels, and the columns are ``(k, c)`` for each.
    ``times``: of each channel's numbers ``(k,)``.
    """
    first, last = min(t.min() for t in times), max(t.max() for t in times)
    turns = [np.pi * (t - first)[:, None] / max(last - first, 1e-12) for t in times]  # of half a wave

    def swing_of(waves: float) -> list[Array]:
        return [np.c_[np.cos(turn * waves), np.sin(turn * waves)] for turn in turns]

    found = {float(waves): beside.evidence(swing_of(waves)) for waves in np.arange(1.0, COSINES + 0.01, PERIOD_STEP)}
    for step in (PERIOD_STEP / 2.0, PERIOD_STEP / 4.0):  # between two periods tried, a twentieth of a swing is missed
        best = max(found, key=lambda waves: found[waves])
        found |= {waves: beside.evidence(swing_of(waves)) for waves in (best - step, best + step)}
    best = max(found, key=lambda waves: found[waves])
    cosines = beside.evidence([np.cos(turn * np.arange(1, COSINES + 1)) for turn in turns])
    return max(found[best], cosines), swing_of(best)


def _stands_out(
    swing: Sequence[Array], free: Sequence[Array], residuals: Sequence[Array], filters: Sequence[Filter]
) -> bool:
    """Whether a swing is likelier than none beside columns and a level that wanders."""
    still = [[f(columns) for f, columns in zip(filters, part, strict=True)] for part in (free, swing)]
    without = [f(r[:, None])[:, 0] for f, r in zip(filters, residuals, strict=True)]
    return _Beside(still[0], without).evidence(still[1]) > 0.0


class _Beside:
    """The evidence of columns on the residuals of some channels, beside other columns."""

    def __init__(self, active: Sequence[Array], residuals: Sequence[Array]) -> None:
        """``active``: for each channel the other columns ``(k, p)``; ``residuals``: ``(k,)`` each."""
        self._basis = np.asarray(np.linalg.qr(np.vstack(active))[0])
        self._residual = self._without(np.concatenate(residuals)[:, None])[:, 0]

    def evidence(self, columns: Sequence[Array]) -> float:
        """Twice the gain of the log likelihood by columns ``(k, c)`` of each channel, less their cost.

        By the first columns of each channel, as many as give the most.
        """
        channels, each = len(columns), columns[0].shape[1]
        in_turn = np.arange(channels * each).reshape(channels, each).T.ravel()
        directions, _ = np.linalg.qr(self._without(block_diag(*columns)[:, in_turn]))
        squares = float(self._residual @ self._residual)
        explained = np.cumsum((directions.T @ self._residual) ** 2)[channels - 1 :: channels]
        numbers, width = len(directions), channels * np.arange(1, len(explained) + 1)  # of few numbers fewer
        freedom = np.maximum(numbers - self._basis.shape[1] - width, 1)
        left = np.maximum(1.0 - explained / squares, 1e-12)
        return float(np.max(-freedom * np.log(left) - width * np.log(numbers)))

    def _without(self, columns: Array) -> Array:
        return np.asarray(columns - self._basis @ (self._basis.T @ columns))


def _evidence_of(group: Sequence[Scored], mine: Mapping[int, slice]) -> float:
    """The same of candidates that explain different readings, together."""
    numbers = sum(own.stop - own.start for own in mine.values())
    explained = sum(s.explained for s in group)  # in units of the variance before
    left = max(1.0 - explained / numbers, 1.0 / numbers)
    return float(-numbers * np.log(left)) - sum(s.cost for s in group)
