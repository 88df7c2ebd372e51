"""Values that no robot has: what a fit puts clearly beyond its physical bounds shows that the model is wrong."""

from __future__ import annotations

from clampid.fitting.solve import Estimate
from clampid.slots import Slot

__all__ = ["SURE", "impossible_values"]

SURE = 4.0  # standard errors by which it must be clear that a value is impossible


def impossible_values(estimate: Estimate) -> frozenset[Slot]:
    """The parameters whose values are clearly beyond their bounds, such as a spring of negative stiffness.

    Amplitudes may leave their bounds in a fit (:meth:`clampid.stages.fit_problem.FitProblem.bounded`).
    """
    beyond = estimate.beyond_bounds(SURE) & ~estimate.problem.fixed()
    return frozenset(slot for slot, found in zip(estimate.slots, beyond, strict=False) if found)
