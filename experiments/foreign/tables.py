"""Makes the tables of a campaign from files by a mapping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from experiments.columns import POSITION, QUATERNION, table_format
from experiments.errors import CampaignError, fault
from experiments.foreign.cells import counts, dates, labels, numbers
from experiments.foreign.files import Cells, Origin, read_cells
from experiments.foreign.frames import points, quaternions
from experiments.foreign.joins import joined
from experiments.foreign.mapping import Mapping, Source, TableMapping
from experiments.foreign.medians import medians
from experiments.foreign.numbering import directions, postures, returns
from experiments.foreign.two_logs import paired
from experiments.foreign.units import DATE, UNITS, campaign_name, kind_of, to_si
from experiments.pairing import Pairing
from experiments.tables import TableFile
from experiments.validate import validate_table
from kinematics.description import RobotDescription

__all__ = ["Imported", "import_tables"]

Bools = npt.NDArray[np.bool_]
FloatArray = npt.NDArray[np.float64]
FEW_TURNS = 4 * np.pi  # rad: no joint of an arm turns farther than this from its zero
STILL = 2 * np.pi  # degrees: no campaign keeps all joints within so few degrees; they are radians


@dataclass(frozen=True)
class ImportedFile(TableFile):
    """A table made from files: errors name the cell of the file that a value came from.

    Attributes
    ----------
    index
        Which row of the files ``(rows,)`` each row came from first.
    main
        Where rows come from.
    columns
        Column → where its cells come from, and the name there.
    """

    main: Origin | None = None
    index: npt.NDArray[np.intp] | None = None
    columns: dict[str, tuple[Origin, str]] | None = None

    def fault(self, *, expected: str, found: str, row: int | None = None, column: str | None = None) -> CampaignError:
        """Word an error about this table by the files that it was made of."""
        if row is None or self.main is None or self.index is None:
            return fault(self.path, expected=expected, found=found, column=column and f"columns.{column}")
        origin, name = (self.columns or {}).get(str(column), (self.main, column))
        return origin.fault(int(self.index[row]), expected=expected, found=found, column=name)

    def cell(self, row: int, column: str, value: object) -> str:
        """The value in words; the text of the cell may have been in another unit."""
        return "an empty cell" if value is None or value != value else f"{value!r}"  # noqa: PLR0124 (not a number)

    def words(self, row: int) -> str:
        """Which row of which file a row (from 0) came from first."""
        return self.main.words(int(self.index[row])) if self.main is not None and self.index is not None else ""


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
    source
        Words what is wrong in it.
    notes
        What a person should know of how it was made.
    pairing
        How two raw logs were paired, where the table is made of them.
    """

    table: str
    frame: pd.DataFrame
    samples: int
    scatter: tuple[float, float, float] | None
    source: ImportedFile
    notes: tuple[str, ...]
    pairing: Pairing | None = None


def import_tables(mapping: Mapping, robot: RobotDescription, targets: Sequence[str]) -> tuple[Imported, ...]:
    """Read all tables of a mapping.

    Parameters
    ----------
    targets
        Names of the declared targets.

    Raises
    ------
    CampaignError
        A file or column is missing, a value is wrong, a unit cannot be the right one, rows repeat a pose, visit and
        target without ``repeats``, or the table does not follow the campaign format.
    """
    found = [_one(mapping, part, robot) for part in mapping.tables]
    dated = [i for i, part in enumerate(mapping.tables) if _is_dated(part)]
    start = min((float(found[i].frame["time_s"].min()) for i in dated), default=0.0)
    out = []
    for i, one in enumerate(found):
        # One clock for all tables: its zero is the earliest of their times.
        frame = one.frame.assign(time_s=one.frame["time_s"] - start) if i in dated else one.frame
        frame = validate_table(frame, table_format(one.table, robot.n), one.source, targets)
        out.append(Imported(one.table, frame, one.samples, one.scatter, one.source, one.notes, one.pairing))
    return tuple(out)


def _is_dated(part: TableMapping) -> bool:
    return "time" in part.columns and part.columns["time"].unit == DATE


