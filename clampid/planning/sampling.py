"""Candidate configurations: spread over the joint ranges, evenly (Halton points), clear of floor and obstacles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.stats import qmc

from clampid.stages.rows import Array, Bools
from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits

__all__ = ["configurations", "far_apart"]

DIGITS = 6  # of the angles in a plan: a microradian, a tenth of what any robot repeats
SAMPLING_ROUNDS = 60
Allowed = Callable[[Array], Bools]


def configurations(limits: Limits, count: int, allowed: Allowed, seed: int, *, why: str = "allowed") -> Array:
    """``count`` configurations ``(count, n)``, rad, inside the limits, that ``allowed`` lets pass.

    Parameters
    ----------
    allowed
        ``(N, n)`` → ``(N,)``.
    why
        What they must be, for the error.

    Raises
    ------
    PlanError
        Hardly any configuration is allowed.
    """
    halton = qmc.Halton(len(limits.lower), scramble=True, seed=np.random.default_rng(seed))
    found: list[Array] = []
    tried = 0
    for _ in range(SAMPLING_ROUNDS):
        q = limits.lower + (limits.upper - limits.lower) * halton.random(max(count, 200))
        # Rounding must not leave the limits.
        q = np.clip(np.round(q, DIGITS), limits.lower, limits.upper)
        tried += len(q)
        found += list(q[allowed(q)])
        if len(found) >= count:
            return np.array(found[:count])
    if len(found) >= max(8, count // 20):
        return np.array(found)
    raise PlanError(f"expected configurations that are {why}, found {len(found)} among {tried} inside the joint limits")


def far_apart(places: Array, count: int, given: int = 0) -> list[int]:
    """``count`` of the places ``(N, n)``, each as far as can be from those before it; the first ``given`` in any case.

    Source: Gonzalez, Clustering to minimize the maximum intercluster distance, Theor. Comp. Sci. 38, 1985.
    """
    if count <= 0:
        return []
    chosen = list(range(given)) or [int(np.argmin(np.linalg.norm(places - places.mean(axis=0), axis=1)))]
    distance = np.min([np.linalg.norm(places - places[k], axis=1) for k in chosen], axis=0)
    while len(chosen) < count:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return chosen
