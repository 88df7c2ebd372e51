"""Reproducible noise: row k of a stream is the same at every request, in any order."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np

from experiments.virtual_robot.description import Array
from experiments.virtual_robot.instrument import CORRELATION_TIME, SLOW_SHARE

__all__ = ["Noise"]

BLOCK = 1024  # rows; at 12 ms, six times the correlation time
ROWS_AT_ONCE = 64  # rows that are filtered at once
BLOCKS_KEPT = 24  # blocks: more than what a recording keeps


class Noise:
    """White and slow noise of unit size, row by row.

    Slow noise is that of `experiments.virtual_robot.instrument.torque_noise`. Every block starts it from the block
    before, so that consecutive blocks fit to 0.2 %, and none needs those long ago.

    Parameters
    ----------
    seed
        Of the stream; another one after every restart.
    width
        Numbers in a row.
    step
        s between two rows.
    """

    def __init__(self, seed: tuple[int, ...], width: int, step: float) -> None:
        self._seed, self._width = seed, width
        self._memory = float(np.exp(-step / CORRELATION_TIME))
        lag = np.subtract.outer(np.arange(ROWS_AT_ONCE), np.arange(ROWS_AT_ONCE))
        self._within = np.where(lag >= 0, self._memory ** np.maximum(lag, 0), 0.0)  # (ROWS_AT_ONCE, ROWS_AT_ONCE)
        self._onward = self._memory ** np.arange(1, ROWS_AT_ONCE + 1)
        self._blocks: OrderedDict[int, tuple[Array, Array, Array]] = OrderedDict()

    def torque(self, rows: list[int]) -> Array:
        """Return noise of unit size, correlated in time, (N, width)."""
        white, slow = self._rows(rows, 0), self._rows(rows, 1)
        return np.asarray(np.sqrt(1 - SLOW_SHARE) * white + np.sqrt(SLOW_SHARE) * slow, dtype=float)

    def white(self, rows: list[int]) -> Array:
        """Return white noise of unit size, (N, width)."""
        return self._rows(rows, 2)

    def _rows(self, rows: list[int], which: int) -> Array:
        return np.array([self._block(row // BLOCK)[which][row % BLOCK] for row in rows])

    def _block(self, number: int) -> tuple[Array, Array, Array]:
        if number in self._blocks:
            self._blocks.move_to_end(number)
            return self._blocks[number]
        before, here = self._draw(number - 1), self._draw(number)
        drive = np.vstack([before[1], here[1]]) * np.sqrt(1 - self._memory**2)
        drive[0] = before[1][0]  # starts in the stationary state
        slow = self._remembered(drive)[BLOCK:]
        self._blocks[number] = block = (here[0], slow, here[2])
        if len(self._blocks) > BLOCKS_KEPT:
            self._blocks.popitem(last=False)
        return block

    def _remembered(self, drive: Array) -> Array:
        """y_k = memory·y_(k−1) + x_k, (N, width): chunk by chunk, each from the last row of the one before."""
        out, last = np.empty_like(drive), np.zeros(self._width)
        for begin in range(0, len(drive), ROWS_AT_ONCE):
            out[begin : begin + ROWS_AT_ONCE] = (
                self._within @ drive[begin : begin + ROWS_AT_ONCE] + self._onward[:, None] * last
            )
            last = out[begin + ROWS_AT_ONCE - 1]
        return out

    def _draw(self, number: int) -> Array:
        return np.asarray(np.random.default_rng([*self._seed, number + 1]).standard_normal((3, BLOCK, self._width)))
