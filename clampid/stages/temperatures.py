"""Temperatures that a table recorded, as signals."""

from __future__ import annotations

import numpy as np

from clampid.stages.rows import Array, Bools
from experiments.temperatures import REFERENCE_TEMPERATURE, readings

__all__ = ["link_recorded", "temperatures"]


def temperatures(table: object, n: int) -> dict[str, Array]:
    """Temperatures of links and motors less 20 degC, ``(N, n)``; zeros where no sensor is.

    The table is one that :func:`experiments.temperatures.filled` has filled, or several of them one after the other, of
    which one without a sensor leaves its rows empty.
    """
    out = {}
    for kind in ("link", "motor"):
        values = np.zeros((len(table), n))  # type: ignore[arg-type]
        for i in range(n):
            column = f"temp_{kind}{i + 1}_C"
            if column in table.columns:  # type: ignore[attr-defined]
                values[:, i] = np.nan_to_num(table[column].to_numpy(float) - REFERENCE_TEMPERATURE)  # type: ignore[index]
        out[f"{kind}_temperature"] = values
    return out


def link_recorded(table: object, n: int) -> Bools:
    """Where a sensor gave a link's temperature ``(N, n)``; the table is one that has not been filled."""
    nowhere = np.full(len(table), False)  # type: ignore[arg-type]
    columns = (f"temp_link{i + 1}_C" for i in range(n))
    sensors = (readings(table, c)[1] if c in table.columns else nowhere for c in columns)  # type: ignore[arg-type, attr-defined]
    return np.column_stack(list(sensors))
