"""Reads text tables of any encoding and separator into cells that know their file, row and line."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from experiments.errors import CampaignError, fault
from kinematics.reading import read_bytes

__all__ = ["Cells", "Origin", "Reading", "read_cells"]

Integers = npt.NDArray[np.int64]
Texts = npt.NDArray[Any]  # of str

DELIMITERS = {"tab": "\t", "space": " "}
NAMED = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "spaces"}
# Files that are no text, by their first bytes.
BINARY = {
    b"PK\x03\x04": "an Excel workbook or another archive",
    b"PAR1": "a Parquet file",
    b"\xd0\xcf\x11\xe0": "Excel",
}


MAX_FILE_BYTES = 500_000_000  # whose cells are held as text


@dataclass(frozen=True)
class Reading:
    """How the text of a file becomes cells.

    Attributes
    ----------
    encoding
        Python's name of it, or None: by the byte order mark, else UTF-8, else Windows-1252.
    delimiter, decimal, thousands
        One character each (``thousands`` may be empty); a delimiter of one space stands for any number of spaces and
        tabs.
    skip_lines, skip_after_names
        Lines before and after the line of names.
    comment
        What lines begin with that are left out.
    names
        The columns' names where the file has no line of names.
    """

    encoding: str | None = None
    delimiter: str = ","
    decimal: str = "."
    thousands: str = ""
    skip_lines: int = 0
    skip_after_names: int = 0
    comment: tuple[str, ...] = ()
    names: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Origin:
    """Where the rows of a table come from: files, and for each row ``(rows,)`` its file, row and line from 1."""

    files: tuple[Path, ...]
    file: Integers
    row: Integers
    line: Integers

    def fault(self, at: int, *, expected: str, found: str, column: str | None = None) -> CampaignError:
        """An error about one row, 0-based position in the table."""
        file = self.files[int(self.file[at])]
        row, line = int(self.row[at]), int(self.line[at])
        return fault(file, expected=expected, found=found, row=row, line=line, column=column)

    def take(self, index: npt.NDArray[np.intp]) -> Origin:
        """Those rows, in that order."""
        return Origin(self.files, self.file[index], self.row[index], self.line[index])

    def words(self, at: int) -> str:
        """``points.txt, row 3 (line 5)``."""
        return f"{self.files[int(self.file[at])]}, row {self.row[at]} (line {self.line[at]})"


@dataclass(frozen=True)
class Cells:
    """The cells of a table as text, column by column, with where each column's cells come from.

    Attributes
    ----------
    names
        Of the columns; a name may come twice, as instruments write nominal and measured X, Y, Z.
    columns
        ``(rows,)`` each.
    origins, readings
        Of each column.
    notes
        What a person should know of how the files were read.
    """

    names: tuple[str, ...]
    columns: tuple[Texts, ...]
    origins: tuple[Origin, ...]
    readings: tuple[Reading, ...]
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.columns[0])

    def find(self, column: str | int, mapping: Path, key: str) -> int:
        """Position of a column by its name, or its number from 1.

        Raises
        ------
        CampaignError
            There is none, or there are several of that name.
        """
        file = self.origins[0].files[0]
        if isinstance(column, int):
            if not 1 <= column <= len(self.names):
                raise fault(file, expected=f"at least {column} columns, as {mapping.name} says in {key}",
                            found=f"{len(self.names)}")  # fmt: skip
            return column - 1
        found = [i for i, name in enumerate(self.names) if name == column]
        if len(found) > 1:
            numbers = ", ".join(str(i + 1) for i in found)
            raise fault(file, expected=f"one column {column!r}, as {mapping.name} says in {key}",
                        found=f"columns {numbers} of that name (from = {found[0] + 1} takes the first)")  # fmt: skip
        if not found:
            raise fault(file, expected=f"a column {column!r}, as {mapping.name} says in {key}",
                        found=f"the columns {', '.join(self.names)}{self._hint()}")  # fmt: skip
        return found[0]

    def take(self, index: npt.NDArray[np.intp]) -> Cells:
        """Those rows, in that order."""
        return replace(
            self, columns=tuple(c[index] for c in self.columns), origins=tuple(o.take(index) for o in self.origins)
        )

    def _hint(self) -> str:
        if len(self.names) > 1:
            return ""
        inside = [words for sign, words in NAMED.items() if sign in self.names[0] and sign != " "]
        return f" (one column: is the delimiter {inside[0]}?)" if inside else ""


def read_cells(files: Sequence[Path], reading: Reading) -> Cells:
    """Read files of the same columns, one after the other.

    Raises
    ------
    CampaignError
        A file is missing, no text, has no rows, a row has more or fewer cells than there are names, or a file has other
        columns than the first.
    """
    names: tuple[str, ...] | None = None
    rows: list[list[str]] = []
    places: list[tuple[int, int, int]] = []
    notes: list[str] = []
    for k, file in enumerate(files):
        text, note = _decoded(file, reading.encoding)
        notes += [note] if note else []
        own, records = _records(file, text, reading)
        if names is not None and own != names:
            raise fault(file, expected=f"the columns of {files[0].name}: {', '.join(names)}", found=", ".join(own))
        names = own
        before = len(rows)
        for line, record in records:
            rows.append(_fitted(file, record, len(own), len(rows) - before + 1, line))
            places.append((k, len(rows) - before, line))
        if len(rows) == before:
            raise fault(file, expected="at least one row", found="a line of names and no rows")
    table = np.array(rows, dtype=object).reshape(len(rows), len(names or ()))
    file_of, row, line_of = np.array(places, dtype=np.int64).T
    origin = Origin(tuple(files), file_of, row, line_of)
    width = len(names or ())
    return Cells(names or (), tuple(table.T), (origin,) * width, (reading,) * width, tuple(notes))


def _decoded(file: Path, encoding: str | None) -> tuple[str, str | None]:
    """A file's text, and what to say of how it was read."""
    try:
        data = read_bytes(file, MAX_FILE_BYTES)
    except FileNotFoundError:
        raise fault(file, expected="a table", found="no such file") from None
    except OSError as error:
        raise fault(file, expected="a table", found=error.strerror or str(error)) from error
    for head, what in BINARY.items():
        if data.startswith(head):
            raise fault(file, expected="a table as text (save it as CSV)", found=what)
    if encoding is not None:
        try:
            return data.decode(encoding).removeprefix("\ufeff"), None
        except UnicodeDecodeError as error:
            raise _undecodable(file, data, error, encoding) from error
        except (LookupError, UnicodeError) as error:
            raise fault(file, expected="an encoding of text", found=f"{encoding!r} ({error})") from error
    guess = _marked(data)
    try:
        return data.decode(guess).removeprefix("\ufeff"), None
    except UnicodeDecodeError as error:
        if guess != "utf-8":
            raise _undecodable(file, data, error, guess) from error
        byte, line = data[error.start], data.count(b"\n", 0, error.start) + 1
        note = (
            f"{file}: byte 0x{byte:02x} in line {line} is not UTF-8; read as Windows-1252 (encoding = … says otherwise)"
        )
        return data.decode("cp1252", errors="replace"), note


