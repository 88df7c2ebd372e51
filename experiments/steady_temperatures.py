"""Temperatures of a log with the noise of their readings averaged out.

A log has hundreds of readings a second of a temperature that changes within minutes. Taken row by row, their noise
would be an error in a variable: it makes every dependence on the temperature look smaller than it is. So readings are
averaged over a second. Each run is then smoothed by straight lines through some of these means on either side. How many
is chosen by leave-one-out cross-validation, for each sensor: few where the temperature changes quickly, all of a short
run where it hardly does.

Source: Fan and Gijbels, Local polynomial modelling and its applications, 1996, sect. 2.2 and 4.2 (local linear
regression, cross-validation).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from experiments.columns import temperature_columns

__all__ = ["SteadyTemperatures"]

FloatArray = npt.NDArray[np.float64]
Columns = Mapping[str, FloatArray]

BIN_S = 1.0  # over which readings are averaged: no part of a robot warms within it
WITHOUT_ITSELF = 1e-9  # of a mean's weight: with less left, it is predicted by no other


@dataclass(frozen=True, eq=False)
class SteadyTemperatures:
    """The smoothed temperatures of a log, from which each row's is interpolated.

    Attributes
    ----------
    run
        ``(K,)``: the run of each mean, sorted.
    time
        ``(K,)``: mean stamp, s, increasing within a run.
    values
        Column → ``(K,)``, °C.
    """

    run: FloatArray
    time: FloatArray
    values: Columns

    @staticmethod
    def of(pieces: Iterable[Columns]) -> SteadyTemperatures:
        """From the rows of a log in pieces, of which each has ``run``, ``time_s`` and the temperatures."""
        summed = pd.concat([_sums(piece) for piece in pieces])
        means = summed.groupby(level=[0, 1]).sum()
        weight = means.pop("rows").to_numpy(np.float64)
        means = means.div(weight, axis=0)
        run, time = means.index.get_level_values(0).to_numpy(np.float64), means.pop("time_s").to_numpy(np.float64)
        smoother = _Smoother(run, time, weight)
        values = {str(c): smoother.smoothed(means[c].to_numpy(np.float64)) for c in means.columns}
        return SteadyTemperatures(run, time, values)

    def replacing(self, columns: Columns) -> Columns:
        """Columns of some rows, ``run`` and ``time_s`` among them, with smoothed temperatures."""
        own = [name for name in columns if name in self.values]
        out = dict(columns) | {name: np.array(columns[name], dtype=np.float64) for name in own}
        for number in np.unique(columns["run"]) if own else ():
            rows, knots = columns["run"] == number, self.run == number
            for name in own:
                out[name][rows] = np.interp(columns["time_s"][rows], self.time[knots], self.values[name][knots])
        return out


def _sums(piece: Columns) -> pd.DataFrame:
    """Sums over the rows of each second of each run: of their stamps and temperatures, and their number."""
    names = ["time_s", *temperature_columns(piece)]
    frame = pd.DataFrame({name: piece[name] for name in names}).assign(rows=1.0)
    return frame.groupby([piece["run"], np.floor(piece["time_s"] / BIN_S)]).sum()


class _Smoother:
    """Straight lines through weighted means of runs, some on either side of each."""

    def __init__(self, run: FloatArray, time: FloatArray, weight: FloatArray) -> None:
        self._time, self._weight = time, weight
        _, first, which, length = np.unique(run, return_index=True, return_inverse=True, return_counts=True)
        self._start, self._stop = first[which], (first + length)[which]
        self._longest = int(length.max(initial=1))

    def smoothed(self, values: FloatArray) -> FloatArray:
        """Values ``(K,)`` smoothed over as many neighbours as predict the means left out best."""
        best, least = values, np.inf
        for half in self._halves():
            found, leverage = self._lines(values, half)
            judged = leverage < 1.0 - WITHOUT_ITSELF
            if half == 1:
                of_all = judged  # the means that have neighbours: of these every width predicts each
            left = (values - found)[of_all] / (1.0 - leverage[of_all])
            squares = float(np.sum(self._weight[of_all] * left**2))
            if squares < least:
                best, least = found, squares
        return best

    def _halves(self) -> Iterator[int]:
        """Numbers of neighbours on either side: 1, 2, 4, … up to all of the longest run."""
        half = 1
        while True:
            yield half
            if half >= self._longest:
                return
            half *= 2

    def _lines(self, values: FloatArray, half: int) -> tuple[FloatArray, FloatArray]:
        """The line's value at each mean ``(K,)``, and the mean's own share in it."""
        here = np.arange(len(values))
        low, high = np.maximum(here - half, self._start), np.minimum(here + half + 1, self._stop)

        def over(x: FloatArray) -> FloatArray:
            total = np.r_[0.0, np.cumsum(x)]
            return np.asarray(total[high] - total[low])

        origin, base = self._time[self._start], values[self._start]
        t, y, w = self._time - origin, values - base, self._weight
        weight = over(w)
        middle, level = over(w * t) / weight, over(w * y) / weight
        spread = np.maximum(over(w * t**2) - weight * middle**2, 0.0)
        slope = np.divide(over(w * t * y) - weight * middle * level, spread, where=spread > 0.0, out=np.zeros(len(t)))
        own = np.divide((t - middle) ** 2, spread, where=spread > 0.0, out=np.zeros(len(t)))
        return base + level + slope * (t - middle), w * (1.0 / weight + own)
