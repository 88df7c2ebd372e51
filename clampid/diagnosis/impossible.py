"""Values that no robot has: what a fit puts clearly beyond its physical bounds shows that the model is wrong."""

from __future__ import annotations

import numpy as np

from clampid.fitting.solve import Estimate
from clampid.slots import Slot

__all__ = ["SURE", "impossible_values"]

SURE = 4.0  # standard errors by which it must be clear that a value is impossible


def impossible_values(estimate: Estimate) -> frozenset[Slot]:
    """The parameters whose values are clearly beyond their bounds, such as a spring of negative stiffness.

    Amplitudes may leave their bounds in a fit (:meth:`clampid.stages.fit_problem.FitProblem.bounded`).
    """
    count = len(estimate.slots)
    lower, upper = (b[:count] for b in estimate.problem.bounds())
    value, variance = estimate.theta[:count], np.diag(estimate.covariance)[:count]
    beyond = np.maximum(lower - value, value - upper) > SURE * np.sqrt(np.maximum(variance, 0.0))
    found = np.flatnonzero(beyond & ~estimate.problem.fixed()[:count])
    return frozenset(estimate.slots[k] for k in found)
