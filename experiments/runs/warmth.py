"""Whether a robot that warms up has become steady, from the temperatures of the rows so far.

A sensor's temperature less that of the air (column ``temp_ambient_C``, where there is one) is followed over `WINDOW`.
It is steady where the slope of a straight line through it is below the limit. All sensors have to be steady at every
row for as long as the plan says. With a reading error s and n rows over the window W the slope has a standard error of
s·√(12/n)/W: 0.1 K/h with 0.1 K and 12 rows in an hour.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from experiments.plans.model import Steady
from experiments.plans.motion import Array

__all__ = ["steady_since", "steady_words"]

WINDOW = 3600.0  # s: an hour, over which noise of sensors is small against the slopes that count
MIN_ROWS = 4  # rows in it
FULL = 0.8  # of the window that rows have to span
AIR = "temp_ambient_C"


def steady_words(entries: Iterable[Mapping[str, Any]], wanted: Steady) -> str | None:
    """Why warming up may end, or None."""
    rows = [entry["row"] for entry in entries if entry["what"] == "row"]
    names = [name for name in (rows[-1] if rows else {}) if name.startswith("temp_") and name != AIR]
    if not names:
        return None
    rows = [row for row in rows if all(name in row for name in names)]
    time = np.array([row["time_s"] for row in rows], dtype=np.float64)
    air = np.array([row.get(AIR, np.nan) for row in rows], dtype=np.float64)
    warm = np.array([[row[name] for name in names] for row in rows], dtype=np.float64)
    since = steady_since(time, warm - air[:, None] if np.all(np.isfinite(air)) else warm, wanted.rate)
    if since is None or time[-1] - since < wanted.beyond:
        return None
    against = " against the air" if np.all(np.isfinite(air)) else ""
    return (
        f"Warm: all {len(names)} temperatures changed by less than {wanted.rate:g} K/h{against} for "
        f"{(time[-1] - since) / 3600:.1f} h."
    )


def steady_since(time: Array, temperature: Array, rate: float) -> float | None:
    """From when on all temperatures ``(N, k)``, K, at times ``(N,)``, s, change by less than ``rate``, K/h; or None."""
    since = None
    for now in range(len(time) - 1, -1, -1):
        own = (time > time[now] - WINDOW) & (time <= time[now])
        t = (time[own] - time[own].mean()) / 3600.0
        if own.sum() < MIN_ROWS or time[now] - time[own].min() < FULL * WINDOW:
            break
        slope = t @ (temperature[own] - temperature[own].mean(axis=0)) / (t @ t)
        if np.any(np.abs(slope) >= rate):
            break
        since = float(time[now])
    return since
