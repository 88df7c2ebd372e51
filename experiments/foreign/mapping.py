"""The mapping file: which column of which file is what, in which unit.

TOML, for one table or, with ``[[tables]]``, for several; what stands above them holds for all. The page *Tables of
other programs* of the documentation lists every key::

    format = "clampid-mapping/1"
    units = {angle = "deg", length = "mm"}      # where a column says nothing else
    table = "poses"
    files = ["points.txt"]                      # beside the mapping; or given to clampid import
    [columns]
    pose = {from = "Point"}
    q1 = {from = "A1", scale = -1}
    target = {value = "T1"}
    [campaign]
    robot = "kuka_kr20_r1810"
"""

from __future__ import annotations

import codecs
from collections.abc import Mapping as MappingType
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.columns import POSES, TABLES, lookalike, table_format
from experiments.errors import fault
from experiments.foreign.files import DELIMITERS, Reading
from experiments.foreign.frames import ORIENTATIONS, POSITIONS, Orientation, Position, euler_axes
from experiments.foreign.section import Section
from experiments.foreign.units import DATE, UNITS, kind_of, units_of
from experiments.toml_file import read_toml

__all__ = ["FORMAT", "Join", "Mapping", "Source", "TableMapping", "read_mapping"]

FORMAT = "clampid-mapping/1"
READING = ("encoding", "delimiter", "decimal", "thousands", "skip_lines", "skip_after_names", "comment", "names")
TABLE = (
    "table", "files", "columns", "position", "orientation", "join", "repeats", "lost", "directions", "units", *READING
)  # fmt: skip
NUMBERINGS: dict[str, tuple[str, ...]] = {"pose": ("rows", "postures"), "visit": ("returns",)}
MANY_JOINTS = 20  # of the names of columns that a mapping may know before the robot is


@dataclass(frozen=True)
class Source:
    """Where a campaign's column comes from.

    Attributes
    ----------
    columns
        Of the file, by name or number from 1: one, or for a date several that are joined with a space; none where
        ``value`` or ``number`` says it.
    value
        The same in every row.
    number
        How poses or visits are numbered; see :data:`NUMBERINGS`.
    unit, scale
        A number of the file times ``scale`` is in ``unit``.
    pattern
        Of a date, as Python's ``strptime`` has it; None: ISO 8601.
    key
        Where the mapping says all this.
    """

    columns: tuple[str | int, ...]
    value: str | float | None
    number: str | None
    unit: str
    scale: float
    pattern: str | None
    key: str


@dataclass(frozen=True)
class Join:
    """Files whose rows belong to the table's: by a column of both (``on``), or in order.

    Attributes
    ----------
    on
        A column of the table and one of these files, whose cells are equal.
    order
        ``rows``: row by row. Else a column of the table: each new value of it in turn takes the next row.
    prefix
        Put before the names of these files' columns.
    """

    files: tuple[Path, ...]
    reading: Reading
    on: tuple[str | int, str | int] | None
    order: str | None
    prefix: str
    key: str


@dataclass(frozen=True)
class TableMapping:
    """How one table of the campaign is made."""

    table: str
    files: tuple[Path, ...]
    reading: Reading
    joins: tuple[Join, ...]
    columns: MappingType[str, Source]
    position: Position | None
    orientation: Orientation | None
    repeats: bool
    lost: tuple[str, ...] | None
    directions: bool
    key: str


@dataclass(frozen=True)
class Mapping:
    """A mapping file as read."""

    path: Path
    tables: tuple[TableMapping, ...]
    campaign: dict[str, Any]


def read_mapping(path: Path, files: Sequence[Path] = ()) -> Mapping:
    """Read a mapping.

    Parameters
    ----------
    files
        Of the one table, where the mapping itself names none.

    Raises
    ------
    CampaignError
        The file is missing, no TOML, or a key is missing, unknown or wrong.
    """
    raw = read_toml(path, "a mapping file", FORMAT)
    several = "tables" in raw
    whole = ("format", "campaign", "tables", "units", "lost", *READING) if several else ("format", "campaign", *TABLE)
    at = Section(path, "", raw)
    at.only(whole)
    if several:
        parts, shared = raw["tables"], {k: v for k, v in raw.items() if k not in ("format", "campaign", "tables")}
        if not isinstance(parts, list) or not all(isinstance(part, dict) for part in parts):
            raise fault(path, expected="[[tables]], one for each table", found=repr(parts), column="tables")
        sections = [Section(path, f"tables[{i + 1}].", {**shared, **part}) for i, part in enumerate(parts)]
        if files:
            raise fault(path, expected="files named in each of [[tables]]", found=f"{files[0]} in the call")
    else:
        sections = [Section(path, "", {k: v for k, v in raw.items() if k not in ("format", "campaign")})]
    tables = tuple(_table(section, files) for section in sections)
    names = [table.table for table in tables]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise fault(path, expected=f"one table {twice}, of as many files as wanted", found="two", column="tables")
    return Mapping(path, tables, at.section("campaign"))


