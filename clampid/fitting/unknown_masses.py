"""Standard errors that include unknown masses: they widen those of springs that the arm's weight winds up.

If neither the description nor a torque log gives the masses of the links, loads are those of a usual arm. Poses do not
reduce the uncertainty of these loads: a spring twice as soft under half the weight gives the same poses. Source:
parameters that are considered but not estimated, as in Schmidt's filter (Schmidt, Advances in Control Systems 3, 1966).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clampid.fitting.descent import inverse_of
from clampid.fitting.further_columns import whitened_columns
from clampid.fitting.priors import description_priors
from clampid.fitting.solve import Estimate
from clampid.roles import WEIGHTS

__all__ = ["with_unknown_masses"]


def with_unknown_masses(estimate: Estimate) -> Estimate:
    """The pose fit with the uncertainty of unknown masses in its covariance; unchanged if they are known or fitted."""
    rows = estimate.problem.rows
    if not rows.kind.points or rows.robot.has_masses or estimate.problem.numbers_of(*WEIGHTS, per="link"):
        return estimate
    (masses,) = description_priors(rows)
    columns = whitened_columns(estimate, masses.slots, masses.mean).jacobian
    if not np.any(columns):
        return estimate
    # Derivative of the fitted parameters by masses and first moments, per kg and kg m.
    normal = estimate.point.matrix + estimate.prior_precision
    slope = inverse_of(normal) @ (estimate.whitened.jacobian.T @ columns)
    return replace(estimate, covariance=estimate.covariance + slope @ masses.covariance @ slope.T)
