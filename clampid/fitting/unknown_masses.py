"""The uncertainty of an arm's masses is part of the errors of springs that its weight winds up.

Where neither the description nor a torque log says what the links weigh, loads are those of a usual arm, and how far
they may be from it is uncertainty that no pose takes away: a spring twice as soft under half the weight is the same.
Source: parameters that are considered but not estimated, as in Schmidt's filter (Schmidt, Advances in Control Systems
3, 1966).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clampid.fitting.descent import inverse_of
from clampid.fitting.priors import description_priors
from clampid.fitting.solve import Estimate, whitened_columns
from clampid.roles import WEIGHTS

__all__ = ["with_unknown_masses"]


def with_unknown_masses(estimate: Estimate) -> Estimate:
    """The same fit, with what the links may weigh in its covariance; unchanged where they are described or fitted."""
    rows = estimate.problem.rows
    if not rows.kind.points or rows.robot.has_masses or estimate.problem.numbers_of(*WEIGHTS, per="link"):
        return estimate
    (masses,) = description_priors(rows)
    columns = whitened_columns(estimate, masses.slots, masses.mean).jacobian
    if not np.any(columns):
        return estimate
    # How the fitted parameters follow the masses, kg and kg m.
    normal = estimate.point.matrix + estimate.prior_precision
    slope = inverse_of(normal) @ (estimate.whitened.jacobian.T @ columns)
    return replace(estimate, covariance=estimate.covariance + slope @ masses.covariance @ slope.T)
