"""An instrument whose own program writes a file for each measurement: the folder is watched for new ones.

* A file counts if it appeared after the measurement was requested. Earlier files are named in ``stray`` and not used,
  because their posture is unknown.
* A file is read once it has not changed for `QUIET` and its last line is complete. It is never read twice.
* Rows without numbers are readings without a line of sight. If a file has only such rows, the next file is
  awaited: it may see the target.
"""

from __future__ import annotations

import csv
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from experiments.instruments.protocol import (
    Array,
    InstrumentError,
    InstrumentSilentError,
    LineOfSightError,
    NotStillError,
    Sample,
)
from experiments.instruments.still import MIN_READINGS, moved_by, summary
from kinematics.reading import read_text

__all__ = ["FolderInstrument", "Reading", "reading_of"]

UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
QUIET = 0.3  # s without a change, after which a file is complete if its last line is
UNENDED = 2.0  # s without a change, after which a last line without its end is complete too
POLL = 0.05  # s
LARGEST_FILE = 64_000_000  # bytes: 10 minutes at 500 Hz take 20 000 000
FARTHEST_POINT = 1e3  # m
HOTTEST = 1e3  # °C
UNSEEN = ("", "nan", "na", "n/a", "null", "none", "-", "--", "---")
KEYS = ("columns", "unit", "targets", "target", "temperatures", "separator", "decimal", "files")


@dataclass(frozen=True)
class Reading:
    """How the files are read.

    Attributes
    ----------
    columns
        Names in the header: of x, y and z, or of one distance.
    scale
        m in one unit of them.
    targets
        Names of the targets.
    target_column
        Says which target a row is of; None: every row is of the one that was asked for.
    temperatures
        Sensor → column, °C.
    separator, decimal
        Of cells, and of decimals.
    files
        Which names count, as a pattern.
    """

    columns: tuple[str, ...] = ("x", "y", "z")
    scale: float = 1.0
    targets: tuple[str, ...] = ("T1",)
    target_column: str | None = None
    temperatures: Mapping[str, str] = field(default_factory=dict)
    separator: str = ","
    decimal: str = "."
    files: str = "*.csv"


def reading_of(query: Mapping[str, str]) -> Reading:
    """How files are read, from what stands behind the ``?`` of an address.

    ``columns=X,Y,Z`` (or one, a distance), ``unit=mm`` (m, mm, um), ``targets=T1,T2``, ``target=Name`` (the column that
    names the target), ``temperatures=ambient:T_air,…`` (sensor:column), ``separator=;`` (or ``tab``), ``decimal=,``,
    ``files=*.txt``.

    Raises
    ------
    InstrumentError
        A key or value is none.
    """
    for key in query:
        if key not in KEYS:
            raise InstrumentError(f"instrument: expected keys {', '.join(KEYS)}, found {key[:40]!r}")
    columns = _names(query.get("columns", "x,y,z"))
    if len(columns) not in (1, 3) or len(set(columns)) < len(columns):
        raise InstrumentError(f"instrument: columns: expected one or three names, found {query['columns'][:80]!r}")
    unit, decimal = query.get("unit", "m"), query.get("decimal", ".")
    separator = {"tab": "\t"}.get(query.get("separator", ","), query.get("separator", ","))
    targets, files = _names(query.get("targets", "T1")), query.get("files", "*.csv")
    if unit not in UNITS:
        raise InstrumentError(f"instrument: unit: expected {', '.join(UNITS)}, found {unit[:40]!r}")
    if decimal not in (".", ",") or len(separator) != 1 or separator == decimal:
        raise InstrumentError(
            f"instrument: expected a separator of one character (or tab) and a decimal . or , that differ, found "
            f"{separator[:10]!r} and {decimal[:10]!r}"
        )
    if not targets or len(set(targets)) < len(targets):
        raise InstrumentError(f"instrument: targets: expected different names, found {query['targets'][:80]!r}")
    if not files or "/" in files or "\\" in files or ".." in files:
        raise InstrumentError(f"instrument: files: expected a pattern of names such as *.csv, found {files[:40]!r}")
    sensors: dict[str, str] = {}
    for pair in _names(query.get("temperatures", "")):
        sensor, colon, column = pair.partition(":")
        if not colon or not sensor or not column or sensor in sensors:
            raise InstrumentError(f"instrument: temperatures: expected sensor:column,…, found {pair[:40]!r}")
        sensors[sensor] = column
    return Reading(
        columns, UNITS[unit], targets, query.get("target") or None, sensors, separator, decimal, files
    )  # fmt: skip


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


