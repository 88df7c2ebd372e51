"""Judges further columns of poses: which are variables for effects, and why the others are not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from experiments.campaign import Campaign
from experiments.checks.finding import Finding
from experiments.columns import OF_OTHER_USE, POSES, further_columns, table_format
from experiments.further import numbers

__all__ = ["further_findings", "further_variables"]


def further_variables(campaign: Campaign, table: str) -> list[str]:
    """The further columns of a table of poses that vary, so that effects can depend on them; of logs none.

    Parameters
    ----------
    campaign
        The campaign.
    table
        One of its tables.
    """
    if table not in POSES:
        return []
    frame = campaign.tables[table]
    names = further_columns(map(str, frame.columns), table, campaign.robot.n)
    return [name for name in names if _varies(frame[name])]


def further_findings(campaign: Campaign) -> Iterator[Finding]:
    """Look at the further columns of poses.

    Yields
    ------
    Finding
        Warnings for columns without any number, notes on constant ones, on single cells without a number, and on names
        without a unit.
    """
    n = campaign.robot.n
    for table in POSES:
        frame = campaign.tables.get(table)
        if frame is None:
            continue
        names = tuple(map(str, frame.columns))
        further, known = further_columns(names, table, n), table_format(table, n).known()
        for name in further:
            yield from _cells(table, name, frame[name])
        for name in names:
            if name not in (*known, *further) and not name.startswith(OF_OTHER_USE) and _varies(frame[name]):
                message = f"no effect can depend on {name}: a further column's name ends in its unit, as flow_m_s"
                yield Finding("note", table, name, None, message)


def _cells(table: str, name: str, column: pd.Series) -> Iterator[Finding]:
    values = numbers(column)
    empty = np.flatnonzero(np.isnan(values))
    if len(empty) == len(values):
        message = f"no effect can depend on {name}: no cell has a finite number"
        text = [row for row, cell in enumerate(column) if isinstance(cell, str) and not _is_number(cell)]
        if text:
            message = f"no effect can depend on {name}: a number is expected, found {column.iloc[text[0]]!r}"
        yield Finding("warning", table, name, text[0] + 1 if text else None, message)
    elif not _varies(column):
        message = f"no effect can depend on {name}: it is {values[~np.isnan(values)][0]:g} in every row"
        yield Finding("note", table, name, None, message)
    elif len(empty):
        rows = "1 row has" if len(empty) == 1 else f"{len(empty)} rows have"
        message = f"{rows} no finite number, first row {empty[0] + 1}; the mean of the others stands in"
        yield Finding("note", table, name, int(empty[0]) + 1, message)


def _varies(column: pd.Series) -> bool:
    values = numbers(column)
    known = values[~np.isnan(values)]
    return bool(known.size and np.ptp(known) > 0.0)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return not cell.strip()
    return True
