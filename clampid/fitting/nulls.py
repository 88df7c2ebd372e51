"""Unidentifiable combinations of parameters: null directions of the information, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clampid.fitting.observability import projected
from clampid.fitting.solve import Estimate
from clampid.slots import Slot
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array, Bools

__all__ = ["assumed_of", "named_directions", "null_directions"]

LEAST_INFORMATION = 1.0  # per squared reasonable size: with less, the data do not narrow the plausible range
NO_INFORMATION = 1e-4  # of a single parameter: a standard error above a hundred reasonable sizes


def null_directions(estimate: Estimate, limit: int = 12) -> tuple[str, ...]:
    """Sentences for the combinations of parameters that the data do not identify, the least known first.

    The information of the data is scaled by the reasonable sizes. An eigenvalue below 1 means that the standard error
    of the combination exceeds such a size. Parameters without any information are named singly.

    Parameters
    ----------
    estimate
        The fit.
    limit
        The largest number of sentences.
    """
    size = estimate.problem.sizes()
    information = estimate.whitened.normal * np.outer(size, size)
    return named_directions(
        information, size, estimate.slots, estimate.prior_precision, assumed_of(estimate.problem), limit
    )


def assumed_of(problem: FitProblem) -> Bools:
    """Which of a problem's slots ``(P,)`` their own priors separate from each other: amplitudes with a narrow prior."""
    count = len(problem.slots)
    return np.asarray((problem.prior_std() <= problem.sizes())[:count] & ~problem.shapes()[:count])


def named_directions(
    information: Array, sizes: Array, slots: Sequence[Slot], precision: Array, assumed: Bools, limit: int = 12
) -> tuple[str, ...]:
    """The same from what the data determine.

    Parameters
    ----------
    information
        ``(P + K, P + K)``: the whitened normal matrix without prior, in units of reasonable sizes.
    sizes
        Reasonable sizes ``(P + K,)``, SI.
    slots
        The first P parameters.
    precision
        Precision of the prior ``(P + K, P + K)``, SI.
    assumed
        ``(P,)``: slots that their own priors separate; see :func:`assumed_of`.
    limit
        The largest number of sentences.
    """
    count = len(slots)
    size = sizes[:count]
    information = projected(information, count)  # what the offsets can absorb is not information on the slots
    prior = precision[:count, :count] * np.outer(size, size)
    known = prior - np.diag(np.diag(prior))
    information = information + np.where(np.abs(known).sum(axis=1).max(initial=0.0) > 0, prior, 0.0)
    uninformed = np.diag(information) < NO_INFORMATION
    # Parameters that only their priors separate are not reported one by one.
    information = information + np.diag(np.where(assumed, 2.0 * LEAST_INFORMATION, 0.0))
    out = []
    groups: dict[str, list[str]] = {}
    for slot in (s for s, alone in zip(slots, uninformed, strict=True) if alone):
        groups.setdefault(f"{slot.effect}.{slot.parameter}", []).append(slot.place)
    out += [f"{name} at {', '.join(places)}: these rows do not depend on it" for name, places in groups.items()]
    values, vectors = np.linalg.eigh(information[np.ix_(~uninformed, ~uninformed)])
    labels = [s.label for s, alone in zip(slots, uninformed, strict=True) if not alone]
    open_together: dict[frozenset[int], int] = {}  # parameters of a null direction -> number of such directions
    for value, vector in zip(values, vectors.T, strict=True):
        if value >= LEAST_INFORMATION or len(out) + len(open_together) >= limit:
            break
        main = np.argsort(-np.abs(vector))
        parts = frozenset(int(k) for k in main[:4] if abs(vector[k]) > 0.25) or frozenset([int(main[0])])
        open_together[parts] = open_together.get(parts, 0) + 1
    for parts, directions in open_together.items():
        words = " and ".join(labels[k] for k in sorted(parts))
        if len(parts) == 1:
            out.append(f"{words}: the data do not narrow its plausible range")
        elif directions >= len(parts):
            out.append(f"{words}: the data narrow the plausible range of none of them")
        else:
            out.append(f"{words}: only a combination of them is known")
    return tuple(out)
