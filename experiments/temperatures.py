"""Temperature sensors of a campaign's tables: short gaps are interpolated, longer ones are unknown.

Between two readings not longer than `GAP_S` apart a missing one is interpolated in time; before the first and after the
last, one not farther than `END_S` holds. A motor that warms by 30 K with a time constant of 20 minutes bends away from
the straight line by at most 0.2 K in the middle of such a gap, and changes by at most 1.5 K beyond such an end.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
import pandas as pd

from experiments.columns import temperature_columns

__all__ = ["COLDEST_C", "END_S", "GAP_S", "HOTTEST_C", "REFERENCE_TEMPERATURE", "filled", "readings"]

FloatArray = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

GAP_S, END_S = 300.0, 60.0
# Class F windings end at 155 °C and drives switch off before; no sensor in a robot that runs is outside this.
HOTTEST_C, COLDEST_C = 120.0, -40.0
REFERENCE_TEMPERATURE = 20.0  # °C: links have the length of the geometry, and signals of temperature count from here


def readings(frame: pd.DataFrame, name: str) -> tuple[FloatArray, Bools]:
    """A sensor's readings ``(rows,)``, °C, short gaps bridged, and in which rows they are known."""
    values = frame[name].to_numpy(dtype=np.float64, na_value=np.nan).copy()
    known = np.isfinite(values)
    if known.all() or not known.any():
        return values, known
    time = frame["time_s"].to_numpy(dtype=np.float64)
    if len(time) > 1 and np.all(np.diff(time) == 1.0) and "pose" in frame:
        return values, known  # it counts rows, so the length of a gap is unknown
    run = next((frame[key].to_numpy() for key in ("run", "sweep") if key in frame), np.zeros(len(frame)))
    if "sweep" in frame:
        run = np.zeros(len(frame))  # one clock for all sweeps
    for number in np.unique(run[~known]):
        own, lost = np.flatnonzero((run == number) & known), np.flatnonzero((run == number) & ~known)
        if own.size:
            own = own[np.argsort(time[own], kind="stable")]
            values[lost] = _bridged(time[own], values[own], time[lost])
    return values, np.isfinite(values)


def _bridged(time: FloatArray, values: FloatArray, wanted: FloatArray) -> FloatArray:
    """Readings ``(k,)`` in order of time, at other times ``(w,)``; not a number where they are too far."""
    after = np.searchsorted(time, wanted)
    before = np.clip(after - 1, 0, len(time) - 1)
    inside = (after > 0) & (after < len(time))
    after = np.clip(after, 0, len(time) - 1)
    near = np.where(inside, time[after] - time[before] <= GAP_S, np.abs(wanted - time[before]) <= END_S)
    near |= (np.abs(wanted - time[before]) == 0.0) | (np.abs(wanted - time[after]) == 0.0)
    return np.where(near, np.interp(wanted, time, values), np.nan)


def filled(frame: pd.DataFrame, others: Iterable[pd.DataFrame] = ()) -> pd.DataFrame:
    """The table with a number of every sensor in every row.

    An unknown reading is replaced by the mean of the known ones of this table or, without any, of the ``others`` of the
    same campaign. Such a row does not determine the dependence on temperature. A sensor without readings is left out.
    """
    tables = [frame, *others]
    names = dict.fromkeys(name for table in tables for name in temperature_columns(map(str, table.columns)))
    columns, gone = {}, []
    for name in names:
        own = readings(frame, name) if name in frame else (np.full(len(frame), np.nan), np.zeros(len(frame), bool))
        if own[1].all() and len(frame):
            columns[name] = own[0]
            continue
        means = [float(np.mean(v[k])) for t in tables if name in t for v, k in [readings(t, name)] if k.any()]
        if means:
            columns[name] = np.where(own[1], own[0], means[0])
        else:
            gone.append(name)
    return frame.drop(columns=[name for name in gone if name in frame]).assign(**columns)
