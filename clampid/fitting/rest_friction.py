"""Dry friction of joints from poses alone, by the flanks on which joints rest after a stop.

Friction F and load together select the flank, s = sign(load + F dir). F also winds up the joint's spring. A search with
frozen flanks sees only the spring's part and moves F accordingly. The flanks then differ from the frozen ones, and the
search need not converge. Such a friction is therefore fixed while everything else is searched, and is searched for
separately. Every value at which the flank of a further visit changes is tried. For each value, the clearance and all
other parameters are fitted to first order.

The cost of these fits over F is the friction's profile likelihood (:mod:`clampid.fitting.friction_profile`). It has
steps and may have several minima, so the normal equations do not give the standard error. The standard error is taken
from the distribution over F, together with the other parameters, which change with F. Their second moment about the
estimate is added to the covariance.

This needs known loads, from torque logs. Without them, :mod:`clampid.fitting.friction_start` only gives initial values.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from clampid.fitting.friction_profile import FrictionProfile
from clampid.fitting.noise import MAD_TO_STD, initial_noise
from clampid.fitting.prior_and_start import prior_of, start_of
from clampid.fitting.solve import Estimate, solve
from clampid.role_slots import has_role
from clampid.roles import WEIGHTS
from clampid.slots import Prior, Slot
from clampid.stages.fit_problem import FIXED_STD, FitProblem
from clampid.stages.pose_rows import REST_FRICTION
from clampid.stages.rows import Array

__all__ = ["RestFriction", "with_open_friction", "with_rest_friction"]

MAX_ROUNDS_OF_JOINTS = 6
LEAST_LOAD_RANGE = 0.1  # of the largest load: a load that varies less reverses all flanks at the same friction
SEAL_FRICTION, SEAL_RATED_TORQUE = 0.1, 100.0  # Nm: a lip seal on a shaft of 40 mm, of a joint with this rated torque
SEAL_SPREAD = 3.0  # in units of the seal's nominal friction: standard deviation of the friction of seals
LARGEST_NOISE_RATIO = 3.0  # of residual to noise, squared: a larger residual shows that the model lacks something
BETTER_COST = 0.1  # of chi-square: the least improvement for which a friction is changed


@dataclass(frozen=True)
class RestFriction:
    """Initial values of a pose fit, and the frictions that are fixed in it.

    Attributes
    ----------
    start
        Slot -> initial value, SI.
    fixed
        A narrow prior of the fixed frictions; None if none is fixed.
    """

    start: Mapping[Slot, float]
    fixed: Prior | None

    @property
    def priors(self) -> tuple[Prior, ...]:
        """The prior of the fixed frictions, as a fit takes it."""
        return () if self.fixed is None else (self.fixed,)


def with_rest_friction(
    problem: FitProblem,
    priors: Sequence[Prior],
    start: Mapping[Slot, float],
    *,
    before: Collection[Slot] | None = None,
    anew: bool = False,
) -> RestFriction:
    """Search for the frictions that select flanks and that only the poses identify.

    If ``start`` has values of the whole model, the frictions are fixed there. They are searched if ``anew`` is true, or
    if an effect has just been added: before, the flanks may have absorbed this effect. They are also searched if an
    earlier fit lacked a clearance: without one flanks do not matter, and friction was identified by the wind-up of the
    spring alone. No friction is fixed if the residual exceeds the noise: the flanks would absorb what the model lacks.

    Parameters
    ----------
    problem, priors
        The poses, and the priors from earlier stages.
    start
        Slot -> initial value, SI.
    before
        The slots of an earlier fit of these rows, if ``start`` has further ones.
    anew
        Whether frictions are searched even if ``start`` has all values.

    Raises
    ------
    clampid.fitting.solve.FitError
        The model gives no finite prediction.
    """
    open_ = _open(problem, priors)
    if not open_:
        return RestFriction(start, None)
    theta = start_of(problem, start, priors)
    fitted = set(start if before is None else before)
    clearances = [slot for slot in problem.slots if has_role(slot, "clearance", effects=problem.effects)]
    anew |= not fitted.issuperset(clearances)
    if not anew and all(slot in start for slot in problem.slots):
        free = _exceeds_noise(problem, problem.error(theta))
        return RestFriction(start, None if free else _fixed_prior(problem, open_, theta))
    estimate = _solved(problem, priors, open_, theta)
    for _ in range(MAX_ROUNDS_OF_JOINTS):
        last = estimate
        for k in open_:
            value = FrictionProfile.of(estimate, k).likeliest
            if value == estimate.theta[k]:
                continue
            at = estimate.theta.copy()
            at[k] = value
            found = _solved(problem, priors, open_, at)
            if _cost(found) < _cost(estimate) - BETTER_COST:
                estimate = found
        if estimate is last:
            break
    fixed = _fixed_prior(problem, open_, estimate.theta)
    return RestFriction(estimate.values(), None if _exceeds_noise(problem, estimate.residual) else fixed)


def _exceeds_noise(problem: FitProblem, residual: Array) -> bool:
    """Whether a residual ``(N, m)``, SI, exceeds the instrument's noise, by a scale that is robust to lost points."""
    white = (problem.rows.in_noise_axes(residual) / problem.rows.sigma)[problem.rows.used]
    return float(MAD_TO_STD * np.median(np.abs(white))) ** 2 > LARGEST_NOISE_RATIO


