"""Tables as instruments write them, made into a campaign: a small file says which column is what, in which unit.

A mapping is TOML::

    format = "clampid-mapping/1"
    table = "poses"                     # or verification
    delimiter = ";"                     # by default a comma; "tab", or "space" for any number of them
    decimal = ","                       # by default a point
    skip_lines = 2                      # before the line of names
    repeats = "median"                  # of rows of one pose, visit and target; by default they are refused

    [columns]                           # campaign column without its unit = where it comes from
    pose = {from = "Point"}
    q1 = {from = "A1", unit = "deg"}
    x = {from = "X [mm]", unit = "mm", scale = 1.0}
    target = {value = "T1"}             # the same in every row
    temp_link1 = {from = "Temp", unit = "degC"}

    [campaign]                          # what campaign.toml shall say: robot, tool, targets_m, instrument
    robot = "kuka_kr20_r1810"

``visit`` is 1, ``time`` counts rows and ``dir1`` … are 0 (unknown) where nothing is said.
"""

from __future__ import annotations

import io
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.columns import table_format
from experiments.errors import fault

__all__ = ["FORMAT", "Imported", "TableMapping", "import_tables", "read_mapping"]

FORMAT = "clampid-mapping/1"
LENGTHS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "inch": 0.0254}
ANGLES = {"rad": 1.0, "deg": np.pi / 180, "mrad": 1e-3}
TIMES = {"s": 1.0, "ms": 1e-3, "min": 60.0}
ZEROS = {"degC": 0.0, "K": -273.15}
DELIMITERS = {"tab": "\t", "space": r"\s+"}
KEYS = ("format", "table", "delimiter", "decimal", "skip_lines", "repeats", "columns", "campaign")
ROBUST = 1.4826  # median absolute deviation to standard deviation of a normal
NUMBERS = ("pose", "visit")
FEW_TURNS = 4 * np.pi  # rad: no joint of an arm turns farther than this from its zero
STILL = 2 * np.pi  # degrees: all joints of an arm that is calibrated within so few degrees are radians


@dataclass(frozen=True)
class Source:
    """Where a campaign's column comes from: a column of the file with a unit and a factor, or one value for all."""

    column: str | None
    value: str | float | None
    unit: str
    scale: float


@dataclass(frozen=True)
class TableMapping:
    """A mapping as read; see the module."""

    path: Path
    table: str
    delimiter: str
    decimal: str
    skip_lines: int
    repeats: bool
    columns: dict[str, Source]
    campaign: dict[str, Any]


@dataclass(frozen=True)
class Imported:
    """A table in the campaign's columns, and what became of repeated samples.

    Attributes
    ----------
    frame
        The table; where samples were repeated with ``samples`` (how many) and ``scatter_x_m`` … (robust standard
        deviation of one sample).
    samples
        How many rows there were.
    scatter
        Pooled over all repeated rows ``(3,)`` m, or None.
    """

    frame: pd.DataFrame
    samples: int
    scatter: tuple[float, float, float] | None


def read_mapping(path: Path) -> TableMapping:
    """Read a mapping.

    Raises
    ------
    CampaignError
        The file is missing, no TOML, or a key is missing, unknown or wrong.
    """
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise fault(path, expected="a mapping file", found="no such file") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise fault(path, expected="TOML", found=str(error)) from error
    for key in raw:
        if key not in KEYS:
            raise fault(path, expected=f"one of {', '.join(KEYS)}", found="an unknown key", column=key)
    if raw.get("format") != FORMAT:
        raise fault(path, expected=repr(FORMAT), found=repr(raw.get("format")), column="format")
    table = raw.get("table", "poses")
    if table not in ("poses", "verification"):
        raise fault(path, expected="'poses' or 'verification'", found=repr(table), column="table")
    delimiter, decimal = raw.get("delimiter", ","), raw.get("decimal", ".")
    if not isinstance(delimiter, str) or (delimiter not in DELIMITERS and len(delimiter) != 1):
        raise fault(path, expected="one character, 'tab' or 'space'", found=repr(delimiter), column="delimiter")
    if decimal not in (".", ",") or decimal == delimiter:
        raise fault(path, expected="'.' or ',', and not the delimiter", found=repr(decimal), column="decimal")
    skip, repeats = raw.get("skip_lines", 0), raw.get("repeats")
    if isinstance(skip, bool) or not isinstance(skip, int) or skip < 0:
        raise fault(path, expected="a number of lines", found=repr(skip), column="skip_lines")
    if repeats not in (None, "median"):
        raise fault(path, expected="'median'", found=repr(repeats), column="repeats")
    columns, campaign = _section(path, raw, "columns"), _section(path, raw, "campaign")
    sources = {name: _source(path, name, entry) for name, entry in columns.items()}
    return TableMapping(
        path, table, DELIMITERS.get(delimiter, delimiter), decimal, skip, repeats == "median", sources, campaign
    )


