"""Temperatures that a table recorded, as signals: of links, motors, the surroundings, and of any other sensor."""

from __future__ import annotations

import re

import numpy as np

from clampid.stages.rows import Array, Bools, Rows
from experiments.columns import temperature_columns
from experiments.temperatures import REFERENCE_TEMPERATURE, readings

__all__ = ["link_recorded", "reads_temperatures", "shared_temperatures", "temperatures"]

AMBIENT = "temp_ambient_C"


def temperatures(table: object, n: int) -> dict[str, Array]:
    """Temperatures less 20 degC: of links and motors ``(N, n)``, of the surroundings and of other sensors ``(N,)``.

    Zeros where no sensor is; a sensor ``temp_<where>_C`` of no link, motor or the surroundings is ``temp_<where>``. The
    table is one that :func:`experiments.temperatures.filled` has filled, or several of them one after the other, of
    which one without a sensor leaves its rows empty.
    """
    columns = [str(c) for c in table.columns]  # type: ignore[attr-defined]
    nowhere = np.zeros(len(table))  # type: ignore[arg-type]

    def above(column: str) -> Array:
        if column not in columns:
            return nowhere
        return np.asarray(np.nan_to_num(table[column].to_numpy(float) - REFERENCE_TEMPERATURE))  # type: ignore[index]

    out = {
        f"{kind}_temperature": np.column_stack([above(f"temp_{kind}{i + 1}_C") for i in range(n)])
        for kind in ("link", "motor")
    }
    out["ambient_temperature"] = above(AMBIENT)
    own = {AMBIENT, *(f"temp_{kind}{i + 1}_C" for kind in ("link", "motor") for i in range(n))}
    return out | {c.removesuffix("_C"): above(c) for c in temperature_columns(columns) if c not in own}


def shared_temperatures(rows: Rows) -> dict[str, Array]:
    """Temperatures ``(N,)``, K, that belong to no single link or motor, by ``temp_<where>``, the surroundings first."""
    others = {name: values for name, values in rows.signals.items() if name.startswith("temp_")}
    return {"temp_ambient": rows.signals["ambient_temperature"], **others}


def reads_temperatures(signal: str) -> bool:
    """Whether a signal is one of :func:`temperatures`."""
    return re.fullmatch(r"(link|motor|ambient)_temperature|temp_\w+", signal) is not None


def link_recorded(table: object, n: int) -> Bools:
    """Where a sensor gave a link's temperature ``(N, n)``; the table is one that has not been filled."""
    nowhere = np.full(len(table), False)  # type: ignore[arg-type]
    columns = (f"temp_link{i + 1}_C" for i in range(n))
    sensors = (readings(table, c)[1] if c in table.columns else nowhere for c in columns)  # type: ignore[arg-type, attr-defined]
    return np.column_stack(list(sensors))
