"""The prior and the initial values of a fit: from earlier stages, from given values, else from the problem itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from clampid.fitting.descent import inverse_of
from clampid.slots import Prior, Slot
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array, Integers

__all__ = ["clamping_offsets", "precision_with_fixed", "prior_of", "start_of"]


def prior_of(problem: FitProblem, priors: Sequence[Prior]) -> tuple[Array, Array]:
    """Precision ``(P + K, P + K)`` and mean ``(P + K,)`` of the prior, SI.

    A parameter has the prior from an earlier stage if there is one in ``priors``, else its own.
    """
    precision, mean = problem.prior()
    index = {slot: k for k, slot in enumerate(problem.slots)}
    following: list[tuple[list[int], list[int], Array]] = []
    for prior in priors:
        shared = [k for k, slot in enumerate(prior.slots) if slot in index]
        where = [index[prior.slots[k]] for k in shared]
        if where:
            precision[np.ix_(where, where)] = inverse_of(prior.covariance[np.ix_(shared, shared)])
            mean[where] = prior.mean[shared]
        others = [k for k, slot in enumerate(prior.follows) if slot in index]
        if where and others and prior.slope is not None:
            slope = prior.slope[np.ix_(shared, others)]
            following.append((where, [index[prior.follows[k]] for k in others], slope))
    for where, others, slope in following:  # after all blocks are set: the parameters followed may have priors too
        own = precision[np.ix_(where, where)]
        precision[np.ix_(where, others)] -= own @ slope
        precision[np.ix_(others, where)] -= (own @ slope).T
        precision[np.ix_(others, others)] += slope.T @ own @ slope
        mean[where] += slope @ mean[others]
    return precision, mean


def precision_with_fixed(
    problem: FitProblem, precision: Array, chosen: Sequence[int] | Integers, within: float
) -> Array:
    """Precision ``(P + K, P + K)`` of a prior that also fixes the parameters with numbers ``chosen`` at its mean.

    ``within``: standard deviation that fixes them, in units of their reasonable sizes.
    """
    fixed = precision.copy()
    fixed[chosen, chosen] += 1.0 / (within * problem.sizes()[chosen]) ** 2
    return fixed


def start_of(problem: FitProblem, start: Mapping[Slot, float] | None, priors: Sequence[Prior]) -> Array:
    """Initial values of a fit ``(P + K,)``, SI: from ``start``, else from the priors' means, else from the problem."""
    theta = problem.start()
    known = {slot: float(v) for prior in priors for slot, v in zip(prior.slots, prior.mean, strict=True)}
    known |= dict(start or {})
    # Without a spring a drive would be infinitely stiff and its torque undefined. So springs start at the slopes of
    # the measured torque loops.
    for k, slot in enumerate(problem.slots):
        if slot in known:
            theta[k] = known[slot]
        elif problem.kind.solved and problem.parameters[k].role == "compliance":
            theta[k] = problem.rows.sweep.loop_compliance[slot.number]
    if problem.kind.solved:
        theta[len(problem.slots) :] = clamping_offsets(problem, theta)
    return theta


def clamping_offsets(problem: FitProblem, theta: Array) -> Array:
    """Initial constants ``(K,)`` of clamped sweeps: clamped angles, rad, and frictions of motors at rest, Nm.

    At these angles the equilibrium holds on average with the measured torques. The friction of a motor at rest is that
    of its last motion, or zero if that is not known. ``theta``: values whose first P are those of the slots.
    """
    rows, n = problem.rows, problem.rows.robot.n
    torque = rows.sweep.start_torque
    d = problem.chain.evaluate(theta[: len(problem.slots)], rows.signals, torque)
    wound = rows.sweep.wound + d.values[:, :n]
    run = rows.series.run
    keys, kept = rows.series.offset_keys, rows.sweep.kept_sign * rows.sweep.loop_friction
    return np.array([wound[run == s, j].mean() if j < n else kept[s, j - n] for s, j in keys])
