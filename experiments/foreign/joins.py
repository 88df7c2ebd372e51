"""Puts the columns of a second file beside those of a table: by a column of both, or in order."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from experiments.errors import fault
from experiments.foreign.files import Cells, read_cells
from experiments.foreign.mapping import Join

__all__ = ["joined"]

Positions = npt.NDArray[np.intp]


def joined(cells: Cells, join: Join, mapping: Path) -> Cells:
    """The table with the columns of a join's files.

    Raises
    ------
    CampaignError
        A row of the table has no counterpart or several, or the numbers of rows do not go together.
    """
    other = read_cells(join.files, join.reading)
    key = join.key
    if join.on is not None:
        left, right = cells.find(join.on[0], mapping, key), other.find(join.on[1], mapping, key)
        index, note = _by_value(cells, left, other, right)
    else:
        index, note = _in_order(cells, other, str(join.order), mapping, key)
    names = tuple(join.prefix + name for name in other.names)
    beside = other.take(index)
    return replace(
        cells,
        names=(*cells.names, *names),
        columns=(*cells.columns, *beside.columns),
        origins=(*cells.origins, *beside.origins),
        readings=(*cells.readings, *beside.readings),
        notes=(*cells.notes, *other.notes, *([note] if note else [])),
    )


def _by_value(cells: Cells, left: int, other: Cells, right: int) -> tuple[Positions, str | None]:
    wanted, there = _keys(cells.columns[left], other.columns[right])
    twice = pd.Series(there).duplicated().to_numpy()
    file, name = other.origins[right], other.names[right]
    if twice.any():
        row = int(np.flatnonzero(twice)[0])
        first = int(np.flatnonzero(there == there[row])[0])
        found = f"{other.columns[right][row]!r} again, as in {file.words(first)}"
        raise file.fault(row, expected="every value once, to join by", found=found, column=name)
    place = {value: i for i, value in enumerate(there)}
    index = np.array([place.get(value, -1) for value in wanted], dtype=np.intp)
    if (index < 0).any():
        row = int(np.flatnonzero(index < 0)[0])
        lost = len(set(wanted[index < 0]))
        expected = f"a value that column {name} of {file.files[0].name} has, such as {other.columns[right][0]!r}"
        found = repr(cells.columns[left][row]) + (f" (and {lost - 1} more such values)" if lost > 1 else "")
        raise cells.origins[left].fault(row, expected=expected, found=found, column=cells.names[left])
    idle = np.setdiff1d(np.arange(len(other)), index)
    if not idle.size:
        return index, None
    return (
        index,
        f"{file.files[0]}: {idle.size} of {len(other)} rows belong to no row of {cells.origins[left].files[0]}",
    )


def _keys(left: npt.NDArray[np.object_], right: npt.NDArray[np.object_]) -> tuple[npt.NDArray[np.object_], ...]:
    """The cells to compare: as numbers where all are, so that 7, 07 and 7.0 are the same, else as text."""
    numbers = [pd.to_numeric(pd.Series(side), errors="coerce") for side in (left, right)]
    if all(side.notna().all() for side in numbers):
        return tuple(side.to_numpy(dtype=object) for side in numbers)
    return left, right


def _in_order(cells: Cells, other: Cells, order: str, mapping: Path, key: str) -> tuple[Positions, str | None]:
    file = other.origins[0].files[0]
    if order == "rows":
        index, what = np.arange(len(cells), dtype=np.intp), "rows"
    else:
        values = cells.columns[cells.find(order, mapping, key)]
        index, what = np.asarray(pd.factorize(values)[0], dtype=np.intp), f"different values in its column {order}"
    count = int(index.max()) + 1
    if count != len(other):
        main = cells.origins[0].files[0]
        raise fault(file, expected=f"{count} rows, as {main.name} has {what}", found=f"{len(other)}")
    return index, None
