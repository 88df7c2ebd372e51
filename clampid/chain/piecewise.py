"""A chain's function cut into pieces, so that what is compiled for one model serves the next.

The source of a whole chain changes with each effect that is added, and the compiler takes seconds for it, for each of
the dozens of models of a diagnosis. A piece has the outputs of one station, and reads only the numbers that these
depend on. It changes only if something is added at its own joint, and all joints of one law have the same piece.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from clampid.chain.compiled import Blocks, compile_piece, pieces_pay
from clampid.chain.lanes import Lanes

__all__ = ["Piecewise", "runs_of"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class _Piece:
    """The outputs of one station.

    Attributes
    ----------
    function
        Of the parameters and the numbers of a row that it reads, to its outputs one below the other.
    theta, row
        Which parameters and numbers of a row these are.
    value, partials
        Which outputs of the whole function they are: its value ``(0,)`` or ``(1,)``, and its partials.
    """

    function: Any
    theta: Integers
    row: Integers
    value: Integers
    partials: Integers

    @cached_property
    def compiled(self) -> Blocks | Lanes:
        """What evaluates it."""
        return compile_piece(self.function)

    def read(self, columns: Sequence[Array]) -> Array:
        """The numbers ``(N, r)`` of the rows that it reads, from the blocks of all numbers side by side."""
        out, first, filled = np.empty((len(columns[0]), len(self.row))), 0, 0
        for block in columns:
            own = self.row[(self.row >= first) & (self.row < first + block.shape[1])] - first
            for run in runs_of(own):  # a gather by numbers takes three times as long
                width = run.stop - run.start
                out[:, filled : filled + width] = block[:, run]
                filled += width
            first += block.shape[1]
        return out


def runs_of(numbers: Integers) -> list[slice]:
    """Ascending numbers as slices of consecutive ones."""
    edges = np.flatnonzero(np.diff(numbers) != 1) + 1
    return [slice(int(run[0]), int(run[-1]) + 1) for run in np.split(numbers, edges) if len(run)]


class Piecewise:
    """A function of (parameters, row) to values and partials, compiled piece by piece where its rows pay for that.

    Which calls are compiled depends on the number of rows alone, so that the same call has the same result at any time.

    Parameters
    ----------
    function
        A ``casadi.Function`` of parameters and row to the stations' values ``(S,)`` and partials ``(nonzeros,)``, all
        dense. Without values it has none of any station.
    station
        ``(nonzeros,)``: the station of each partial.
    """

    def __init__(self, function: Any, station: Integers) -> None:
        self.function, self.station = function, station

    def __call__(self, theta: Array, *columns: Array) -> list[Array]:
        """As :class:`clampid.chain.compiled.Blocks`."""
        if not columns or not pieces_pay(len(columns[0])):
            return self._blocks(theta, *columns)
        values, partials = (np.zeros((len(columns[0]), self.function.nnz_out(k))) for k in range(2))
        for piece in self._pieces:
            (found,) = piece.compiled(theta[piece.theta], piece.read(columns))
            values[:, piece.value] = found[:, : len(piece.value)]
            partials[:, piece.partials] = found[:, len(piece.value) :]
        return [values, partials]

    @cached_property
    def _blocks(self) -> Blocks:
        return Blocks(self.function)

    @cached_property
    def _pieces(self) -> list[_Piece]:
        """The pieces of all stations whose outputs are not zero."""
        theta, row = (ca.SX.sym(name, self.function.nnz_in(k)) for k, name in enumerate(("theta", "row")))
        values, partials = self.function(theta, row)
        outputs, count = ca.vertcat(values, partials), values.shape[0]
        pattern = ca.jacobian_sparsity(outputs, ca.vertcat(theta, row)).get_triplet()
        output, number = (np.array(k, dtype=np.int64) for k in pattern)
        moved = {k for k in range(count) if not values[k].is_zero()}
        out = []
        for station in sorted(moved | set(self.station.tolist())):
            value = np.array([station] if station in moved else [], dtype=np.int64)
            own = np.flatnonzero(self.station == station)
            mine = np.r_[value, count + own]
            read = np.unique(number[np.isin(output, mine)])
            of_theta, of_row = read[read < theta.shape[0]], read[read >= theta.shape[0]] - theta.shape[0]
            inputs = [theta[of_theta.tolist()], row[of_row.tolist()]]
            function = ca.Function("piece", inputs, [outputs[mine.tolist()]])
            out.append(_Piece(function, of_theta, of_row, value, own))
        return out
