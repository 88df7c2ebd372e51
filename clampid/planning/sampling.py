"""Candidate configurations: evenly spread over the joint ranges (Halton points), with a test that they must pass."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.stats import qmc

from clampid.stages.rows import Array, Bools
from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits

__all__ = ["configurations", "far_apart"]

DIGITS = 6  # of the angles in a plan: a microradian, a tenth of the best repeatability of robots
SAMPLING_ROUNDS = 60
Allowed = Callable[[Array], Bools]


def configurations(limits: Limits, count: int, allowed: Allowed, seed: int, *, why: str = "allowed") -> Array:
    """Allowed configurations inside the limits ``(count, n)``, rad; fewer if few are found.

    Parameters
    ----------
    limits
        Ranges of the joints.
    count
        The wanted number.
    allowed
        Test of configurations: ``(N, n)``, rad → ``(N,)``.
    seed
        Seed of the sequence.
    why
        What allowed configurations are, for the error message.

    Raises
    ------
    PlanError
        Fewer than 8, or than a twentieth of ``count``, are found.
    """
    halton = qmc.Halton(len(limits.lower), scramble=True, seed=np.random.default_rng(seed))
    found: list[Array] = []
    tried = 0
    for _ in range(SAMPLING_ROUNDS):
        q = limits.lower + (limits.upper - limits.lower) * halton.random(max(count, 200))
        # Rounded angles may lie just outside the limits, hence the clipping.
        q = np.clip(np.round(q, DIGITS), limits.lower, limits.upper)
        tried += len(q)
        found += list(q[allowed(q)])
        if len(found) >= count:
            return np.array(found[:count])
    if len(found) >= max(8, count // 20):
        return np.array(found)
    raise PlanError(f"expected configurations that are {why}, found {len(found)} among {tried} inside the joint limits")


def far_apart(places: Array, count: int, given: int = 0) -> list[int]:
    """Indices of ``count`` of the points ``places`` ``(N, n)``, each as far as possible from those before it.

    The first ``given`` points are taken in any case. Source: Gonzalez, Clustering to minimize the maximum intercluster
    distance, Theor. Comp. Sci. 38, 1985.
    """
    if count <= 0:
        return []
    chosen = list(range(given)) or [int(np.argmin(np.linalg.norm(places - places.mean(axis=0), axis=1)))]
    distance = np.min([np.linalg.norm(places - places[k], axis=1) for k in chosen], axis=0)
    while len(chosen) < count:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return chosen
