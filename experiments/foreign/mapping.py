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

from experiments.columns import POSES, TABLES, lookalike, table_format
from experiments.errors import fault
from experiments.foreign.files import DELIMITERS, Reading
from experiments.foreign.frames import ORIENTATIONS, POSITIONS, Orientation, Position, euler_axes
from experiments.foreign.section import columns_of, unit_of
from experiments.foreign.units import DATE, UNITS, kind_of, units_of
from experiments.toml_file import read_toml
from kinematics.section import Section, shown

__all__ = ["FORMAT", "Join", "Mapping", "RobotLog", "Source", "TableMapping", "read_mapping"]

FORMAT = "clampid-mapping/1"
READING = ("encoding", "delimiter", "decimal", "thousands", "skip_lines", "skip_after_names", "comment", "names")
TABLE = (
    "table", "files", "columns", "position", "orientation", "join", "pairing", "repeats", "lost", "directions", "units",
    *READING,
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
class RobotLog:
    """The robot's raw log beside an instrument's raw log, whose clocks are unknown to each other.

    Attributes
    ----------
    time
        Where its time comes from.
    prefix
        Put before the names of its columns.
    offset
        Robot time minus instrument time in s, known within some seconds; None: anything.
    """

    files: tuple[Path, ...]
    reading: Reading
    time: Source
    prefix: str
    offset: float | None
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
    pairing: RobotLog | None = None


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
    root = read_toml(path, "a mapping file", FORMAT)
    campaign = root.section("campaign")
    if root.has("tables"):
        root.only(("format", "campaign", "tables", "units", "lost", *READING))
        parts = root.sections("tables")
        shared = {key: root.content[key] for key in ("units", "lost", *READING) if root.has(key)}
        if files:
            raise fault(path, expected="files named in each of [[tables]]", found=f"{files[0]} in the call")
        places = [root.part(f"tables[{i}]", {**shared, **part.content}) for i, part in enumerate(parts, 1)]
    else:
        places = [root]
    tables = tuple(_table(place, path.parent, files) for place in places)
    names = [table.table for table in tables]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise fault(path, expected=f"one table {twice}, of as many files as wanted", found="two", column="tables")
    if not campaign.content:
        raise root.fault("campaign", "a table [campaign]", "an empty one")
    return Mapping(path, tables, dict(campaign.content))


def _table(at: Section, folder: Path, files: Sequence[Path]) -> TableMapping:
    """One table."""
    at.only(TABLE if at.place else ("format", "campaign", *TABLE))
    table = at.text("table", TABLES, "poses")
    units = _units(at)
    named = _files(at, folder)
    pairing = _pairing(at, table, units, folder, files) if at.has("pairing") else None
    if pairing is not None and files and pairing.files == tuple(files[-1:]):
        files = files[:-1]
    if bool(named) == bool(files):
        expected = "files in the mapping or in the call" if named else "files, here or in the call"
        raise at.fault("files", expected, "both" if named else "none")
    stops, points = table in POSES, table in ("poses", "verification")
    for key in ("position", "orientation", "pairing", "repeats", "lost", "directions"):
        fits = stops if key in ("lost", "directions") else points
        if at.has(key) and not fits and not (key == "lost" and at.place):
            raise at.fault(key, f"no such key for {table}", shown(at.content[key]))
    one = at.has("join") and isinstance(at.content["join"], MappingType)
    joins = [at.section("join")] if one else at.sections("join", optional=True)
    columns = at.section("columns")
    sources = {name: _source(columns, table, name, units) for name in columns.keys()}  # noqa: SIM118 - not a dict
    if not sources:
        raise at.fault("columns", "a table [columns]", "an empty one")
    return TableMapping(
        table=table,
        files=named or tuple(files),
        reading=_reading(at),
        joins=tuple(_join(at, number, part, folder) for number, part in enumerate(joins, 1)),
        columns=sources,
        position=_position(at, sources, units) if at.has("position") else None,
        orientation=_orientation(at.section("orientation"), units) if at.has("orientation") else None,
        repeats=at.text("repeats", ("median",), "") != "",
        lost=at.texts("lost", alone=True) if at.has("lost") and stops else None,
        directions=at.text("directions", ("previous",), "") != "",
        key=f"{at.place}." if at.place else "",
        pairing=pairing,
    )


def _pairing(at: Section, table: str, units: dict[str, str], folder: Path, files: Sequence[Path]) -> RobotLog:
    """The robot's log; where the mapping does not name its file, the last one of the call."""
    for key in ("join", "repeats", "orientation", "directions"):
        if at.has(key):
            raise at.fault(key, "no such key beside [pairing]", shown(at.content[key]))
    inherited = {key: at.content[key] for key in ("encoding", "delimiter", "decimal", "thousands") if at.has(key)}
    own = at.section("pairing")
    section = at.part("pairing", {**inherited, **own.content})
    named = _files(section, folder) or tuple(files[-1:])
    if not named:
        raise section.fault("files", "the robot's log, here or last in the call", "none")
    if not section.has("time"):
        raise section.fault("time", "{from, unit}, where the robot's time comes from", "no such key")
    time = _source(section, table, "time", units)
    if not time.columns:
        raise section.fault("time", "{from, unit}, where the robot's time comes from", shown(section.content["time"]))
    offset = section.number("offset", default=None) if section.has("offset") else None
    log = RobotLog(named, _reading(section), time, section.text("prefix", default=""), offset, section.place)
    section.done()
    return log


def _files(at: Section, folder: Path) -> tuple[Path, ...]:
    """The files that are named, beside the mapping; with * or ? all that match, in order of their names."""
    found: list[Path] = []
    for name in at.texts("files", (), alone=True):
        several = sorted(folder.glob(name)) if set("*?") & set(name) else [folder / name]
        if not several:
            raise at.fault("files", f"files that match {name!r}", "none")
        found += several
    return tuple(found)


def _units(at: Section) -> dict[str, str]:
    """The units that hold where a column says nothing else, by kind."""
    section = at.section("units", optional=True)
    units = {kind: unit_of(section, kind, kind, {}) for kind in UNITS if section.has(kind)}
    section.done()
    return units


def _reading(at: Section) -> Reading:
    delimiter, decimal = at.text("delimiter", default=","), at.text("decimal", (".", ","), ".")
    if delimiter not in DELIMITERS and len(delimiter) != 1:
        raise at.fault("delimiter", "one character, 'tab' or 'space'", shown(delimiter))
    if decimal == delimiter:
        raise at.fault("decimal", "'.' or ',', and not the delimiter", shown(decimal))
    thousands = at.text("thousands", default="")
    if len(thousands) > 1 or (thousands and thousands in (decimal, delimiter)):
        raise at.fault("thousands", "one character that is neither decimal nor delimiter", shown(thousands))
    encoding = at.text("encoding", default="") or None
    if encoding is not None:
        try:
            codecs.lookup(encoding)
        except (LookupError, ValueError):
            expected = "an encoding that Python knows, such as cp1252 or utf-16"
            raise at.fault("encoding", expected, shown(encoding)) from None
    skipped = at.integer("skip_lines", 0, default=0), at.integer("skip_after_names", 0, default=0)
    comments = tuple(one for one in at.texts("comment", (), alone=True) if one)
    names = at.texts("names", (), alone=True) or None
    return Reading(encoding, DELIMITERS.get(delimiter, delimiter), decimal, thousands, *skipped, comments, names)


def _join(at: Section, number: int, part: Section, folder: Path) -> Join:
    inherited = {key: at.content[key] for key in ("encoding", "delimiter", "decimal", "thousands") if at.has(key)}
    section = at.part(f"join[{number}]", {**inherited, **part.content})
    files = _files(section, folder)
    if not files:
        raise section.fault("files", "files", "none")
    if section.has("on") == section.has("order"):
        raise section.fault("on", "either on or order", "both" if section.has("on") else "neither")
    found = columns_of(section, "on", (1, 2)) if section.has("on") else ()
    order = section.text("order", default=None)
    join = Join(
        files, _reading(section), (found[0], found[-1]) if found else None, order,
        section.text("prefix", default=""), section.place,
    )  # fmt: skip
    section.done()
    return join


def _source(columns: Section, table: str, name: str, units: dict[str, str]) -> Source:
    """One entry of ``[columns]``."""
    expected = "{from, value or number, and unit, scale, pattern}"
    if not isinstance(columns.content[name], MappingType):
        raise columns.fault(name, expected, shown(columns.content[name]))
    at = columns.section(name)
    given = [key for key in ("from", "value", "number") if at.has(key)]
    if len(given) != 1:
        raise columns.fault(name, "one of from, value and number", shown(at.content))
    _known_name(columns, table, name)
    kind = kind_of(name)
    known = units_of(kind) + (units_of("length") if kind == "angle" and name[0] == "q" else ())  # of a sliding joint
    first = units.get(kind, "") if given != ["number"] else known[0] if known else ""
    unit = at.value("unit", "a unit", first)
    if unit not in (known or ("",)):
        raise columns.fault(name, f"a unit, one of {', '.join(known)}" if known else "no unit", shown(unit))
    if at.has("pattern") and unit != DATE:
        raise columns.fault(name, f'a pattern beside unit = "{DATE}" only', shown(at.content))
    scale = at.number("scale", default=1.0)
    if scale == 0.0:
        raise at.fault("scale", "a factor that is not 0", "0")
    number = at.text("number", NUMBERINGS.get(name, ("from or value",)), None)
    value = at.value("value", "a value", None)
    if given == ["value"]:
        if unit == DATE:
            raise columns.fault(name, "a column of dates", shown(at.content))
        value = at.text("value") if kind in ("text", "extra") and isinstance(value, str) else at.number("value")
    from_ = columns_of(at, "from", () if unit == DATE else (1,)) if given == ["from"] else ()
    source = Source(from_, value, number, unit, scale, at.text("pattern", default="") or None, columns.path(name))
    at.done()
    return source


def _known_name(columns: Section, table: str, name: str) -> None:
    """Refuse a column that looks like one of the campaign's but would be kept as an extra one."""
    if kind_of(name) != "extra":
        return
    known = dict.fromkeys(c.removesuffix(_suffix_of(c)) for c in table_format(table, MANY_JOINTS).known())
    bare = name.removesuffix(_suffix_of(name))
    near = next((k for k in known if k.lower() == bare.lower() or lookalike(k, [name])), None)
    near = "temp_<where>, such as temp_link1" if name.lower().startswith("temp") else near
    if near:
        raise columns.fault(name, f"{near} (no unit in the name)", shown(name))


def _suffix_of(column: str) -> str:
    return next((s for s in ("_rad_s", "_rad", "_Nm", "_m", "_s", "_C") if column.endswith(s)), "")


def _position(table: Section, columns: MappingType[str, Source], units: dict[str, str]) -> Position:
    at = table.section("position")
    both = [axis for axis in "xyz" if axis in columns]
    if both:
        raise table.fault("position", "a position here or in [columns]", f"columns.{both[0]}, too")
    kind = at.text("kind", POSITIONS, "spherical")
    position = Position(
        kind,
        columns_of(at, "from", (3,)),
        unit_of(at, "length", "length", units),
        unit_of(at, "angle", "angle", units) if kind == "spherical" or at.has("angle") else "",
        at.text("elevation", ("horizon", "zenith"), "horizon") == "zenith",
        at.text("azimuth", ("counterclockwise", "clockwise"), "counterclockwise") == "clockwise",
        at.place,
    )
    at.done()
    return position


def _orientation(at: Section, units: dict[str, str]) -> Orientation:
    kind = at.text("kind", tuple(ORIENTATIONS))
    axes = at.text("axes", default="") or None
    if kind == "euler" and (axes is None or not euler_axes(axes)):
        expected = "three of XYZ (about the axes as turned) or xyz (about fixed axes)"
        raise at.fault("axes", expected, shown(axes))
    if kind != "euler" and axes is not None:
        raise at.fault("axes", 'no axes but with kind = "euler"', shown(axes))
    count, angular = ORIENTATIONS[kind]
    unit = unit_of(at, "angle", "angle", units) if angular or at.has("angle") else ""
    columns, inverse = columns_of(at, "from", (count,)), at.flag("inverse", False)
    at.done()
    return Orientation(kind, columns, axes or "", unit if angular else "", inverse, at.place)
