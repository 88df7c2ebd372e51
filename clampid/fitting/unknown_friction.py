"""Joints' dry friction that a pose fit does not identify: it is set to zero, with the covariance at zero.

A joint's twist by its dry friction is the product c F of compliance and friction. If neither is known by itself and the
product is small, the fitted F is arbitrary. The linearised fit would then report c as known through F. Propagating an
unknown c at that F would report the product as unknown, although it is known. At F = 0 both are right.

F = 0 is taken if the rest of the model reproduces the rows as well. Otherwise only the covariance is that at F = 0.
Springs that the rows do not identify are fixed at their nominal stiffness. Otherwise F would look identified through a
spring that is soft by chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from clampid.fitting.many_amplitudes import has_many_amplitudes
from clampid.fitting.prior_and_start import precision_with_fixed
from clampid.fitting.solve import Estimate, Shared, point_at, solve
from clampid.stages.fit_problem import FIXED_STD
from clampid.stages.rows import Array

__all__ = ["at_no_friction", "unknown_frictions", "without_unknown_friction"]

CERTAIN_SPRING = 3.0  # standard errors from the prior mean: a spring this far off is not a chance result
CHANCE_GAIN = 1.0  # of chi-square for each parameter: the average gain from fitting a parameter that is zero


def unknown_frictions(estimate: Estimate) -> list[int]:
    """Numbers of the arm-side frictions that the rows of a fit do not identify.

    If the rows identify only the product of friction and compliance, a friction with no other information is as
    unknown as the spring.
    """
    springs = {estimate.slots[k].place for k in _unidentified_springs(estimate)}
    weak = np.sqrt(np.diag(estimate.prior_precision)) * estimate.problem.prior_std() < 1.0 + 1e-9
    frictions = estimate.problem.numbers_of("arm_friction")
    return [k for k in frictions if not estimate.identified[k] or (weak[k] and estimate.slots[k].place in springs)]


def without_unknown_friction(estimate: Estimate) -> Estimate:
    """The pose fit with frictions that the rows do not identify at zero, and with the covariance there."""
    found, removed, kept = estimate, list[int](), list[int]()
    unknown = unknown_frictions(estimate)
    none = None
    if len(unknown) > 1:  # mostly all of them are chance results: one search instead of one for each
        none = at_no_friction(estimate, unknown)
        if none.cost - estimate.cost < CHANCE_GAIN * len(_irrelevant(estimate, unknown)[0]):
            return none
    for k in unknown:
        known = none if len(removed) + 1 == len(unknown) else None  # the fit without any of them was searched above
        without = known or at_no_friction(found, [*removed, k])
        if without.cost - estimate.cost < CHANCE_GAIN * len(_irrelevant(found, [*removed, k])[0]):
            found, removed = without, [*removed, k]
        elif not estimate.identified[k]:
            kept.append(k)
    if not kept:
        return found
    theta = found.theta.copy()
    irrelevant, value = _irrelevant(found, kept)
    theta[irrelevant] = value
    # The flanks stay those of the fit.
    there = point_at(found.problem.with_flanks(found.theta), estimate.noise, theta)
    found = replace(found, whitened=found.whitened.with_jacobian_of(there.white))
    return replace(found, covariance=found.point.covariance(found.prior_precision))


def at_no_friction(estimate: Estimate, unknown: Sequence[int]) -> Estimate:
    """The fit with the frictions ``unknown`` (numbers) fixed at zero, and the covariance as if they were free there."""
    problem, precision, mean = estimate.problem, estimate.prior_precision, estimate.prior_mean
    irrelevant, value = _irrelevant(estimate, unknown)
    theta, at_zero, tight = (
        estimate.theta.copy(),
        mean.copy(),
        precision_with_fixed(problem, precision, irrelevant, FIXED_STD),
    )
    theta[irrelevant] = at_zero[irrelevant] = value
    shared = Shared.at(estimate.whitened.normal) if has_many_amplitudes(problem, estimate.noise) else None
    found = solve(problem, theta, estimate.noise, tight, at_zero, errors=False, shared=shared)
    return replace(found, covariance=found.point.covariance(precision), prior_precision=precision, prior_mean=mean)


def _unidentified_springs(estimate: Estimate) -> list[int]:
    """Numbers of the compliances that the rows neither identify nor place significantly away from their prior mean."""
    differs_from_prior = np.abs(estimate.theta - estimate.prior_mean) > CERTAIN_SPRING * estimate.std
    known = estimate.identified | differs_from_prior
    return [k for k in estimate.problem.numbers_of("compliance") if not known[k]]


def _irrelevant(estimate: Estimate, unknown: Sequence[int]) -> tuple[list[int], Array]:
    """Numbers of frictions and of the unidentified springs at their joints, and values where these have no effect."""
    places = {estimate.slots[k].place for k in unknown}
    springs = [k for k in _unidentified_springs(estimate) if estimate.slots[k].place in places]
    return [*unknown, *springs], np.r_[np.zeros(len(unknown)), estimate.prior_mean[springs]]
