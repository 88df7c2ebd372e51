"""Judges whether temperatures are in °C, which are missing, and whether effects can be identified from them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from experiments.campaign import Campaign
from experiments.checks.finding import Finding
from experiments.columns import temperature_columns
from experiments.temperatures import COLDEST_C, END_S, GAP_S, HOTTEST_C, readings

__all__ = ["temperature_findings"]

# Robots are allowed surroundings of up to 45 or 55 °C; those of a cool workshop, 15 °C, are 59 °F.
WARMEST_SURROUNDINGS_C = 55.0


def temperature_findings(campaign: Campaign) -> Iterator[Finding]:
    """Look at every table's temperatures.

    Yields
    ------
    Finding
        Errors for other units, warnings for readings that are not known, notes on short gaps and on what they identify.
    """
    for table, frame in campaign.tables.items():
        names = temperature_columns(map(str, frame.columns))
        for name in names:
            yield from _unit(table, name, frame)
            yield from _gaps(table, name, frame, table in campaign.long)
        if table == "poses" and names and not any(name.startswith("temp_link") for name in names):
            message = (
                f"no temperature sensor is on a link ({', '.join(names)} is not): expansion of the links is tested "
                "against time, not temperature"
            )
            yield Finding("note", table, names[0], None, message)


def _unit(table: str, name: str, frame: pd.DataFrame) -> Iterator[Finding]:
    values = frame[name].to_numpy(dtype=np.float64, na_value=np.nan)
    known = values[np.isfinite(values)]
    bad = np.flatnonzero((values > HOTTEST_C) | (values < COLDEST_C))
    if bad.size:
        row = int(bad[0])
        reason = f"{values[row]:g} in row {row + 1}, {bad.size} rows in all outside {COLDEST_C:g} … {HOTTEST_C:g} °C"
        # Workshops are at 273 … 320 K, motors below 393 K.
        kelvin = 250.0 < float(np.median(known)) < 400.0
        words = "temperatures look like kelvin, °C are expected" if kelvin else "implausible temperatures"
        yield Finding("error", table, name, row + 1, f"{words}: {reason}")
    elif "ambient" in name and known.size and float(np.median(known)) > WARMEST_SURROUNDINGS_C:
        message = (
            f"temperatures look like Fahrenheit, °C are expected: surroundings of {np.median(known):.3g} (median), "
            f"where robots may not work above {WARMEST_SURROUNDINGS_C:g} °C"
        )
        yield Finding("error", table, name, None, message)
    elif name.startswith("temp_link") and known.size and float(known.min()) > WARMEST_SURROUNDINGS_C:
        message = (
            f"never below {known.min():.3g}, while surroundings are not above {WARMEST_SURROUNDINGS_C:g} °C: is it in "
            "Fahrenheit? °C are expected"
        )
        yield Finding("warning", table, name, None, message)


def _gaps(table: str, name: str, frame: pd.DataFrame, extract: bool) -> Iterator[Finding]:
    """What is missing; of an extract of a long log, whose gaps are refused, nothing is."""
    read = np.isfinite(frame[name].to_numpy(dtype=np.float64, na_value=np.nan))
    if read.all() or extract:
        return
    first = int(np.flatnonzero(~read)[0]) + 1
    if not read.any():
        yield Finding("warning", table, name, None, f"{name} has no reading: the column is ignored")
        return
    values, known = readings(frame, name)
    bridged, lost = int((known & ~read).sum()), int((~known).sum())
    if bridged:
        rows = "row has" if bridged == 1 else "rows have"
        message = f"{bridged} {rows} no reading, first row {first}; interpolated in time over gaps up to {GAP_S:g} s"
        yield Finding("note", table, name, first, message)
    if lost:
        row = int(np.flatnonzero(~known)[0]) + 1
        message = (
            f"{lost} of {len(frame)} rows have no reading within {GAP_S:g} s ({END_S:g} s at the ends); first {row}: "
            f"they get the mean of the others, {np.mean(values[known]):.1f} °C, and count as not recorded; leave them "
            "out if the temperature changed there"
        )
        yield Finding("warning", table, name, row, message)
