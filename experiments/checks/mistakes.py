"""Frequent mistakes in a robot's tables: a joint's sign, two joints exchanged, targets' names exchanged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, permutations

import numpy as np
import numpy.typing as npt

__all__ = ["joint_mistakes", "renaming_words", "target_mistakes"]

FloatArray = npt.NDArray[np.float64]

# Of more targets than these only swaps of two are tried; all permutations would be too many.
_ALL_ORDERS = 4


def joint_mistakes(q: FloatArray) -> Iterator[tuple[int, str, FloatArray]]:
    """Joint angles after undoing each frequent mistake.

    Parameters
    ----------
    q
        ``(N, n)`` rad, as they are written.

    Yields
    ------
    tuple of int, str, ndarray
        The first joint that is another, from 1; what would have to be done, in words; the angles ``(N, n)``.
    """
    n = q.shape[1]
    for i in range(n):
        turned = np.ones(n)
        turned[i] = -1.0
        yield i + 1, f"the sign of joint {i + 1} turned", turned * q
    for i, j in combinations(range(n), 2):
        order = np.arange(n)
        order[[i, j]] = j, i
        yield i + 1, f"joints {i + 1} and {j + 1} exchanged", q[:, order]


def target_mistakes(names: Sequence[str]) -> Iterator[Mapping[str, str]]:
    """Other names that targets may have had: two exchanged, or, of a few targets, in any other order."""
    yield from ({a: b, b: a} for a, b in combinations(names, 2))
    if len(names) <= _ALL_ORDERS:
        orders = (dict(zip(names, order, strict=True)) for order in permutations(names))
        yield from (order for order in orders if sum(order[name] != name for name in names) > 2)


def renaming_words(names: Mapping[str, str]) -> str:
    """``targets a and b swapped``, or who is who."""
    moved = [name for name in names if names[name] != name]
    if len(moved) == 2:
        return f"targets {moved[0]} and {moved[1]} swapped"
    return "targets renamed: " + ", ".join(f"{name} is {names[name]}" for name in moved)