def with_open_friction(estimate: Estimate, fixed: Prior | None) -> Estimate:
    """The fit with the uncertainty of its fixed frictions, by their profile likelihood, added to the covariance."""
    if fixed is None:
        return estimate
    covariance = estimate.covariance.copy()
    for slot in fixed.slots:
        k = estimate.slots.index(slot)
        profile = FrictionProfile.of(estimate, k)
        off = profile.theta - estimate.theta
        covariance += (profile.weight * off.T) @ off
        # Flanks determine friction only relative to load and seals, so errors of these are errors of the friction. The
        # wound-up spring could separate them, but not if one visit in a hundred is assigned to the wrong flank.
        load = _load_variance(estimate, profile.joint) + _seals(estimate, profile.joint) ** 2
        covariance += load * np.outer(profile.slope, profile.slope)
    return replace(estimate, covariance=covariance)


def _open(problem: FitProblem, priors: Sequence[Prior]) -> list[int]:
    """Numbers of the frictions that select flanks and have no prior from an earlier stage.

    The load of their joint must vary: a constant load reverses all flanks at the same friction.
    """
    if not problem.kind.points or not problem.chain.reads_flanks or not problem.rows.used.any():
        return []
    known = {slot for prior in priors for slot in prior.slots}
    signals = problem.rows.signals
    contrary = signals["gravity_torque"] * signals["direction"] < 0.0
    load = np.where(contrary, np.abs(signals["gravity_torque"]) - np.abs(signals["rest_direction"]), 0.0)
    out = []
    play = {problem.slots[k].place for k in problem.numbers_of("clearance")}
    for k in problem.numbers_of("arm_friction"):
        slot = problem.slots[k]
        if slot in known or slot.place not in play:
            continue
        joint = slot.number
        turns = load[load[:, joint] > 0.0, joint]
        if len(turns) and np.ptp(turns) > LEAST_LOAD_RANGE * turns.max():
            out.append(k)
    return out


def _fixed_prior(problem: FitProblem, open_: Sequence[int], theta: Array) -> Prior:
    """A prior that fixes the parameters ``open_`` at their values in ``theta`` ``(P,)``."""
    tight = FIXED_STD * problem.sizes()[list(open_)]
    return Prior(tuple(problem.slots[k] for k in open_), theta[list(open_)], np.diag(tight**2))


def _solved(problem: FitProblem, priors: Sequence[Prior], open_: Sequence[int], theta: Array) -> Estimate:
    """The fit from ``theta`` ``(P,)`` with the parameters ``open_`` fixed there."""
    precision, mean = prior_of(problem, (*priors, _fixed_prior(problem, open_, theta)))
    mean = np.where(problem.centred(), theta, mean)
    return solve(problem, theta, initial_noise(problem.rows), precision, mean)


def _cost(estimate: Estimate) -> float:
    """Cost of rows and priors, with the frictions' own weak priors instead of those that fix them."""
    assumed, mean = estimate.problem.prior()
    frictions = estimate.problem.numbers_of("arm_friction")
    weak = sum(assumed[k, k] * (estimate.theta[k] - mean[k]) ** 2 for k in frictions)
    return estimate.cost + float(weak)


def _seals(estimate: Estimate, joint: int) -> float:
    """Standard deviation of the friction of a joint's seals about its nominal value, Nm.

    A lip seal's friction grows with the square of the shaft's diameter, the torque of the shaft with its third power.
    """
    rest = np.abs(estimate.problem.rows.signals["rest_direction"][:, joint]).max()
    return float(SEAL_SPREAD * SEAL_FRICTION * (rest / REST_FRICTION / SEAL_RATED_TORQUE) ** (2.0 / 3.0))


def _load_variance(estimate: Estimate, joint: int) -> float:
    """Mean variance of a joint's load, Nm², from the covariance of the masses in the fit; 0 if it has none."""
    masses = estimate.problem.numbers_of(*WEIGHTS, per="link")
    if not masses:
        return 0.0
    part = {"": 0, "x": 1, "y": 2, "z": 3}  # axis of a first moment; a mass has none
    at = [4 * estimate.slots[k].number + part[estimate.problem.parameters[k].axis] for k in masses]
    Y = estimate.problem.rows.signals["regressor"][:, joint][:, at]
    return float(np.mean(np.einsum("np,pq,nq->n", Y, estimate.covariance[np.ix_(masses, masses)], Y)))
