"""Expected results of planned measurements: standard errors, observability, unidentifiable combinations."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from clampid.fitting.noise import Noise, Whitened
from clampid.fitting.nulls import null_directions
from clampid.fitting.observability import observability
from clampid.fitting.priors import description_priors
from clampid.fitting.solve import Estimate
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array
from experiments.plans.model import Expected, ExpectedParameter

__all__ = ["expected_of", "predicted_covariance", "prior_precision"]


def prior_precision(problem: FitProblem) -> Array:
    """Precision ``(P, P)``, SI, of a fit's prior: each slot's weak prior, and the description's masses."""
    count = len(problem.slots)
    precision = np.diag(1.0 / problem.prior_std()[:count] ** 2)
    index = {slot: k for k, slot in enumerate(problem.slots)}
    for prior in description_priors(problem.rows):
        shared = [k for k, slot in enumerate(prior.slots) if slot in index]
        where = [index[prior.slots[k]] for k in shared]
        if where:
            precision[np.ix_(where, where)] = linalg.pinvh(prior.covariance[np.ix_(shared, shared)])
    return precision


def predicted_covariance(information: Array, precision: Array, size: Array) -> Array:
    """Covariance ``(P, P)``, SI, from information and prior precision ``(P, P)``; ``size`` ``(P,)`` balances it."""
    scaled = (information + precision) * np.outer(size, size)
    return np.asarray(linalg.pinvh(scaled) * np.outer(size, size))


def expected_of(
    problem: FitProblem, information: Array, rows: int, noise: str, extra: tuple[str, ...] = ()
) -> Expected:
    """The expected results that a plan states.

    Parameters
    ----------
    problem
        A problem with any rows of the plan and all its slots.
    information
        Information ``(P, P)`` of all planned rows, SI, with unknown constants of single runs eliminated.
    rows
        Number of measured values.
    noise
        The assumed noise, in words.
    extra
        Further sentences on what is not identifiable.
    """
    count = len(problem.slots)
    size = problem.sizes()[:count]
    precision = prior_precision(problem)
    covariance = predicted_covariance(information, precision, size)
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    parameters = []
    for k, (slot, parameter) in enumerate(zip(problem.slots, problem.parameters, strict=True)):
        parameters.append(
            ExpectedParameter(slot.label, parameter.unit, parameter.size, float(std[k]), bool(std[k] < parameter.size))
        )
    scaled = information * np.outer(size, size)
    open_ = null_directions(_estimate(problem, information, covariance, precision))
    return Expected(observability(scaled, rows), tuple(parameters), (*extra, *open_), noise)


def _estimate(problem: FitProblem, information: Array, covariance: Array, precision: Array) -> Estimate:
    """An estimate with this information, so that its null directions are worded as for a fit."""
    values, vectors = np.linalg.eigh(information)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    count = len(information)
    bare = problem.with_rows(problem.rows.take(np.zeros(0, dtype=np.int64)))
    still = np.zeros(count, dtype=np.int64)
    return Estimate(
        problem=bare,
        theta=np.zeros(count),
        covariance=covariance,
        noise=Noise(bare.rows.sigma),
        whitened=Whitened(np.zeros(count), root, still, still),
        residual=bare.rows.measured,
        outliers=np.zeros(0, dtype=bool),
        prior_precision=precision,
        prior_mean=np.zeros(count),
        iterations=0,
    )
