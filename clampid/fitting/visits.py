"""What a pose fit's visits share: where the robot has stopped is the same for all numbers of one visit.

The moments of such numbers are those of :mod:`clampid.fitting.repeatability`; here they are a fit's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clampid.fitting.descent import inverse_of
from clampid.fitting.noise import Whitened
from clampid.fitting.repeatability import clustered_covariance, shared_moments, visit_scatter
from clampid.fitting.solve import Estimate, StagePoint
from clampid.stages.rows import Array, Integers

__all__ = ["gradient_covariance", "variance_along", "with_repeatability"]


def with_repeatability(estimate: Estimate) -> Estimate:
    """The same fit, its covariance that of visits whose numbers share where the robot has stopped."""
    white = estimate.whitened
    by_joint, visit = _by_joint(estimate, white, estimate.theta)
    inverse = inverse_of(white.normal + estimate.prior_precision)
    scatter = visit_scatter(white, by_joint, visit, inverse)
    if scatter is None:
        return estimate
    return replace(
        estimate,
        covariance=clustered_covariance(white, by_joint, visit, estimate.prior_precision, scatter, inverse),
        scatter=scatter,
    )


def gradient_covariance(estimate: Estimate, point: StagePoint) -> Array:
    """Covariance ``(P + K, P + K)`` of the gradient of a pose fit whose visits share where the robot has stopped.

    Parameters
    ----------
    estimate
        A pose fit with a ``scatter``.
    point
        Where the gradient is taken, with the same rows and noise.
    """
    if estimate.scatter is None:
        raise ValueError("expected a fit of poses that separates measurement from repeatability, found none")
    white = point.white
    by_joint, visit = _by_joint(estimate, white, point.theta)
    return shared_moments(white, by_joint, visit, estimate.scatter)


def variance_along(estimate: Estimate, chosen: Integers) -> float:
    """Variance of the whitened numbers of a pose fit along some parameters, what visits share included."""
    white = estimate.whitened
    if estimate.scatter is None:
        return float(white.residual @ white.residual / max(len(white.residual) - white.jacobian.shape[1], 1))
    moments = gradient_covariance(estimate, estimate.point)
    squares = np.sum(white.jacobian[:, chosen] ** 2)
    return float(np.trace(moments[np.ix_(chosen, chosen)]) / squares)


def _by_joint(estimate: Estimate, white: Whitened, theta: Array) -> tuple[Array, Integers]:
    """What a joint's stop does to each whitened number ``(M, n)``, and the visit ``(M,)`` that each is of."""
    rows = estimate.problem.rows
    by_joint = rows.in_noise_axes(estimate.problem.by_joint(theta))[white.entry, white.channel]
    return by_joint / estimate.noise.sigma[white.entry, white.channel, None], rows.unit[white.entry]
