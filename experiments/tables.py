"""Reads one table of a campaign from CSV or Parquet; errors name the line of the wrong row."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pa_parquet

from experiments.errors import CampaignError, fault
from kinematics.reading import read_bytes

__all__ = ["TableFile", "read_table", "refuse_duplicates"]


SMALL_TABLE = 1 << 20  # bytes; columns of smaller tables are converted faster than threads are started
MAX_CSV_BYTES = 2_000_000_000  # of a table as text; longer logs are Parquet


@dataclass(frozen=True)
class TableFile:
    """A table as a file, or a piece of one from row ``first`` on: knows how to point at one of its cells."""

    path: Path
    first: int = 0

    def fault(self, *, expected: str, found: str, row: int | None = None, column: str | None = None) -> CampaignError:
        """Word an error about this file.

        Parameters
        ----------
        expected, found
            What the contract wants and what is there.
        row
            0-based position in the table; the message counts from 1, and names the line of a CSV file.
        column
            Column name.

        Returns
        -------
        CampaignError
            To be raised by the caller.
        """
        number = None if row is None else self.number(row)
        line = self._line(row) if row is not None else None
        return fault(self.path, expected=expected, found=found, row=number, line=line, column=column)

    def number(self, row: int) -> int:
        """The file's number, from 1, of a row of the piece from 0."""
        return self.first + row + 1

    def cell(self, row: int, column: str, value: object) -> str:
        """Show what stands in one cell, as the user would see it in the file.

        Parameters
        ----------
        row
            0-based position in the table.
        column
            Column name.
        value
            What was read there; for CSV the text of the file is shown instead, since NaN may have been an empty cell.

        Returns
        -------
        str
            The text in quotes, ``an empty cell``, or the value.
        """
        if self.path.suffix == ".csv":
            records = _records(self.path, _decoded(self.path))
            _, header = next(records)
            for position, (_, record) in enumerate(records):
                if position == row:
                    text = record[header.index(column)]
                    if text.strip() == column:
                        return "the line of names again"
                    return f"{text!r}" if text.strip() else "an empty cell"
        if value is None or value is pd.NaT or value is pd.NA:
            return "an empty cell"
        return f"{value}" if isinstance(value, float) else f"{value!r}"

    def _line(self, row: int) -> int | None:
        if self.path.suffix != ".csv":
            return None
        for position, (line, _) in enumerate(_records(self.path, _decoded(self.path)), start=-1):
            if position == row:
                return line
        return None


def read_table(path: Path) -> pd.DataFrame:
    """Read a table as it stands, without judging its columns.

    Parameters
    ----------
    path
        A ``.csv`` or ``.parquet`` file.

    Returns
    -------
    pandas.DataFrame
        One row per data row, in the file's order, with a plain row index.

    Raises
    ------
    CampaignError
        If the file is missing, empty, of another kind, not UTF-8, damaged, without rows, or names a column twice.
    """
    if not path.exists():
        raise fault(path, expected="the file that campaign.toml names", found="no such file")
    if not path.is_file():
        raise fault(path, expected="a file", found="a folder" if path.is_dir() else "a device or pipe")
    if path.suffix not in (".csv", ".parquet"):
        raise fault(path, expected="a table ending in .csv or .parquet", found=f"{path.suffix or 'no ending'}")
    if path.stat().st_size == 0:
        raise fault(path, expected="a table with a header line and rows", found="an empty file")
    arrow = _read_csv(path) if path.suffix == ".csv" else _read_parquet(path)
    if arrow.num_rows == 0:
        raise fault(path, expected="at least one row", found="a header and no rows")
    # Without pandas' own metadata: an index saved by to_parquet comes back as a column, as in a CSV file.
    try:
        frame: pd.DataFrame = arrow.to_pandas(ignore_metadata=True, use_threads=arrow.nbytes > SMALL_TABLE)
    except (pa.ArrowException, ValueError, OverflowError) as error:
        found = str(error).strip().splitlines()[0]
        raise fault(path, expected="columns of numbers, times or text", found=found) from error
    return frame


def _read_parquet(path: Path) -> pa.Table:
    try:
        # Opened here, so that no directory scan or file mapping outlives the call.
        with path.open("rb") as stream:
            table = pa_parquet.read_table(stream, use_threads=path.stat().st_size > SMALL_TABLE)
        names = table.column_names  # of another encoding than UTF-8, if the file is damaged
    except (pa.ArrowException, OSError, ValueError, OverflowError) as error:
        reason = str(error).strip().splitlines()[0]
        raise fault(path, expected="a whole Parquet file", found=f"a truncated or damaged one ({reason})") from error
    refuse_duplicates(path, names)
    for column in table.schema:
        if pa.types.is_nested(column.type):
            raise fault(path, expected="a number or a text in each cell", found=str(column.type), column=column.name)
    return table


def _read_csv(path: Path) -> pa.Table:
    text = _decoded(path)
    if not text.strip():
        raise fault(path, expected="a table with a header line and rows", found="an empty file")
    _, header = next(_records(path, text))
    if len(header) == 1:
        for separator, name in ((";", "semicolons"), ("\t", "tabs")):
            if separator in header[0]:
                raise fault(path, expected="columns separated by commas", found=name, line=1)
    refuse_duplicates(path, header)
    data = text.encode()
    # Arrow guesses a column's type from the first block only; with one block, an odd cell far down makes the column
    # text, and can then be named, instead of failing the whole conversion.
    block = min(max(len(data) + 1, 1 << 20), 2**31 - 1)
    options = pa_csv.ReadOptions(block_size=block, use_threads=len(data) > SMALL_TABLE)
    try:
        return pa_csv.read_csv(pa.BufferReader(data), read_options=options)
    except pa.ArrowException as error:
        for position, (line, record) in enumerate(_records(path, text)):
            if len(record) != len(header):
                expected = f"{len(header)} cells, as the header has"
                raise fault(path, expected=expected, found=f"{len(record)}", row=position, line=line) from error
        raise fault(path, expected="comma-separated rows", found=str(error)) from error


def _decoded(path: Path) -> str:
    data = b""
    try:
        data = read_bytes(path, MAX_CSV_BYTES)
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        found = f"byte 0x{data[error.start]:02x} at offset {error.start}"
        raise fault(path, expected="UTF-8 text", found=found, line=line) from error
    except OSError as error:
        raise fault(path, expected="a table as text", found=error.strerror or str(error)) from error


def _records(path: Path, text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield (line, cells) of every line that is not blank; the first is the header."""
    reader = csv.reader(io.StringIO(text))
    try:
        for record in reader:
            if record:
                yield reader.line_num, record
    except csv.Error as error:  # a cell of more than 131 072 characters, a carriage return alone
        found = str(error).partition(" - ")[0]
        raise fault(path, expected="lines of cells as CSV has them", found=found, line=reader.line_num + 1) from error


def refuse_duplicates(path: Path, names: Sequence[str]) -> None:
    """Refuse a table that names a column twice.

    Raises
    ------
    CampaignError
        It does.
    """
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        positions = [i + 1 for i, name in enumerate(names) if name == twice[0]]
        found = f"{twice[0]!r} as columns {', '.join(map(str, positions))}"
        raise fault(path, expected="every column name once", found=found, column=twice[0])
