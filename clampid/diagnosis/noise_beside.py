"""The noise of a log, learned from what is left beside the candidates that stand out.

The noise of a torque log is learned from what a fit leaves. This contains what the model lacks. If that is slow, the
noise looks correlated for long, and the filter that whitens it removes the missing effect as well. In one log of our
second virtual world, a cable that drags with 0.6 times the noise kept 2 % of its squares. So once names or probes are
significant, the noise is learned again, from what a fit with all of these leaves, and the probes are judged by it. If
nothing is significant, the noise stays as it was, and with it the rate of false alarms.

Signs are flipped in blocks that are longer than the noise's memory. So the significance of a candidate does not depend
on the filter being right; its power does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import stats

from clampid.diagnosis.probes import probes
from clampid.diagnosis.wandering import whitened_by
from clampid.evidence.candidates import Candidate, columns_of
from clampid.evidence.columns import channel_starts
from clampid.evidence.score import Scored
from clampid.evidence.space import space_of
from clampid.fitting.equal_weights import uncorrelated
from clampid.fitting.noise import Whitened, groups_of
from clampid.fitting.solve import Estimate
from clampid.fitting.wander import WANDER_FALSE_ALARMS, course_of, wander_of
from clampid.stages.prewhitening import autocorrelation, lag_products
from clampid.stages.rows import Array

__all__ = ["level_changes", "with_equal_weights", "with_noise_beside", "with_noise_beside_levels"]


LARGEST_SHARE = 0.2  # of a motor's numbers, that may be columns beside which its level changes


def with_noise_beside(estimate: Estimate, beside: Sequence[Scored]) -> Estimate | None:
    """The estimate of a log, whitened by the noise that is left beside some candidates; None if that is as before.

    Parameters
    ----------
    beside
        Names and probes that stand out. All of their amplitudes are fitted, with all parameters of the estimate.
    """
    if not estimate.problem.rows.kind.moving or not estimate.noise.autocorrelations or not beside:
        return None
    plain = with_equal_weights(estimate)
    return _beside(estimate, plain, _columns(plain, [s.candidate for s in beside]))


def with_noise_beside_levels(estimate: Estimate) -> Estimate | None:
    """The estimate of a log, whitened by the noise that is left beside constant errors of its motors, if there are any.

    A constant error correlates a motor's residual at all lags. An autoregression takes that for noise, and its filter
    removes nearly all of the error, which no candidate explains then. None if the noise is as before, or if no constant
    is significant.
    """
    rows, noise = estimate.problem.rows, estimate.noise
    if not rows.kind.moving or not noise.autocorrelations:
        return None
    limit = _limit(estimate)
    mean = np.sum(np.where(rows.used, estimate.residual / noise.sigma, 0.0), axis=0)
    if np.all(np.abs(mean) <= limit * np.sqrt(rows.used.sum(axis=0))):
        return None  # not even by white noise
    plain = with_equal_weights(estimate)
    again = _beside(estimate, plain, _levels(plain.whitened))
    return again if again is not None and max(_level_errors(again)) > limit else None


def level_changes(estimate: Estimate, beside: Sequence[Scored]) -> bool:
    """Whether the level of any motor with a constant error is seen to change beside it and some candidates.

    If not, what its readings have in common over the whole log is an error, not noise.
    """
    rows, white = estimate.problem.rows, estimate.whitened
    starts = channel_starts(white)
    for (start, stop), error in zip(starts, _level_errors(estimate), strict=True):
        if error <= _limit(estimate):
            continue
        shown, room = estimate.noise.shown_level(rows, int(white.channel[start])), LARGEST_SHARE * (stop - start)
        columns = [shown[:, None]]
        for s in beside:
            own = s.candidate.columns.dense(len(white.residual))[start:stop]
            own = own[:, np.any(own != 0.0, axis=0)]
            if own.shape[1] <= room:
                columns.append(own)
                room -= own.shape[1]
        course = course_of(rows, white.entry[start:stop], shown)
        if wander_of([course], [white.residual[start:stop]], [np.hstack(columns)]).variance:
            return True
    return False


def _limit(estimate: Estimate) -> float:
    """From how many standard errors on a constant error of any motor is significant."""
    return float(stats.norm.isf(WANDER_FALSE_ALARMS / (2 * estimate.noise.sigma.shape[1])))


def _level_errors(estimate: Estimate) -> list[float]:
    """The constant error of each motor's readings, in standard errors, not negative."""
    white, out = estimate.whitened, []
    for start, stop in channel_starts(white):
        shown = estimate.noise.shown_level(estimate.problem.rows, int(white.channel[start]))
        out.append(abs(float(shown @ white.residual[start:stop])) / max(float(np.linalg.norm(shown)), 1e-300))
    return out


def _levels(white: Whitened) -> Array:
    """A column for each channel ``(M, k)``, one in its own entries."""
    starts = channel_starts(white)
    out = np.zeros((len(white.residual), len(starts)))
    for k, (start, stop) in enumerate(starts):
        out[start:stop, k] = 1.0
    return out


def _beside(estimate: Estimate, plain: Estimate, columns: Array) -> Estimate | None:
    """The estimate, whitened by the noise left in the ``plain`` one beside columns ``(M, k)``; None: as before."""
    noise, rows, white = estimate.noise, estimate.problem.rows, plain.whitened
    left = space_of(plain).granting(columns).residual
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
    return whitened_by(estimate, replace(noise, autocorrelations=uncorrelated(len(noise.autocorrelations)), wander=()))


def _columns(plain: Estimate, candidates: Sequence[Candidate]) -> Array:
    """Columns ``(M, k)`` of candidates, probes among them, whitened as those of the estimate are."""
    free = {p.label: p for p in probes(plain)}
    own = [free[c.label].columns.dense(len(plain.whitened.residual)) for c in candidates if not c.terms]
    return np.hstack([columns_of(plain, [c for c in candidates if c.terms]), *own])
