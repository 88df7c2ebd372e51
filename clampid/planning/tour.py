"""A short way through places: to the nearest one each time, then turning stretches round as long as that shortens it.

Source: Croes, A method for solving traveling-salesman problems, Operations Research 6, 1958 (2-opt), on an open path.
"""

from __future__ import annotations

import numpy as np

from clampid.stages.rows import Array

__all__ = ["short_tour", "tour_length"]


def tour_length(cost: Array, order: list[int]) -> float:
    """Sum of the steps of ``cost`` ``(N, N)`` along an order."""
    return float(cost[order[:-1], order[1:]].sum())


def short_tour(cost: Array, start: int = 0, fixed: bool = True) -> list[int]:
    """An order of all places that begins at ``start``.

    Parameters
    ----------
    cost
        ``(N, N)``, symmetric; what must not be done costs much, but not infinitely.
    fixed
        Whether the first place stays the first.
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
            # Turning round order[i..j]: the steps into i and out of j change; before the first and after the last
            # there are none.
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