def _marked(data: bytes) -> str:
    """The encoding that a byte order mark says, or that zero bytes between Latin letters give away; else UTF-8."""
    if data.startswith((b"\xff\xfe\x00\x00", b"\x00\x00\xfe\xff")):
        return "utf-32"
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    head = data[:1000]
    if head.count(0) > len(head) // 4:
        return "utf-16-le" if head[1::2].count(0) > head[::2].count(0) else "utf-16-be"
    return "utf-8"


def _undecodable(file: Path, data: bytes, error: UnicodeDecodeError, encoding: str) -> CampaignError:
    found = f"byte 0x{data[error.start]:02x} at offset {error.start}"
    return fault(file, expected=f"{encoding} text", found=found, line=data.count(b"\n", 0, error.start) + 1)


def _records(file: Path, text: str, reading: Reading) -> tuple[tuple[str, ...], Iterator[tuple[int, list[str]]]]:
    """Names of the columns, and (line, cells) of each row."""
    lines = enumerate(re.split(r"\r\n|\r|\n", text), start=1)
    kept = [(number, line) for number, line in lines if number > reading.skip_lines and _counts(line, reading)]
    if reading.names is None:
        if not kept:
            raise fault(file, expected="a line of names and rows", found="nothing after the lines that are left out")
        names = [name.strip() for name in _cells(file, *kept[0], reading)]
        while names and not names[-1]:
            names.pop()  # a line that ends with a delimiter
        kept = kept[1:]
    else:
        names = list(reading.names)
    body = kept[reading.skip_after_names :]
    return tuple(names), ((number, _cells(file, number, line, reading)) for number, line in body)


def _counts(line: str, reading: Reading) -> bool:
    """Whether a line is neither blank nor a comment."""
    bare = line.strip().strip(reading.delimiter).strip()
    return bool(bare) and not (reading.comment and line.lstrip().startswith(reading.comment))


def _cells(file: Path, number: int, line: str, reading: Reading) -> list[str]:
    try:
        return _split(line, reading)
    except csv.Error as error:
        raise fault(file, expected="cells of a table", found=str(error), line=number) from error


def _split(line: str, reading: Reading) -> list[str]:
    if reading.delimiter == " ":
        line = line.replace("\t", " ").strip()
    if '"' not in line and len(line) < csv.field_size_limit():  # a reader for each line costs more than the line
        parts = line.split(reading.delimiter)
        return [part.strip() for part in parts if part or reading.delimiter != " "]
    record = next(csv.reader([line], delimiter=reading.delimiter, skipinitialspace=True), [])
    return [cell.strip() for cell in record]


def _fitted(file: Path, record: list[str], width: int, row: int, line: int) -> list[str]:
    """The cells of a row, as many as there are names; empty ones beyond them are the delimiter at the line's end."""
    while len(record) > width and not record[-1]:
        record.pop()
    if len(record) != width:
        raise fault(file, expected=f"{width} cells, as there are names", found=f"{len(record)}", row=row, line=line)
    return record
