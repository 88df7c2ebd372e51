"""Columns of the Jacobian that stay constant during a search: computed once, not at every trial point.

An angle curve of a hundred harmonics is linear in its amplitudes, and its sines depend on the recorded joint angles
alone. Computed anew at each point they are most of what a fit of poses takes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

from clampid.chain.compiled import Rowwise

__all__ = ["Steady", "parted"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

WORTH = 24  # columns: fewer are computed faster than they are kept
SETS_KEPT = 3  # sets of columns, of all chains together: a diagnosis remembers dozens of fits, and a set may have 20 MB


class Steady:
    """Columns of a chain's partials that depend on recorded signals and fixed parameters alone.

    Parameters
    ----------
    function
        (fixed parameters, row) → the columns.
    signals
        Names and widths of the signals that it reads.
    fixed
        Numbers of the parameters that it reads.
    columns, others
        Numbers ``(k,)``, ``(r,)`` of the steady columns, and of the rest, among the chain's partials.
    station, parameter
        ``(k,)``: which entry of S, in their order, and which parameter each steady column belongs to.
    """

    def __init__(
        self,
        function: Rowwise,
        signals: Sequence[tuple[str, int]],
        fixed: Integers,
        columns: Integers,
        others: Integers,
        station: Integers,
        parameter: Integers,
    ) -> None:
        self.function, self.signals, self.fixed = function, tuple(signals), fixed
        self.parameter, self.count = parameter, len(columns) + len(others)
        self._stations = [(int(station[run.start]), run) for run, _ in _runs(station, np.zeros_like(station))]
        self._places = _runs(np.zeros_like(columns), columns), _runs(np.zeros_like(others), others)

    def partials(self, theta: Array, read: tuple[Array, ...]) -> Array:
        """The steady columns ``(N, k)``, as they were found before where rows and fixed parameters are the same.

        Parameters
        ----------
        theta
            All parameters ``(P,)``.
        read
            The signals, in their order, ``(N, …)`` each; the same arrays for the same rows.
        """
        fixed = theta[self.fixed]
        for owner, key, arrays, found in _KNOWN:
            if owner is self and key == fixed.tobytes() and all(a is b for a, b in zip(arrays, read, strict=True)):
                return found
        found = self.function(
            fixed, *(np.reshape(a, (len(a), w)) for a, (_, w) in zip(read, self.signals, strict=True))
        )[0]
        _KNOWN.appendleft((self, fixed.tobytes(), read, found))
        return found

    def add(self, values: Array, partials: Array, theta: Array, first: int = 0) -> None:
        """Add what these columns' parameters do to ``values`` ``(N, …)``, of the entries of S from the ``first`` on."""
        for station, run in self._stations:
            if 0 <= station - first < values.shape[1]:
                values[:, station - first] += partials[:, run] @ theta[self.parameter[run]]

    def joined(self, partials: Array, others: Array) -> Array:
        """All partials ``(N, nonzeros)``, in the chain's order, from the steady columns and the rest."""
        out = np.empty((len(partials), self.count))
        for places, part in zip(self._places, (partials, others), strict=True):
            for mine, there in places:
                out[:, there] = part[:, mine]
        return out


_KNOWN: deque[tuple[Steady, bytes, tuple[Array, ...], Array]] = deque(maxlen=SETS_KEPT)
"""The columns found last, with whose they are, the fixed parameters and the signals that they are of."""


class Parted(NamedTuple):
    """What is left of a chain's values and partials without the steady columns; and these."""

    values: Any
    partials: Any
    steady: Steady


def parted(
    theta: Any, free: Integers, flats: Mapping[str, Any], varying: Sequence[str], values: Any, partials: Any,
    station: Integers, parameter: Integers,
) -> Parted | None:  # fmt: skip
    """Part the steady columns from the rest; None where there are too few.

    A parameter is parted when all its columns are steady. Mixed derivatives are symmetric, so that no other column
    depends on it, and with it at zero the values lack just its columns times it.

    Parameters
    ----------
    theta
        Symbols of all parameters ``(P, 1)``.
    free
        Numbers of those that a fit changes.
    flats
        Symbols of a row's signals.
    varying
        Names of signals that follow the parameters.
    values, partials
        Expressions of the entries of S, and of their derivatives by the parameters.
    station, parameter
        ``(nonzeros,)``: whose each of the partials is.
    """
    moving = ca.vertcat(theta[free.tolist()], *(flats[name] for name in varying if name in flats))
    depends = np.unique(ca.jacobian_sparsity(partials, moving).get_triplet()[0]).astype(np.int64)
    bent = np.zeros(len(parameter), dtype=bool)
    bent[depends] = True
    chosen = np.setdiff1d(np.unique(parameter), np.unique(parameter[bent]))
    mine = np.isin(parameter, chosen)
    columns, others = np.flatnonzero(mine), np.flatnonzero(~mine)
    if len(columns) < WORTH:
        return None
    without = ca.SX(theta)
    without[chosen.tolist()] = 0.0
    kept = partials[others.tolist()] if len(others) else ca.SX(0, 1)
    values, kept = ca.substitute([values, kept], [theta], [without])
    fixed = np.setdiff1d(np.arange(theta.shape[0]), free)
    own = partials[columns.tolist()]
    read = {name: flat for name, flat in flats.items() if ca.depends_on(own, flat)}
    function = ca.Function("steady", [theta[fixed.tolist()], ca.vertcat(*read.values())], [own])
    signals = [(name, flat.shape[0]) for name, flat in read.items()]
    # Its columns are kept, so that it is called once for the rows of a fit.
    steady = Steady(Rowwise(function, 1), signals, fixed, columns, others, station[columns], parameter[columns])
    return Parted(values, kept, steady)


def _runs(of: Integers, places: Integers) -> list[tuple[slice, slice]]:
    """Stretches of numbers that are of the same and stand beside each other: in their order, and where they stand."""
    if not len(places):
        return []
    beside = (np.diff(places) == 1) if np.any(places) else np.ones(len(places) - 1, dtype=bool)
    edges = [0, *(np.flatnonzero((np.diff(of) != 0) | ~beside) + 1).tolist(), len(places)]
    return [(slice(i, j), slice(int(places[i]), int(places[i]) + j - i)) for i, j in pairwise(edges)]