def _section(path: Path, raw: dict[str, Any], key: str) -> dict[str, Any]:
    value = raw.get(key)
    if not isinstance(value, dict) or not value:
        raise fault(path, expected=f"a table [{key}]", found=repr(value), column=key)
    return value


def _source(path: Path, name: str, entry: Any) -> Source:
    """One entry of ``[columns]``."""
    where, units = f"columns.{name}", _units(name)
    if not isinstance(entry, dict) or set(entry) - {"from", "value", "unit", "scale"}:
        raise fault(path, expected="{from or value, unit, scale}", found=repr(entry), column=where)
    if ("from" in entry) == ("value" in entry):
        raise fault(path, expected="either from or value", found=repr(entry), column=where)
    unit = entry.get("unit", "")
    if units and unit not in units:
        raise fault(path, expected=f"a unit, one of {', '.join(units)}", found=repr(unit), column=where)
    if not units and unit:
        raise fault(path, expected="no unit", found=repr(unit), column=where)
    scale = entry.get("scale", 1.0)
    if isinstance(scale, bool) or not isinstance(scale, int | float) or not np.isfinite(scale) or scale == 0:
        raise fault(path, expected="a factor that is not 0", found=repr(scale), column=where)
    column = entry.get("from")
    return Source(None if column is None else str(column), entry.get("value"), unit, float(scale))


def _units(name: str) -> tuple[str, ...]:
    """Units that a campaign column, named without its unit, may have; none for names, counts and directions."""
    if name.startswith("temp_"):
        return tuple(ZEROS)
    if name == "time":
        return tuple(TIMES)
    if name in ("x", "y", "z"):
        return tuple(LENGTHS)
    if name.startswith("q") and name[1:].isdigit():
        return tuple(ANGLES)
    return ()


def _campaign_name(name: str) -> str:
    """The campaign's column of a name without unit."""
    if name.startswith("temp_"):
        return f"{name}_C"
    units = _units(name)
    return f"{name}_{units[0]}" if units else name  # the first is SI


def import_tables(mapping: TableMapping, files: Sequence[Path], n: int) -> Imported:
    """Read files by a mapping, one after the other.

    Parameters
    ----------
    n
        Number of joints.

    Raises
    ------
    CampaignError
        A file or column is missing, a value is no number, a unit cannot be the right one, or rows repeat a pose, visit
        and target without ``repeats``.
    """
    frame = pd.concat([_one(mapping, file) for file in files], ignore_index=True)
    frame = _completed(mapping, frame, n)
    keys = ["pose", "visit", "target"]
    repeated = frame.duplicated(keys, keep=False)
    if not repeated.any():
        return Imported(frame, len(frame), None)
    if not mapping.repeats:
        first = int(np.flatnonzero(repeated)[0])
        said = ", ".join(f"{key} {frame[key].iloc[first]}" for key in keys)
        raise fault(
            files[0], expected=f'one row of {said} (repeats = "median" in {mapping.path.name} takes medians)',
            found=f"{int((frame[keys] == frame.loc[first, keys]).all(axis=1).sum())}", row=first + 1,
        )  # fmt: skip
    return _medians(frame, keys)


def _one(mapping: TableMapping, file: Path) -> pd.DataFrame:
    """A file in the campaign's columns and units."""
    try:
        text = file.read_text(encoding="utf-8-sig")
        raw = pd.read_csv(
            io.StringIO(text), sep=mapping.delimiter, decimal=mapping.decimal, skiprows=mapping.skip_lines,
            dtype=str, engine="python", skipinitialspace=True,
        )  # fmt: skip
    except FileNotFoundError:
        raise fault(file, expected="a table", found="no such file") from None
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise fault(file, expected="a table of columns", found=str(error)) from error
    names = [str(name).strip() for name in raw.columns]
    raw.columns = pd.Index(names)
    if raw.empty:
        raise fault(file, expected="at least one row", found="a line of names and no rows")
    out: dict[str, Any] = {}
    for name, source in mapping.columns.items():
        if source.column is None:
            out[_campaign_name(name)] = [source.value] * len(raw)
            continue
        if source.column not in names:
            raise fault(file, expected=f"a column {source.column!r}, as {mapping.path.name} says",
                        found=f"the columns {', '.join(names)}")  # fmt: skip
        cells = raw[source.column]
        if name in ("target", *NUMBERS):
            out[name] = cells.str.strip() if name == "target" else _counted(cells)
            continue
        out[_campaign_name(name)] = _converted(mapping, file, source, cells)
    return pd.DataFrame(out)


