"""Short open tours through places: nearest neighbour, then reversal of segments while it shortens the tour (2-opt).

Source: Croes, A method for solving traveling-salesman problems, Operations Research 6, 1958 (2-opt), on an open path.
"""

from __future__ import annotations

import numpy as np

from clampid.stages.rows import Array

__all__ = ["short_tour", "tour_length"]


def tour_length(cost: Array, order: list[int]) -> float:
    """Sum of the costs ``(N, N)`` of the steps along an order."""
    return float(cost[order[:-1], order[1:]].sum())


def short_tour(cost: Array, start: int = 0, fixed: bool = True) -> list[int]:
    """A short order of all N places.

    Parameters
    ----------
    cost
        Symmetric costs of the steps ``(N, N)``; forbidden steps have a large, finite cost.
    start
        Index of the place at which the search begins.
    fixed
        Whether ``start`` stays the first place.
    """
    N = len(cost)
    order, left = [start], set(range(N)) - {start}
    while left:
        rest = np.array(sorted(left))
        near = int(rest[np.argmin(cost[order[-1], rest])])
        order.append(near)
        left.remove(near)
    moved = True
    while moved:
        moved = False
        for i in range(1 if fixed else 0, N - 1):
            # Reversing order[i..j] changes only the steps into i and out of j; the first place has no step into it,
            # and the last none out of it.
            at = np.array(order)
            j = np.arange(i + 1, N)
            after = np.minimum(j + 1, N - 1)
            out_old = np.where(j + 1 < N, cost[at[j], at[after]], 0.0)
            out_new = np.where(j + 1 < N, cost[at[i], at[after]], 0.0)
            into_old = cost[at[i - 1], at[i]] if i else 0.0
            into_new = cost[at[i - 1], at[j]] if i else np.zeros(len(j))
            gain = into_old + out_old - into_new - out_new
            best = int(np.argmax(gain))
            if gain[best] > 1e-9 * max(1.0, float(cost.max())):
                end = int(j[best])
                order[i : end + 1] = order[i : end + 1][::-1]
                moved = True
    return order
