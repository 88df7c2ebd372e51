"""One casadi function of one row, for single rows and for whole blocks of them.

It runs compiled (see :mod:`clampid.chain.compiled`), eight rows at once where they come in blocks, or, without a
compiler, in casadi's own machine.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from clampid.chain.compiled import Blocks, compile_function, compile_rows
from clampid.chain.lanes import Lanes

__all__ = ["Kernel"]

Array = npt.NDArray[np.float64]

FEWEST_BLOCK_ROWS = 64  # rows; fewer are not worth a block


class Kernel:
    """A function of one row, for single rows and for blocks of them.

    Parameters
    ----------
    function
        A ``casadi.Function`` of a single vector, compiled where a compiler is found.
    """

    def __init__(self, function: Any) -> None:
        kind: Any = ca.SX if function.is_a("SXFunction") else ca.MX
        symbols = kind.sym("row", function.nnz_in(0))
        self._source = ca.Function(function.name(), [kind(0, 1), symbols], function.call([symbols]))
        self.function = compile_function(self._source)
        self._blocks: Blocks | Lanes | None = None
        self.row = np.zeros(function.nnz_in(0))
        self.out = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
        self._buffer, self.trigger = self.function.buffer()
        self._buffer.set_arg(1, self.row.data)
        for i, array in enumerate(self.out):
            self._buffer.set_res(i, array.data)

    def one(self, row: Array) -> list[Array]:
        """The outputs of one row; they are overwritten by the next call."""
        self.row[:] = row
        self.trigger()
        return self.out

    def many(self, *columns: Array) -> list[Array]:
        """The outputs of rows whose columns come in blocks ``(N, k)`` one beside the other."""
        if len(columns[0]) < FEWEST_BLOCK_ROWS:
            rows = np.concatenate(columns, axis=1)
            found = [[out.copy() for out in self.one(row)] for row in rows]
            return [np.array([f[i] for f in found]).reshape(len(rows), len(o)) for i, o in enumerate(self.out)]
        if self._blocks is None:
            self._blocks = compile_rows(self._source)
        return self._blocks(np.zeros(0), *columns)
