"""Testability: the state of each candidate, and the detection limit of each parameter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import optimize, stats

from clampid.diagnosis.candidate_scores import DICTIONARY_FALSE_ALARMS, IMPOSSIBLE
from clampid.effect import Effect
from clampid.evidence.flips import Flips
from clampid.evidence.score import Scored
from clampid.evidence.tails import log_tail
from clampid.stages.fit_problem import parameter_of
from kinematics.robot import RobotDescription

__all__ = ["noncentrality", "testability_of"]

POWER = 0.9
GAUSSIAN = 300.0


def noncentrality(freedom: int, null: Flips) -> float:
    """The noncentrality that is found with 90 % power at this dictionary's size."""
    log_p = null.critical_log_p(DICTIONARY_FALSE_ALARMS)
    most = 4.0 * (freedom - log_p) + 100.0
    critical = float(optimize.brentq(lambda x: float(log_tail(x, freedom)) - log_p, 0.0, most))

    def short(x: float) -> float:
        return float(stats.ncx2.sf(critical, freedom, x)) - POWER

    if critical > GAUSSIAN:  # far out the distribution of the statistic is narrow about its mean
        return critical + float(stats.norm.isf(1 - POWER)) * 2.0 * float(np.sqrt(critical))
    return float(optimize.brentq(short, 0.0, 10.0 * critical + 200.0))


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
        if s.freedom and s.freedom not in factor:
            factor[s.freedom] = np.sqrt(noncentrality(s.freedom, null))
        limits: list[dict[str, Any]] = []
        together = s.candidate.prior is not None  # too many to be found one by one: so many times the assumed size
        if together and s.freedom:
            information = float(np.sum(s.kept**2 / np.maximum(1.0 - s.kept, 1e-9)))
            name = f"{s.candidate.name}, in assumed sizes"
            limits.append(
                {"name": name, "limit": float(factor[s.freedom] / np.sqrt(information)), "unit": "", "size": 1.0}
            )
        for slot, unit_limit in zip(s.candidate.slots, s.unit_limit, strict=True):
            if together:
                break
            limit = float(unit_limit * factor[s.freedom]) if s.freedom and np.isfinite(unit_limit) else None
            parameter = parameter_of(slot, effects, robot)
            if limit is not None and limit > IMPOSSIBLE * parameter.size:
                limit = None
            limits.append({"name": slot.label, "limit": limit, "unit": parameter.unit, "size": parameter.size})
        entry = {"effect": s.candidate.family, "name": s.candidate.name, "where": list(s.candidate.places)}
        blind = s.state == "testable" and all(limit["limit"] is None for limit in limits)
        out.append({**entry, "state": "insensitive" if blind else s.state, "retained": s.retained, "limits": limits})
    return out