class FolderInstrument:
    """An instrument behind a folder.

    Parameters
    ----------
    folder
        Where its program writes.
    reading
        How the files are read.

    Attributes
    ----------
    stray
        Names of files that were written when nothing was asked for.

    Raises
    ------
    InstrumentError
        There is no such folder.
    """

    def __init__(self, folder: Path, reading: Reading | None = None) -> None:
        if not folder.is_dir():
            raise InstrumentError(f"instrument: expected a folder, found no such one: {folder}")
        self._folder, self._reading = folder, Reading() if reading is None else reading
        self.targets = self._reading.targets
        self.stray: list[str] = []
        self._known = self._sizes()
        self._temperatures: dict[str, float] = {}

    def __str__(self) -> str:
        return f"instrument in {self._folder}"

    def measure(self, target: str, count: int, patience: float) -> Sample:
        """Wait for a new file and take the rows of the target; as many as it has, whatever ``count`` is."""
        if target not in self.targets:
            raise InstrumentError(f"{self}: expected one of {', '.join(self.targets)}, found {target!r}")
        before = self._sizes()
        self.stray += sorted(set(before) - set(self._known))
        self._known = before
        end = time.monotonic() + patience
        refused: InstrumentError | None = None
        while (file := self._next(end)) is not None:
            try:
                return self._sample(file, target)
            except (LineOfSightError, NotStillError) as error:
                refused = error  # the next file may see it
        if refused is not None:
            raise refused
        raise InstrumentSilentError(f"{self}: no new file {self._reading.files} within {patience:g} s{self._hint()}")

    def temperatures(self) -> Mapping[str, float]:
        """What the last file said."""
        return dict(self._temperatures)

    def close(self) -> None:
        """Nothing is open."""

    def _sizes(self) -> dict[str, tuple[int, int]]:
        """Name → size and time of change, of the files that are there."""
        found = {}
        try:
            for path in self._folder.glob(self._reading.files):
                try:
                    if path.is_file():
                        status = path.stat()
                        found[path.name] = (status.st_size, status.st_mtime_ns)
                except OSError:
                    continue  # renamed meanwhile
        except OSError as error:
            raise InstrumentError(f"{self}: cannot be read: {error.strerror or error}") from None
        return found

    def _next(self, end: float) -> Path | None:
        """The first new file that is complete, or None; from then on it is known."""
        seen: dict[str, tuple[tuple[int, int], float]] = {}
        while True:
            now, files = time.monotonic(), self._sizes()
            for name, size in sorted(files.items(), key=lambda item: (item[1][1], item[0])):
                if name in self._known:
                    continue
                if name not in seen or seen[name][0] != size:
                    seen[name] = (size, now)
                elif size[0] and now - seen[name][1] >= (QUIET if self._ended(name) else UNENDED):
                    self._known[name] = size
                    return self._folder / name
            if now >= end:
                return None
            time.sleep(min(POLL, max(end - now, 0.0)))

    def _ended(self, name: str) -> bool:
        """Whether the last line is complete."""
        try:
            with (self._folder / name).open("rb") as stream:
                stream.seek(-1, 2)
                return stream.read(1) == b"\n"
        except OSError:
            return False

    def _hint(self) -> str:
        now = self._sizes()
        half = [name for name in now if name not in self._known]
        grown = [name for name in now if name in self._known and now[name] != self._known[name]]
        if half:
            return f"; {half[0]} is not complete"
        return f"; {grown[0]} grew, expected a file for each measurement" if grown else ""

    def _sample(self, file: Path, target: str) -> Sample:
        header, rows = self._rows(file)
        reading = self._reading
        needed = [*reading.columns, *([reading.target_column] if reading.target_column else [])]
        needed += list(reading.temperatures.values())
        for name in needed:
            if header.count(name) != 1:
                found = "two of them" if name in header else ", ".join(header)[:120]
                raise InstrumentError(f"{file}, row 1: expected one column {name!r}, found {found}")
        at = [header.index(name) for name in reading.columns]
        whose = header.index(reading.target_column) if reading.target_column else None
        own = [(number, row) for number, row in rows if whose is None or row[whose].strip() == target]
        if not own:
            raise LineOfSightError(f"{file}: no row of {target}")
        seen = []
        for number, row in own:
            if any(row[k].strip().lower() in UNSEEN for k in at):
                continue
            seen.append([self._number(file, number, header[k], row[k]) * reading.scale for k in at])
        if not seen:
            raise LineOfSightError(f"{file}: no reading of {target} in {len(own)} rows")
        readings: Array = np.array(seen, dtype=np.float64)
        if np.any(np.abs(readings) > FARTHEST_POINT):
            raise InstrumentError(f"{file}: expected m within {FARTHEST_POINT:g}, found more; is it the right unit?")
        moved = moved_by(readings) if len(readings) >= MIN_READINGS else 0.0
        if moved:
            raise NotStillError(f"{file}: {target} moved by {moved * 1e6:.0f} µm while it was measured")
        self._temperatures = self._warmth(file, header, own)
        point, std = np.full(3, np.nan), np.full(3, np.nan)
        point[: len(at)], std[: len(at)] = summary(readings)
        return Sample(point, std, len(readings), file.stat().st_mtime)

    def _warmth(self, file: Path, header: list[str], rows: list[tuple[int, list[str]]]) -> dict[str, float]:
        out = {}
        for sensor, column in self._reading.temperatures.items():
            k = header.index(column)
            read = [self._number(file, n, column, r[k]) for n, r in rows if r[k].strip().lower() not in UNSEEN]
            if any(abs(value) > HOTTEST for value in read):
                raise InstrumentError(f"{file}, column {column}: expected °C within {HOTTEST:g}, found more")
            if read:
                out[sensor] = float(np.median(read))
        return out

    def _rows(self, file: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
        """The header, and the rows with their numbers in the file."""
        try:
            if file.stat().st_size > LARGEST_FILE:
                raise InstrumentError(f"{file}: expected at most {LARGEST_FILE} bytes, found more")
            text = read_text(file, LARGEST_FILE)  # of a device it reads nothing
        except UnicodeDecodeError as error:
            raise InstrumentError(f"{file}: expected UTF-8, found a byte that is not, at {error.start}") from None
        except OSError as error:
            raise InstrumentError(f"{file}: cannot be read: {error.strerror or error}") from None
        try:
            lines = list(csv.reader(text.splitlines(), delimiter=self._reading.separator))
        except csv.Error as error:
            raise InstrumentError(f"{file}: expected CSV, found {error}") from None
        rows = [(number, line) for number, line in enumerate(lines, 1) if any(cell.strip() for cell in line)]
        if not rows:
            raise InstrumentError(f"{file}: expected a header and rows, found an empty file")
        header = [cell.strip() for cell in rows[0][1]]
        for number, line in rows[1:]:
            if len(line) != len(header):
                raise InstrumentError(f"{file}, row {number}: expected {len(header)} cells, found {len(line)}")
        return header, rows[1:]

    def _number(self, file: Path, row: int, column: str, text: str) -> float:
        plain = text.strip().replace(",", ".") if self._reading.decimal == "," else text.strip()
        try:
            value = float(plain)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise InstrumentError(f"{file}, row {row}, column {column}: expected a number, found {text[:40]!r}")
        return value
