"""The noise of a log, learned from what is left beside the candidates that stand out.

The noise of a torque log is learned from what a fit leaves. This contains what the model lacks. If that is slow, the
noise looks correlated for long, and the filter that whitens it removes the missing effect as well. In one log of our
second virtual world, a cable that drags with 0.55 times the noise kept 2 % of its squares. So once names or probes are
significant, the noise is learned again, from what a fit with all of these leaves, and the probes are judged by it. If
nothing is significant, the noise stays as it was, and with it the rate of false alarms.

Signs are flipped in blocks that are longer than the noise's memory. So the significance of a candidate does not depend
on the filter being right; its power does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from clampid.diagnosis.probes import probes
from clampid.diagnosis.wandering import whitened_by
from clampid.evidence.candidates import Candidate
from clampid.evidence.columns import channel_starts
from clampid.evidence.score import Scored
from clampid.fitting.equal_weights import uncorrelated
from clampid.fitting.noise import Noise, groups_of
from clampid.fitting.solve import Estimate
from clampid.stages.prewhitening import autocorrelation, lag_products
from clampid.stages.rows import Array

__all__ = ["with_equal_weights", "with_noise_beside"]


def with_noise_beside(estimate: Estimate, beside: Sequence[Scored]) -> Estimate | None:
    """The estimate of a log, whitened by the noise that is left beside some candidates; None if that is as before.

    Parameters
    ----------
    beside
        Names and probes that stand out. All of their amplitudes are fitted, with all parameters of the estimate.
    """
    noise, rows = estimate.noise, estimate.problem.rows
    if not noise.autocorrelations or not beside:
        return None
    plain = with_equal_weights(estimate)
    white = plain.whitened
    free = {p.name: p for p in probes(plain)}
    columns = np.hstack([_columns(plain, s, free) for s in beside])
    left = _left(plain, columns)
    sigma, found, counts = noise.sigma.copy(), list(noise.autocorrelations), list(noise.counts)
    for start, stop in channel_starts(white):
        c = int(white.channel[start])
        if not np.any(columns[start:stop]):
            continue
        groups = groups_of(rows, np.flatnonzero(rows.used[:, c]), noise.together)
        products, pairs = lag_products(left[start:stop], groups.row, groups.stretch)
        sigma[:, c] *= max(float(np.sqrt(products[0] / max(pairs[0], 1.0))), 1e-12)
        found[c], counts[c] = autocorrelation(products, pairs), float(pairs[0])
    again = Noise(sigma, tuple(found), noise.together, tuple(counts), noise.wander)
    return None if noise.settled(again) else whitened_by(estimate, again)


def with_equal_weights(estimate: Estimate) -> Estimate:
    """The same estimate, all rows of a motor with equal weights."""
    noise = estimate.noise
    return whitened_by(estimate, replace(noise, autocorrelations=uncorrelated(len(noise.autocorrelations)), wander=()))


def _columns(plain: Estimate, s: Scored, free: Mapping[str, Candidate]) -> Array:
    """Columns ``(M, k)`` of a candidate, whitened as those of the estimate are; ``free``: its probes by name."""
    c, white = s.candidate, plain.whitened
    if not c.terms:
        return free[c.name].columns.dense(len(white.residual))
    shapes = {slot: value for slot, value in c.shapes.items() if slot not in plain.slots}
    problem = plain.problem.with_slots((*plain.slots, *c.slots, *shapes))
    count, whole = len(plain.slots), len(plain.slots) + len(c.slots) + len(shapes)
    theta = np.zeros(len(plain.theta) + whole - count)
    theta[:count], theta[whole:] = plain.theta[:count], plain.theta[count:]
    theta[count + len(c.slots) : whole] = list(shapes.values())
    residual, jacobian = problem.residual(theta)
    return plain.noise.whiten(plain.problem.rows, residual, jacobian[:, :, count : count + len(c.slots)]).jacobian


def _left(plain: Estimate, columns: Array) -> Array:
    """What a fit of all parameters and further columns ``(M, k)`` leaves of a residual ``(M,)``."""
    white, count = plain.whitened, len(plain.theta)
    whole = np.c_[white.jacobian, columns]
    normal = whole.T @ whole
    normal[:count, :count] += plain.prior_precision
    moment = whole.T @ white.residual
    moment[:count] += plain.prior_precision @ (plain.prior_mean - plain.theta)
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    step = np.linalg.lstsq(normal / np.outer(size, size), moment / size, rcond=1e-12)[0] / size
    return np.asarray(white.residual - whole @ step)
