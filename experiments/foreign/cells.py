"""Cells of text as numbers, counts, names and times, with errors that name file, row and column."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from experiments.errors import CampaignError
from experiments.foreign.files import Cells
from experiments.foreign.mapping import Source

__all__ = ["counts", "dates", "labels", "numbers"]

FloatArray = npt.NDArray[np.float64]
Texts = npt.NDArray[np.object_]

LARGEST_WHOLE = 2**53  # from here on neighbouring numbers are the same float; such cells are compared as text
MINUS = str.maketrans({"\u2212": "-", "\u2013": "-", "\u00a0": ""})  # signs that word processors put for a hyphen
# What programs write where there is no reading; only sensors may have none.
EMPTY_CELLS = ("", "nan", "na", "n/a", "null", "none", "-", "--", "---")


def numbers(cells: Cells, at: int, *, gaps: bool = False) -> FloatArray:
    """A column as numbers ``(rows,)``.

    Parameters
    ----------
    at
        Position of the column.
    gaps
        Whether cells may be empty, or say nan: not a number.

    Raises
    ------
    CampaignError
        A cell is no finite number.
    """
    reading = cells.readings[at]
    texts = [text if text.isascii() else text.translate(MINUS) for text in map(str, cells.columns[at])]
    if reading.thousands:
        texts = [text.replace(reading.thousands, "") for text in texts]
    if reading.decimal == ",":
        texts = ["?" if "." in text else text.replace(",", ".") for text in texts]
    values = np.asarray(pd.to_numeric(np.array(texts, dtype=object), errors="coerce"), dtype=np.float64)
    bad = ~np.isfinite(values)
    if gaps and bad.any():
        bad &= np.array([text.strip().lower() not in EMPTY_CELLS for text in texts], dtype=bool)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        expected = "a number" + (" with a decimal comma" if reading.decimal == "," else "")
        raise _wrong(cells, at, row, expected, int(bad.sum()))
    return values


def counts(cells: Cells, at: int, name: str) -> npt.NDArray[np.int64]:
    """Whole numbers as they are, names numbered from 1 in the order in which they first come; directions -1, 0, 1.

    Raises
    ------
    CampaignError
        A cell is empty, or of a direction or driven joint no whole number.
    """
    texts = pd.Series(cells.columns[at]).astype(str)
    empty = (texts == "").to_numpy()
    if empty.any():
        raise _wrong(cells, at, int(np.flatnonzero(empty)[0]), "a number or a name", int(empty.sum()))
    values = pd.to_numeric(texts, errors="coerce").to_numpy(dtype=np.float64)
    whole = np.isfinite(values) & (values == np.round(values)) & (np.abs(values) < LARGEST_WHOLE)
    if whole.all():
        return values.astype(np.int64)
    if name.startswith("dir") or name == "joint":
        row = int(np.flatnonzero(~whole)[0])
        raise _wrong(cells, at, row, "-1, 0 or 1" if name != "joint" else "a joint's number", int((~whole).sum()))
    return np.asarray(pd.factorize(texts)[0] + 1, dtype=np.int64)


def labels(cells: Cells, at: int) -> Texts:
    """Names as they are.

    Raises
    ------
    CampaignError
        A cell is empty.
    """
    empty = cells.columns[at] == ""
    if empty.any():
        raise _wrong(cells, at, int(np.flatnonzero(empty)[0]), "a name", int(empty.sum()))
    return cells.columns[at]


def dates(cells: Cells, source: Source, mapping: Path) -> FloatArray:
    """Dates and times ``(rows,)`` as seconds from a fixed one; those of several columns are joined with spaces.

    Raises
    ------
    CampaignError
        A cell is no date, or clocks without a date pass midnight.
    """
    places = [cells.find(column, mapping, source.key) for column in source.columns]
    first, out = places[0], np.empty(len(cells))
    for row in range(len(cells)):
        text = " ".join(str(cells.columns[at][row]) for at in places).strip()
        try:
            when = datetime.strptime(text, source.pattern) if source.pattern else datetime.fromisoformat(text)
        except ValueError:
            pattern = f"a time like {source.pattern!r}" if source.pattern else "a time as 2026-11-23T14:05:06"
            hint = "" if source.pattern else "; pattern = … says otherwise"
            raise cells.origins[first].fault(
                row, expected=f"{pattern} ({source.key}{hint})", found=repr(text), column=cells.names[first]
            ) from None
        # Both kinds on one scale of their own: only differences count, and summer time must not make an hour.
        zone = when.utcoffset()
        seconds = (when.replace(tzinfo=None) - datetime(1900, 1, 1)).total_seconds()
        out[row] = seconds - (zone.total_seconds() if zone else 0.0)
    if source.pattern and "%d" not in source.pattern and "%j" not in source.pattern:
        back = np.flatnonzero(np.diff(out) < -43200.0)
        if back.size:
            raise cells.origins[first].fault(
                int(back[0]) + 1, expected="a date with the time of day, since the clock passes midnight",
                found=repr(str(cells.columns[first][back[0] + 1])), column=cells.names[first],
            )  # fmt: skip
    return out


def _wrong(cells: Cells, at: int, row: int, expected: str, count: int) -> CampaignError:
    text = str(cells.columns[at][row])
    found = "an empty cell" if not text else "the line of names again" if text == cells.names[at] else repr(text)
    found += f" (and {count - 1} more such rows)" if count > 1 else ""
    return cells.origins[at].fault(row, expected=expected, found=found, column=cells.names[at])
