"""Covariances of a pose fit with the robot's repeatability: all numbers of one visit share the robot's stopping error.

The variance components are those of :mod:`clampid.fitting.repeatability`; here they are applied to an estimate.
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
    """The pose fit with a covariance that includes the robot's repeatability; unchanged if too few visits show it."""
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
    """Covariance ``(P + K, P + K)`` of the cost's gradient, with the robot's repeatability.

    Parameters
    ----------
    estimate
        A pose fit with a ``scatter``.
    point
        The point at which the gradient is taken, with the same rows and noise.

    Raises
    ------
    ValueError
        The fit has no ``scatter``.
    """
    if estimate.scatter is None:
        raise ValueError("expected a pose fit with its scatter of measurement and repeatability, found none")
    white = point.white
    by_joint, visit = _by_joint(estimate, white, point.theta)
    return shared_moments(white, by_joint, visit, estimate.scatter)


def variance_along(estimate: Estimate, chosen: Integers) -> float:
    """Variance of the whitened numbers along the columns of parameters ``chosen``, with the robot's repeatability."""
    white = estimate.whitened
    if estimate.scatter is None:
        return float(white.residual @ white.residual / max(len(white.residual) - white.jacobian.shape[1], 1))
    moments = gradient_covariance(estimate, estimate.point)
    squares = np.sum(white.jacobian[:, chosen] ** 2)
    return float(np.trace(moments[np.ix_(chosen, chosen)]) / squares)


def _by_joint(estimate: Estimate, white: Whitened, theta: Array) -> tuple[Array, Integers]:
    """Derivative of each whitened number by the joints ``(M, n)``, 1/rad, and its visit ``(M,)``."""
    rows = estimate.problem.rows
    by_joint = rows.in_noise_axes(estimate.problem.by_joint(theta))[white.entry, white.channel]
    return by_joint / estimate.noise.sigma[white.entry, white.channel, None], rows.unit[white.entry]