def _counted(cells: pd.Series[Any]) -> pd.Series[Any]:
    """Numbers of poses as they are, names of poses numbered in the order in which they first come."""
    numbers = pd.to_numeric(cells, errors="coerce")
    if numbers.notna().all() and (numbers == numbers.round()).all():
        return numbers.astype(np.int64)
    return pd.Series(pd.factorize(cells)[0] + 1, index=cells.index)


def _converted(mapping: TableMapping, file: Path, source: Source, cells: pd.Series[Any]) -> pd.Series[Any]:
    if mapping.decimal == ",":
        cells = cells.str.replace(",", ".", regex=False)
    numbers = pd.to_numeric(cells, errors="coerce")
    bad = numbers.isna()
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise fault(file, expected="a number", found=repr(cells.iloc[row]), row=row + 1, column=source.column)
    if source.unit in ZEROS:
        return source.scale * numbers + ZEROS[source.unit]
    return source.scale * numbers * {**LENGTHS, **ANGLES, **TIMES}.get(source.unit, 1.0)


def _completed(mapping: TableMapping, frame: pd.DataFrame, n: int) -> pd.DataFrame:
    """The table with what the mapping left to be filled in, its columns in the campaign's order."""
    if "visit" not in frame:
        frame["visit"] = 1
    if "time_s" not in frame:
        frame["time_s"] = np.arange(len(frame), dtype=float)
    for i in range(n):
        frame[f"dir{i + 1}"] = frame[f"dir{i + 1}"].astype(int) if f"dir{i + 1}" in frame else 0
    wanted = [column.name for column in table_format(mapping.table, n).required]
    for name in wanted:
        if name not in frame:
            raise fault(mapping.path, expected=f"[columns] to say where {name} comes from", found="nothing about it")
    _refuse_units(mapping, frame, n)
    return frame[[*wanted, *(name for name in frame.columns if name not in wanted)]]


def _refuse_units(mapping: TableMapping, frame: pd.DataFrame, n: int) -> None:
    """Refuse angles whose stated unit cannot be the right one, whatever the robot."""
    largest = {f"q{i + 1}": float(frame[f"q{i + 1}_rad"].abs().max()) for i in range(n)}
    for name, value in largest.items():
        unit = mapping.columns[name].unit
        if unit == "rad" and value > FEW_TURNS:
            raise fault(
                mapping.path, expected=f"a unit in which {name} makes sense: rad and values up to {value:g} are "
                f"{value / (2 * np.pi):.0f} turns", found="'rad'; 'deg' is probably meant", column=f"columns.{name}",
            )  # fmt: skip
    degrees = [largest[name] / ANGLES["deg"] for name in largest if mapping.columns[name].unit == "deg"]
    if len(degrees) == n and max(degrees) < STILL and frame["pose"].nunique() > 2:
        raise fault(
            mapping.path, expected=f"a unit in which the arm moves: deg, and all joints within {max(degrees):.3g} deg "
            "of zero in all poses", found="'deg'; 'rad' is probably meant", column="columns.q1",
        )  # fmt: skip


def _medians(frame: pd.DataFrame, keys: list[str]) -> Imported:
    """One row for all samples of a pose, visit and target: medians, and how far single samples scatter."""
    axes = ["x_m", "y_m", "z_m"]
    grouped = frame.groupby(keys, sort=False)
    numeric = [name for name in frame.select_dtypes("number").columns if name not in (*keys, "time_s")]
    out = grouped[numeric].median()
    out["time_s"] = grouped["time_s"].min()
    out["samples"] = grouped.size()
    off = (frame[axes] - grouped[axes].transform("median")).abs()
    for axis in axes:
        out[f"scatter_{axis}"] = ROBUST * off[axis].groupby([frame[k] for k in keys], sort=False).median()
    out = out.reset_index()
    for name in frame.columns:
        if name.startswith("dir"):
            out[name] = np.sign(out[name]).astype(int)
    several = grouped["x_m"].transform("size") > 1
    scatter = tuple(float(ROBUST * off.loc[several, axis].median()) for axis in axes)
    ordered = [*frame.columns, *(name for name in out.columns if name not in frame.columns)]
    return Imported(out[ordered], len(frame), (scatter[0], scatter[1], scatter[2]))