def _one(mapping: Mapping, part: TableMapping, robot: RobotDescription) -> Imported:
    cells = read_cells(part.files, part.reading)
    for join in part.joins:
        cells = joined(cells, join, mapping.path)
    notes = list(cells.notes)
    lost = _lost(mapping.path, part, cells)
    if lost.any():
        notes.append(f"{int(lost.sum())} of {len(cells)} rows are left out, since their points were lost")
        if lost.all():
            raise fault(part.files[0], expected="a row with a position", found=f"{len(cells)} lost ones")
        cells = cells.take(np.flatnonzero(~lost))
    logs = None
    if part.pairing is not None:
        logs = paired(mapping.path, part, cells, robot)
        cells = logs.cells
        notes += logs.notes
    frame = _columns(mapping.path, part, cells, robot)
    if logs is not None:
        frame = frame.assign(**logs.columns(frame))
    frame = _completed(mapping.path, part, frame, cells, robot)
    _refuse_units(mapping.path, part, frame, robot)
    named = {
        campaign_name(name): (cells.origins[at], cells.names[at])
        for name, source in part.columns.items()
        for at in ([cells.find(source.columns[0], mapping.path, source.key)] if source.columns else [])
    }
    source = ImportedFile(mapping.path, 0, cells.origins[0], np.arange(len(frame)), named)
    if logs is not None:
        count = int(frame["samples"].sum())
        return Imported(part.table, frame, count, logs.scatter, source, tuple(notes), logs.pairing)
    keys = ["pose", "visit", "target"]
    if part.table not in ("poses", "verification") or not frame.duplicated(keys).any():
        return Imported(part.table, frame, len(frame), None, source, tuple(notes))
    if not part.repeats:
        raise _repeated(part, frame, keys, source, mapping.path)
    short, scatter, first = medians(frame, source, robot.n)
    source = ImportedFile(mapping.path, 0, cells.origins[0], first, named)
    return Imported(part.table, short, len(frame), scatter, source, tuple(notes))


def _repeated(
    part: TableMapping, frame: pd.DataFrame, keys: list[str], source: ImportedFile, path: Path
) -> CampaignError:
    row = int(np.flatnonzero(frame.duplicated(keys, keep="first"))[0])
    same = (frame[keys] == frame.loc[row, keys]).all(axis=1).to_numpy()
    said = ", ".join(f"{key} {frame[key].iloc[row]}" for key in keys)
    remedy = f'in {path.name}, repeats = "median" takes medians, visit = {{number = "returns"}} numbers returns'
    return source.fault(expected=f"one row of {said} ({remedy})", found=f"{int(same.sum())}", row=row)


def _lost(path: Path, part: TableMapping, cells: Cells) -> Bools:
    """Rows ``(rows,)`` of which the mapping says that the instrument had lost the point."""
    out = np.zeros(len(cells), dtype=bool)
    if part.lost is None:
        return out
    asked = [
        (c, part.columns[a].key) for a in (*"xyz", "distance") if a in part.columns for c in part.columns[a].columns
    ]
    for group in (part.position, part.orientation):
        asked += [(column, group.key) for column in group.columns] if group else []
    for column, key in asked:
        out |= np.isin(cells.columns[cells.find(column, path, key)].astype(str), part.lost)
    return out


def _columns(path: Path, part: TableMapping, cells: Cells, robot: RobotDescription) -> pd.DataFrame:
    """Every column that the mapping names, in the campaign's units."""
    out: dict[str, Any] = {}
    for name, source in part.columns.items():
        if source.number is None:
            out[campaign_name(name)] = _column(path, name, source, cells)
    if part.position is not None:
        found = [numbers(cells, cells.find(c, path, part.position.key)) for c in part.position.columns]
        out |= dict(zip(POSITION, points(part.position, np.column_stack(found)).T, strict=True))
    if part.orientation is not None:
        at = [cells.find(c, path, part.orientation.key) for c in part.orientation.columns]
        found = [numbers(cells, i) for i in at]
        turned, wrong, expected = quaternions(part.orientation, np.column_stack(found))
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            said = " ".join(str(cells.columns[i][row]) for i in at)
            which = ", ".join(cells.names[i] for i in at)
            raise cells.origins[at[0]].fault(row, expected=expected, found=said, column=which)
        out |= dict(zip(QUATERNION, turned.T, strict=True))
    for i, joint in enumerate(robot.joints):
        source_of = part.columns.get(f"q{i + 1}")
        sliding = source_of is not None and source_of.unit in UNITS["length"]
        if source_of is not None and sliding != (joint.kind == "prismatic"):
            known = ", ".join(UNITS["length" if joint.kind == "prismatic" else "angle"])
            raise fault(path, expected=f"a unit of a {joint.kind} joint, one of {known}", found=repr(source_of.unit),
                        column=source_of.key)  # fmt: skip
    return pd.DataFrame(out, index=range(len(cells)))


