"""Testability: the state of each candidate, and the detection limit of each parameter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import optimize, stats

from clampid.diagnosis.candidate_scores import DICTIONARY_FALSE_ALARMS, IMPOSSIBLE
from clampid.effect import Effect
from clampid.evidence.score import Flips, Scored
from clampid.evidence.tails import log_tail, log_tail_of_f
from clampid.stages.fit_problem import parameter_of
from kinematics.robot import RobotDescription

__all__ = ["noncentrality", "testability_of"]

POWER = 0.9
GAUSSIAN = 300.0
PARTS = 50


def noncentrality(freedom: int, null: Flips, rest: float = np.inf) -> float:
    """The noncentrality that is found with 90 % power at this dictionary's size.

    ``rest``: degrees of freedom of the variance that the statistic divides by; by default it is known.
    """
    log_p = null.critical_log_p(DICTIONARY_FALSE_ALARMS)
    critical = _critical(log_p, freedom, rest)
    # A variance with few degrees of freedom is averaged over its distribution, in parts of equal probability.
    parts = (np.arange(PARTS) + 0.5) / PARTS
    variance = np.ones(1) if np.isinf(rest) else stats.chi2.ppf(parts, rest) / rest

    def short(x: float) -> float:
        at = critical * variance
        exact = stats.ncx2.sf(np.minimum(at, GAUSSIAN), freedom, x)
        # Far out the distribution of the statistic is narrow about its mean.
        far = stats.norm.sf((at - x) / (2.0 * np.sqrt(max(x, 1.0))))
        return float(np.mean(np.where(at > GAUSSIAN, far, exact))) - POWER

    if np.isinf(rest) and critical > GAUSSIAN:
        return critical + float(stats.norm.isf(1 - POWER)) * 2.0 * float(np.sqrt(critical))
    return float(optimize.brentq(short, 0.0, 10.0 * critical * float(variance.max()) + 200.0))


def _critical(log_p: float, freedom: int, rest: float) -> float:
    """The sum of squares, in units of the variance, whose p-value has this logarithm."""
    if np.isinf(rest):
        most = 4.0 * (freedom - log_p) + 100.0
        return float(optimize.brentq(lambda x: float(log_tail(x, freedom)) - log_p, 0.0, most))

    def short(log_x: float) -> float:
        return float(log_tail_of_f(np.array(np.exp(log_x) / freedom), freedom, rest)) - log_p

    return float(np.exp(optimize.brentq(short, -50.0, 100.0 - 2.0 * log_p / rest)))


def testability_of(
    named: Sequence[Scored], null: Flips, effects: dict[str, Effect], robot: RobotDescription
) -> list[dict[str, Any]]:
    """For each candidate its state and the smallest parameter that is found with 90 % probability.

    A limit above every possible value of the parameter is None: no such effect would be found. If this holds for all
    parameters, the candidate is ``insensitive`` instead of ``testable``. Each limit is listed with the plausible
    ``size`` of the parameter.
    """
    out, factor = [], {}
    for s in named:
        size = s.freedom, round(s.rest_freedom, 1)
        if s.freedom and size not in factor:
            factor[size] = np.sqrt(noncentrality(s.freedom, null, size[1]))
        limits: list[dict[str, Any]] = []
        together = s.candidate.prior is not None  # too many to be found one by one: so many times the assumed size
        if together and s.freedom:
            information = float(np.sum(s.kept**2 / np.maximum(1.0 - s.kept, 1e-9)))
            name = f"{s.candidate.name}, in assumed sizes"
            limits.append({"name": name, "limit": float(factor[size] / np.sqrt(information)), "unit": "", "size": 1.0})
        for slot, unit_limit in zip(s.candidate.slots, s.unit_limit, strict=True):
            if together:
                break
            limit = float(unit_limit * factor[size]) if s.freedom and np.isfinite(unit_limit) else None
            parameter = parameter_of(slot, effects, robot)
            if limit is not None and limit > IMPOSSIBLE * parameter.size:
                limit = None
            limits.append({"name": slot.label, "limit": limit, "unit": parameter.unit, "size": parameter.size})
        entry = {"effect": s.candidate.family, "name": s.candidate.name, "where": list(s.candidate.places)}
        blind = s.state == "testable" and all(limit["limit"] is None for limit in limits)
        out.append({**entry, "state": "insensitive" if blind else s.state, "retained": s.retained, "limits": limits})
    return out
