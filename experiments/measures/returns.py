"""Returns to a pose that differ by noise alone, and how many are needed to estimate the noise."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["ENOUGH_RETURNS", "SAME_TEMPERATURE_K", "comparable_returns", "freedom_of"]

# Returns count as replicates only where nothing but noise should differ (INTERFACE.md).
SAME_TEMPERATURE_K = 0.5
# Degrees of freedom (13 % of a coordinate's sigma, 7 % of the norm) below which the stated noise is more accurate.
ENOUGH_RETURNS = 30

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


def comparable_returns(place: Array, visit: Integers, direction: Array, warmth: Array) -> list[Integers]:
    """Find the rows that returned to the same place in the same way.

    Parameters
    ----------
    place
        ``(N, k)``: rows that agree in all of these measured one target at one pose in one session.
    visit
        ``(N,)``: of these, what was measured in one visit is no return.
    direction
        ``(N, n)``: -1 or 1, from where each joint came; 0 is not known, and not known to be the same.
    warmth
        ``(N, m)`` K: temperatures of links and motors, NaN where not read; m may be 0.

    Returns
    -------
    list of Integers
        Indices of two rows or more each, one per visit, within 0.5 K of the first.
    """
    known = np.flatnonzero(np.all(direction != 0, axis=1))
    _, group = np.unique(np.c_[place, direction][known], axis=0, return_inverse=True)
    out = []
    for g in range(int(group.max(initial=-1)) + 1):
        members = known[group.ravel() == g]
        _, first = np.unique(visit[members], return_index=True)
        members = members[np.sort(first)]
        # A sensor that was not read in one of two visits does not show their difference.
        members = members[~np.any(np.abs(warmth[members] - warmth[members[0]]) > SAME_TEMPERATURE_K, axis=1)]
        if len(members) > 1:
            out.append(np.asarray(members, dtype=np.int64))
    return out


def freedom_of(returns: list[Integers]) -> int:
    """Degrees of freedom of what differs among returns: rows beyond the first of each group."""
    return sum(len(members) - 1 for members in returns)