def _column(path: Path, name: str, source: Source, cells: Cells) -> Any:
    """One column ``(rows,)``."""
    kind = kind_of(name)
    if source.value is not None:
        return _same(kind, source, len(cells))
    if source.unit == DATE:
        return dates(cells, source, path)
    at = cells.find(source.columns[0], path, source.key)
    match kind:
        case "text":
            return labels(cells, at)
        case "count":
            found = counts(cells, at, name)
            return np.round(source.scale * found).astype(np.int64) if name.startswith("dir") else found
        case "extra":
            return _kept(cells, at, source.scale)
        case _:
            return to_si(source.scale * numbers(cells, at, gaps=kind == "temperature"), source.unit)


def _same(kind: str, source: Source, rows: int) -> Any:
    """One value in every row."""
    if kind in ("text", "extra") or source.value is None:
        return np.full(rows, str(source.value) if kind == "text" else source.value)
    same = to_si(np.array([source.scale * float(source.value)]), source.unit)[0]
    return np.full(rows, int(same) if kind == "count" and same == round(same) else same)


def _kept(cells: Cells, at: int, scale: float) -> Any:
    """A column that the campaign format does not know: numbers where all are, else text."""
    try:
        return scale * numbers(cells, at, gaps=True)
    except CampaignError:
        return cells.columns[at]


def _completed(
    path: Path, part: TableMapping, frame: pd.DataFrame, cells: Cells, robot: RobotDescription
) -> pd.DataFrame:
    """The table with what the mapping left to be filled in, its columns in the campaign's order."""
    n, layout = robot.n, table_format(part.table, robot.n)
    if layout.run is not None:
        if layout.run not in frame:
            frame[layout.run] = cells.origins[0].file + 1  # one file, one run
    else:
        angles = [name for name in (f"q{i + 1}_rad" for i in range(n)) if name in frame]
        how = part.columns["pose"].number if "pose" in part.columns else None
        if how == "rows":
            frame["pose"] = np.arange(1, len(frame) + 1)
        elif how == "postures":
            frame["pose"] = postures(frame[angles].to_numpy(dtype=np.float64))
        numbered = "visit" in part.columns and part.columns["visit"].number == "returns"
        if "visit" not in frame:
            frame["visit"] = returns(frame["pose"].to_numpy()) if numbered and "pose" in frame else 1
        if "time_s" not in frame:
            frame["time_s"] = np.arange(len(frame), dtype=float)
        moves = directions(frame[angles].to_numpy(dtype=np.float64)) if part.directions and len(angles) == n else None
        for i in range(n):
            if f"dir{i + 1}" not in frame:
                frame[f"dir{i + 1}"] = 0 if moves is None else moves[:, i]
    wanted = [column.name for column in layout.required]
    for name in wanted:
        if name not in frame:
            short = next((c for c in _short_names(part.table, n) if campaign_name(c) == name), name)
            raise fault(path, expected=f"{part.key}columns to say where {short} comes from", found="nothing about it")
    return frame[[*wanted, *(name for name in frame.columns if name not in wanted)]].copy()


def _short_names(table: str, n: int) -> list[str]:
    joints = [f"{stem}{i + 1}" for i in range(n) for stem in ("q", "qd", "tau", "motor", "dir")]
    return ["pose", "visit", "run", "sweep", "joint", "time", "target", "x", "y", "z", "anchor", "distance", *joints]


def _refuse_units(path: Path, part: TableMapping, frame: pd.DataFrame, robot: RobotDescription) -> None:
    """Refuse angles whose stated unit cannot be the right one, whatever the robot."""
    if part.table == "clamped":
        return  # motor angles
    turning = [i for i, joint in enumerate(robot.joints) if joint.kind != "prismatic"]
    largest = {f"q{i + 1}": float(frame[f"q{i + 1}_rad"].abs().max()) for i in turning}
    for name, value in largest.items():
        if part.columns[name].unit == "rad" and value > FEW_TURNS:
            raise fault(
                path, expected=f"a unit in which {name} makes sense: rad and values up to {value:g} are "
                f"{value / (2 * np.pi):.0f} turns", found="'rad'; 'deg' is probably meant",
                column=part.columns[name].key,
            )  # fmt: skip
    degrees = [np.rad2deg(largest[name]) for name in largest if part.columns[name].unit == "deg"]
    if "pose" in frame and len(degrees) == len(turning) and max(degrees) < STILL and frame["pose"].nunique() > 2:
        raise fault(
            path, expected=f"a unit in which the arm moves: deg, and all joints within {max(degrees):.3g} deg "
            "of zero in all poses", found="'deg'; 'rad' is probably meant", column=part.columns["q1"].key,
        )  # fmt: skip