def _table(at: Section, files: Sequence[Path]) -> TableMapping:
    """One table."""
    at.only(TABLE)
    table = at.text("table", "poses", TABLES)
    units = _units(at)
    named = tuple(path for name in at.texts("files") for path in _matching(at, name))
    if named and files:
        at.refuse("files", "files in the mapping or in the call", "both")
    if not named and not files:
        at.refuse("files", "files, here or in the call", "none")
    stops, points = table in POSES, table in ("poses", "verification")
    for key in ("position", "orientation", "repeats", "lost", "directions"):
        fits = stops if key in ("lost", "directions") else points
        if key in at.raw and not fits and not (key == "lost" and at.prefix):
            at.refuse(key, f"no such key for {table}", repr(at.raw[key]))
    at.text("repeats", "median", ("median",))
    at.text("directions", "previous", ("previous",))
    joins = at.raw.get("join", [])
    joins = [joins] if isinstance(joins, dict) else joins
    if not isinstance(joins, list) or not all(isinstance(part, dict) for part in joins):
        at.refuse("join", "a table [join], or several [[join]]", repr(joins))
    columns = {name: _source(at, table, name, entry, units) for name, entry in at.section("columns").items()}
    return TableMapping(
        table=table,
        files=named or tuple(files),
        reading=_reading(at),
        joins=tuple(_join(at, i, part) for i, part in enumerate(joins)),
        columns=columns,
        position=_position(at, columns, units) if "position" in at.raw else None,
        orientation=_orientation(at, units) if "orientation" in at.raw else None,
        repeats="repeats" in at.raw,
        lost=at.texts("lost") if "lost" in at.raw and stops else None,
        directions="directions" in at.raw,
        key=at.prefix,
    )


def _matching(at: Section, name: str) -> list[Path]:
    """The files of a name beside the mapping; with * or ? all that match, in order of their names."""
    if not set("*?") & set(name):
        return [at.path.parent / name]
    found = sorted(at.path.parent.glob(name))
    if not found:
        at.refuse("files", f"files that match {name!r}", "none")
    return found


def _units(at: Section) -> dict[str, str]:
    """The units that hold where a column says nothing else, by kind."""
    if "units" not in at.raw:
        return {}
    section = Section(at.path, f"{at.prefix}units.", at.section("units"))
    section.only(tuple(UNITS))
    return {kind: section.unit(kind, kind, {}) for kind in section.raw}


def _reading(at: Section) -> Reading:
    delimiter, decimal = at.text("delimiter", ","), at.text("decimal", ".", (".", ","))
    if delimiter not in DELIMITERS and len(delimiter) != 1:
        at.refuse("delimiter", "one character, 'tab' or 'space'", repr(delimiter))
    if decimal == delimiter:
        at.refuse("decimal", "'.' or ',', and not the delimiter", repr(decimal))
    thousands = at.text("thousands", "")
    if len(thousands) > 1 or (thousands and thousands in (decimal, delimiter)):
        at.refuse("thousands", "one character that is neither decimal nor delimiter", repr(thousands))
    encoding = at.text("encoding", "") or None
    if encoding is not None:
        try:
            codecs.lookup(encoding)
        except (LookupError, ValueError):
            at.refuse("encoding", "an encoding that Python knows, such as cp1252 or utf-16", repr(encoding))
    names = at.texts("names") or None
    return Reading(
        encoding, DELIMITERS.get(delimiter, delimiter), decimal, thousands, at.count("skip_lines"),
        at.count("skip_after_names"), tuple(c for c in at.texts("comment") if c), names,
    )  # fmt: skip


def _join(at: Section, number: int, part: dict[str, Any]) -> Join:
    inherited: dict[str, Any] = {
        key: at.raw[key] for key in ("encoding", "delimiter", "decimal", "thousands") if key in at.raw
    }
    section = Section(at.path, f"{at.prefix}join[{number + 1}].", {**inherited, **part})
    section.only(("files", "on", "order", "prefix", *READING))
    files = tuple(path for name in section.texts("files") for path in _matching(section, name))
    if not files:
        section.refuse("files", "files", "none")
    if ("on" in part) == ("order" in part):
        section.refuse("on", "either on or order", "both" if "on" in part else "neither")
    on: tuple[str | int, str | int] | None = None
    if "on" in part:
        found = section.columns("on", None if isinstance(part["on"], list) else 1)
        if len(found) > 2:
            section.refuse("on", "a column of both, or one of each", repr(part["on"]))
        on = found[0], found[-1]
    order = section.text("order", "") if "order" in part else None
    return Join(files, _reading(section), on, order, section.text("prefix", ""), section.prefix.removesuffix("."))


