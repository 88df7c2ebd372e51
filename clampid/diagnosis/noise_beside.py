"""The noise of a log, learned from what is left beside the candidates that stand out.

The noise of a torque log is learned from what a fit leaves. This contains what the model lacks. If that is slow, the
noise looks correlated for long, and the filter that whitens it removes the missing effect as well. In one log of our
second virtual world, a cable that drags with 0.6 times the noise kept 2 % of its squares. So once names or probes are
significant, the noise is learned again, from what a fit with all of these leaves, and the probes are judged by it; and
names, if none was found. If nothing is significant, the noise stays as it was, and with it the rate of false alarms.

A constant error is as slow as can be: an offset of one standard deviation is half of the noise, at any lag. One that
follows a temperature is nearly as slow. So before anything is scored, the noise of each motor that shows such a level
is learned about it.

Signs are flipped in blocks that are longer than the noise's memory. So the significance of a candidate does not depend
on the filter being right; its power does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import linalg, stats
from scipy.linalg import block_diag

from clampid.diagnosis.probes import probes
from clampid.diagnosis.wandering import whitened_by
from clampid.evidence.candidates import Candidate, columns_of
from clampid.evidence.columns import channel_starts
from clampid.evidence.score import Scored
from clampid.evidence.space import Space, space_of
from clampid.fitting.equal_weights import uncorrelated
from clampid.fitting.noise import groups_of
from clampid.fitting.solve import Estimate
from clampid.stages.prewhitening import autocorrelation, lag_products
from clampid.stages.rows import Array, Rows
from clampid.stages.temperatures import shared_temperatures

__all__ = ["with_equal_weights", "with_noise_about_its_level", "with_noise_beside"]

LEVEL_FALSE_ALARMS = 0.01  # probability that the level of any motor is taken into account where there is none


def with_noise_beside(estimate: Estimate, beside: Sequence[Scored]) -> Estimate | None:
    """The estimate of a log, whitened by the noise that is left beside some candidates; None if that is as before.

    Parameters
    ----------
    beside
        Names and probes that stand out. All of their amplitudes are fitted, with all parameters of the estimate.
    """
    noise, rows = estimate.noise, estimate.problem.rows
    if not rows.kind.moving or not noise.autocorrelations or not beside:
        return None
    plain = with_equal_weights(estimate)
    return _whitened_beside(estimate, space_of(plain), _columns(plain, [s.candidate for s in beside]))


def with_noise_about_its_level(estimate: Estimate) -> Estimate | None:
    """The estimate of a log, whitened by the noise that motors have about their level; None if that is as before.

    A constant error correlates a motor's residual at all lags, and one that follows a temperature at nearly all. An
    autoregression takes it for noise that lasts, and its filter removes nearly all of the error. So the noise of a
    motor is learned again about a constant and the recorded temperatures, if by this noise these explain a part of it.
    """
    rows, noise = estimate.problem.rows, estimate.noise
    if not rows.kind.moving or not noise.autocorrelations:
        return None
    space, white = space_of(with_equal_weights(estimate)), estimate.whitened
    starts = channel_starts(white)
    motors = [int(white.channel[start]) for start, _ in starts]
    levels = [_levels(rows, motor) for motor in motors]
    columns = [level[white.entry[start:stop]] for level, (start, stop) in zip(levels, starts, strict=True)]
    about = _whitened_beside(estimate, space, block_diag(*columns))
    if about is None:
        return None
    chance = LEVEL_FALSE_ALARMS / len(starts)
    for k, (start, stop) in enumerate(starts):
        motor = motors[k]
        shown = about.noise.whiten_channel(rows, motor, about.noise.sigma[:, motor, None] * levels[k])
        directions = linalg.orth(shown)
        squares = float(np.sum((directions.T @ about.whitened.residual[start:stop]) ** 2))
        if squares <= stats.chi2.isf(chance, directions.shape[1]):
            columns[k] = np.zeros_like(columns[k])
    return _whitened_beside(estimate, space, block_diag(*columns)) if any(map(np.any, columns)) else None


def _levels(rows: Rows, motor: int) -> Array:
    """What a motor's level may follow ``(N, k)``: a constant, and temperatures about their mean, of unit size."""
    warm = [rows.signals["motor_temperature"][:, motor], *shared_temperatures(rows).values()]
    about = [w - w.mean() for w in warm]
    return np.column_stack([np.ones(len(rows)), *(w / w.std() for w in about if w.std() > 0.0)])


def _whitened_beside(estimate: Estimate, plain: Space, columns: Array) -> Estimate | None:
    """The estimate, whitened by the noise left beside columns ``(M, k)``; None if that is as before.

    ``plain``: its residual with equal weights, by which the columns are whitened. A motor of which all columns are zero
    keeps its noise.
    """
    noise, rows, white = estimate.noise, estimate.problem.rows, estimate.whitened
    left = plain.granting(columns).residual
    sigma, found, counts = noise.sigma.copy(), list(noise.autocorrelations), list(noise.counts)
    for start, stop in channel_starts(white):
        c = int(white.channel[start])
        if not np.any(columns[start:stop]):
            continue
        groups = groups_of(rows, np.flatnonzero(rows.used[:, c]), noise.together)
        products, pairs = lag_products(left[start:stop], groups.row, groups.stretch)
        sigma[:, c] *= max(float(np.sqrt(products[0] / max(pairs[0], 1.0))), 1e-12)
        found[c], counts[c] = autocorrelation(products, pairs), float(pairs[0])
    again = replace(noise, sigma=sigma, autocorrelations=tuple(found), counts=tuple(counts))
    return None if noise.settled(again) else whitened_by(estimate, again)


def with_equal_weights(estimate: Estimate) -> Estimate:
    """The same estimate, all rows of a motor with equal weights."""
    noise = estimate.noise
    return whitened_by(estimate, replace(noise, autocorrelations=uncorrelated(len(noise.autocorrelations)), level=None))


def _columns(plain: Estimate, candidates: Sequence[Candidate]) -> Array:
    """Columns ``(M, k)`` of candidates, probes among them, whitened as those of the estimate are."""
    free = {p.label: p for p in probes(plain)}
    own = [free[c.label].columns.dense(len(plain.whitened.residual)) for c in candidates if not c.terms]
    return np.hstack([columns_of(plain, [c for c in candidates if c.terms]), *own])
