"""Initial values of the joints' dry friction in a pose fit, chosen among the flanks that different values give.

After a stop, friction F and load determine the flank on which a joint rests: s = sign(load + F dir). A fit keeps the
flanks frozen while it searches. Rows with a wrong initial flank pull F to a value with the same wrong flank: each such
fixed point is a local minimum. Therefore a few frictions between zero and the joint's largest load are tried at each
joint with unknown friction, each with its own flanks. The best one is the initial value.

This is for poses without torque logs, whose loads come from the description only. If logs determine the loads,
:mod:`clampid.fitting.rest_friction` estimates friction from the flanks separately, and fixes it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from clampid.fitting.descent import Limits, newton_step
from clampid.fitting.noise import initial_noise
from clampid.fitting.prior_and_start import prior_of, start_of
from clampid.fitting.solve import Estimate, limits_of, solve, stage_point
from clampid.slots import Prior, Slot
from clampid.stages import poses
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array

__all__ = ["with_friction_start"]

SHARES_OF_ROWS = (0.05, 0.2, 0.4, 0.6, 0.8, 0.95)  # quantiles of a joint's loads over the rows: the frictions tried
START_PASSES = 2


def with_friction_start(
    problem: FitProblem, priors: Sequence[Prior], start: Mapping[Slot, float]
) -> Mapping[Slot, float]:
    """Initial values of all slots, SI, for a fit in which only the poses identify a friction.

    Parameters
    ----------
    problem
        Rows of poses, and slots.
    priors
        Results of other stages; frictions that they determine are not varied.
    start
        Initial values so far; frictions among them are not varied.

    Raises
    ------
    clampid.fitting.solve.FitError
        The model gives no finite prediction.
    """
    known = {*start, *(slot for prior in priors for slot in prior.slots)}
    open_ = [k for k in problem.numbers_of("arm_friction") if problem.slots[k] not in known]
    reads = problem.kind.points and problem.chain.reads_flanks
    if not open_ or not reads or not problem.rows.used.any():
        return start
    precision, mean = prior_of(problem, priors)
    theta = start_of(problem, start, priors)
    mean = np.where(problem.centred(), theta, mean)
    best = solve(problem, theta, initial_noise(problem.rows), precision, mean)
    for _ in range(START_PASSES):
        before = best.cost
        for k in open_:
            best = _past_flips(best, k)
        if best.cost >= before:
            break
    return best.values()


def _past_flips(estimate: Estimate, friction: int) -> Estimate:
    """The estimate, or a better one from another initial value of one joint's friction (slot number ``friction``)."""
    problem, limits = estimate.problem, limits_of(estimate.problem)
    joint = problem.slots[friction].number
    none = estimate.theta.copy()
    none[friction] = 0.0
    pressing = poses.pressing(problem.rows, problem.chain, none)
    if pressing is None:
        return estimate
    seen = [_flanks(problem, estimate.theta)]
    best, reached = None, estimate.cost
    for value in np.quantile(np.abs(pressing[:, joint]), SHARES_OF_ROWS):
        theta = none.copy()
        theta[friction] = value
        flanks = _flanks(problem, theta)
        if any(np.array_equal(flanks, other) for other in seen):
            continue
        seen.append(flanks)
        there, cost = _step(estimate, theta, limits)
        if cost < reached:
            best, reached = there, cost
    if best is None:
        return estimate
    found = solve(problem, best, estimate.noise, estimate.prior_precision, estimate.prior_mean)
    return found if found.cost < estimate.cost else estimate


def _flanks(problem: FitProblem, theta: Array) -> Array:
    """The flanks at parameters ``theta``; empty if the model has no clearances that follow them."""
    found = poses.flanks(problem.rows, problem.chain, theta)
    return np.zeros(0) if found is None else found


def _step(estimate: Estimate, theta: Array, limits: Limits) -> tuple[Array, float]:
    """One Gauss-Newton step from ``theta`` with its flanks frozen: the new parameters, and the predicted cost."""
    point = stage_point(estimate.problem.with_flanks(theta), estimate.noise, theta)
    A, g = point.normal()
    off = theta - estimate.prior_mean
    A, g = A + estimate.prior_precision, g - estimate.prior_precision @ off
    step = newton_step(A, g, limits.size, 0.0, np.ones(len(theta), dtype=bool))
    cost = point.cost + float(off @ estimate.prior_precision @ off)
    return theta + step, cost - float(g @ step)