def _source(at: Section, table: str, name: str, entry: Any, units: dict[str, str]) -> Source:
    """One entry of ``[columns]``."""
    key = f"columns.{name}"
    if not isinstance(entry, dict):
        at.refuse(key, "{from, value or number, and unit, scale, pattern}", repr(entry))
    section = Section(at.path, f"{at.prefix}{key}.", entry)
    if set(entry) - {"from", "value", "number", "unit", "scale", "pattern"}:
        at.refuse(key, "{from, value or number, and unit, scale, pattern}", repr(entry))
    if sum(word in entry for word in ("from", "value", "number")) != 1:
        at.refuse(key, "one of from, value and number", repr(entry))
    _known_name(at, table, name)
    kind = kind_of(name)
    known = units_of(kind) + (units_of("length") if kind == "angle" and name[0] == "q" else ())  # of a sliding joint
    unit = entry.get("unit", units.get(kind, "") if "number" not in entry else known[0] if known else "")
    if known and unit not in known:
        at.refuse(key, f"a unit, one of {', '.join(known)}", repr(unit))
    if not known and unit:
        at.refuse(key, "no unit", repr(unit))
    if "pattern" in entry and unit != DATE:
        at.refuse(key, f'a pattern beside unit = "{DATE}" only', repr(entry))
    scale, value, number = entry.get("scale", 1.0), entry.get("value"), entry.get("number")
    if isinstance(scale, bool) or not isinstance(scale, int | float) or not np.isfinite(scale) or scale == 0:
        at.refuse(key, "a factor that is not 0", repr(scale))
    if number is not None and number not in NUMBERINGS.get(name, ()):
        allowed = ", ".join(NUMBERINGS.get(name, ())) or "from or value"
        at.refuse(key, allowed, repr(number))
    if "value" in entry and kind not in ("text", "extra"):
        finite = isinstance(value, int | float) and not isinstance(value, bool) and np.isfinite(value)
        if unit == DATE or not finite:
            at.refuse(key, "a number", repr(value))
    columns = section.columns("from", None if unit == DATE else 1) if "from" in entry else ()
    pattern = section.text("pattern", "") or None
    return Source(columns, value, number, unit, float(scale), pattern, f"{at.prefix}{key}")


def _known_name(at: Section, table: str, name: str) -> None:
    """Refuse a column that looks like one of the campaign's but would be kept as an extra one."""
    if kind_of(name) != "extra":
        return
    known = dict.fromkeys(c.removesuffix(_unit_of(c)) for c in table_format(table, MANY_JOINTS).known())
    bare = name.removesuffix(_unit_of(name))
    near = next((k for k in known if k.lower() == bare.lower() or lookalike(k, [name])), None)
    near = "temp_<where>, such as temp_link1" if name.lower().startswith("temp") else near
    if near:
        at.refuse(f"columns.{name}", f"{near} (no unit in the name)", repr(name))


def _unit_of(column: str) -> str:
    stem = next((s for s in ("_rad_s", "_rad", "_Nm", "_m", "_s", "_C") if column.endswith(s)), "")
    return stem


def _position(at: Section, columns: dict[str, Source], units: dict[str, str]) -> Position:
    section = Section(at.path, f"{at.prefix}position.", at.section("position"))
    kind = section.text("kind", "spherical", POSITIONS)
    section.only(("kind", "from", "length", "angle", "elevation", "azimuth"))
    both = [axis for axis in "xyz" if axis in columns]
    if both:
        at.refuse("position", "a position here or in [columns]", f"columns.{both[0]}, too")
    return Position(
        kind,
        section.columns("from", 3),
        section.unit("length", "length", units),
        section.unit("angle", "angle", units) if kind == "spherical" else "",
        section.text("elevation", "horizon", ("horizon", "zenith")) == "zenith",
        section.text("azimuth", "counterclockwise", ("counterclockwise", "clockwise")) == "clockwise",
        f"{at.prefix}position",
    )


def _orientation(at: Section, units: dict[str, str]) -> Orientation:
    section = Section(at.path, f"{at.prefix}orientation.", at.section("orientation"))
    section.only(("kind", "from", "axes", "angle", "inverse"))
    kind = section.text("kind", "", tuple(ORIENTATIONS))
    axes = section.text("axes", "") or None
    if kind == "euler" and (axes is None or not euler_axes(axes)):
        section.refuse("axes", "three of XYZ (about the axes as turned) or xyz (about fixed axes)", repr(axes))
    if kind != "euler" and axes is not None:
        section.refuse("axes", 'no axes but with kind = "euler"', repr(axes))
    count, angular = ORIENTATIONS[kind]
    unit = section.unit("angle", "angle", units) if angular else ""
    return Orientation(
        kind, section.columns("from", count), axes or "", unit, section.flag("inverse"), f"{at.prefix}orientation"
    )
