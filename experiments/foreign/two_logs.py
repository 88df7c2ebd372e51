"""Makes rows of a table of poses from two raw logs, an instrument's and a robot's, whose clocks differ."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from experiments.errors import fault
from experiments.foreign.cells import dates, numbers
from experiments.foreign.files import Cells, read_cells
from experiments.foreign.frames import points
from experiments.foreign.mapping import RobotLog, Source, TableMapping
from experiments.foreign.units import DATE, to_si
from experiments.pairing import Pairing, confirmed, pair_logs
from kinematics import RobotDescription, forward

__all__ = ["TwoLogs", "paired"]

FloatArray = npt.NDArray[np.float64]
# A posture comes again within the repeatability, 1e-4 rad; steps between poses may be much smaller than those of
# tables that were typed.
SAME_POSTURE_RAD = 5e-4
ROBOT_TIME = "time of the robot's log"


@dataclass(frozen=True)
class TwoLogs:
    """Pairs of two logs: the cells of each pair's first samples, and what replaces their numbers."""

    cells: Cells
    pairing: Pairing
    notes: tuple[str, ...]

    @property
    def scatter(self) -> tuple[float, float, float]:
        """Median over the pairs of the standard deviation of one sample, m."""
        x, y, z = np.median([pair.scatter for pair in self.pairing.pairs], axis=0)
        return float(x), float(y), float(z)

    def columns(self, frame: pd.DataFrame) -> dict[str, Any]:
        """Columns of the table that come from all samples of a pair, and those that the mapping leaves open."""
        pairs = self.pairing.pairs
        angles = np.array([pair.joints for pair in pairs])
        out: dict[str, Any] = {"time_s": [pair.time_s for pair in pairs]}
        for k, axis in enumerate("xyz"):
            out[f"{axis}_m"] = [pair.point[k] for pair in pairs]
        for i in range(angles.shape[1]):
            out[f"q{i + 1}_rad"] = angles[:, i]
            out[f"dir{i + 1}"] = np.array([pair.direction[i] for pair in pairs])
        out["samples"] = [len(pair.rows) for pair in pairs]
        for k, axis in enumerate("xyz"):
            out[f"scatter_{axis}_m"] = [pair.scatter[k] for pair in pairs]
        if "pose" not in frame:
            pose, visit = _poses(angles)
            out |= {"pose": pose, "visit": visit}
        return {name: value for name, value in out.items() if not name.startswith("dir") or name not in frame}


def _poses(angles: FloatArray) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Numbers of postures from 1, and which visit to its posture each stop is."""
    known: list[FloatArray] = []
    visits: list[int] = []
    out = np.empty((len(angles), 2), dtype=np.int64)
    for row, q in enumerate(angles):
        near = np.abs(np.array(known) - q).max(axis=1) if known else np.zeros(0)
        at = int(np.argmin(near)) if near.size else 0
        if not near.size or near[at] > SAME_POSTURE_RAD:
            known.append(q)
            visits.append(0)
            at = len(known) - 1
        visits[at] += 1
        out[row] = at + 1, visits[at]
    return out[:, 0], out[:, 1]


def paired(mapping: Path, part: TableMapping, cells: Cells, robot: RobotDescription) -> TwoLogs:
    """Pair the table's files, the instrument's log, with the robot's log.

    Raises
    ------
    CampaignError
        A column is missing, a cell is no number, a time does not increase, or the logs do not belong together.
    """
    log = part.pairing
    if log is None:
        raise fault(mapping, expected="a table [pairing]", found="none")
    theirs = read_cells(log.files, log.reading)
    theirs = replace(theirs, names=tuple(log.prefix + name for name in theirs.names))
    own_time = replace(log.time, columns=tuple(log.prefix + c if isinstance(c, str) else c for c in log.time.columns))
    time = _times(mapping, part.columns.get("time"), cells, f"{part.key}columns.time")
    robot_time = _times(mapping, own_time, theirs, f"{log.key}.time")
    place = _points(mapping, part, cells)
    joints = _joints(mapping, part, theirs, robot)
    try:
        pairing = pair_logs(time, place, robot_time, joints, near_s=log.offset)
        poses = np.array([pair.joints for pair in pairing.pairs])
        if _one_target(part):
            pairing = confirmed(pairing, forward(robot.screws, robot.flange, poses @ robot.linkage.T))
    except ValueError as error:
        expected, _, found = str(error).removeprefix("expected ").partition(", found ")
        raise fault(log.files[0], expected=expected, found=f"{found} (beside {part.files[0]})") from None
    first = np.array([pair.rows[0] for pair in pairing.pairs], dtype=np.intp)
    robot_first = np.array([pair.robot_row for pair in pairing.pairs], dtype=np.intp)
    return TwoLogs(_beside(cells.take(first), theirs.take(robot_first), log, theirs, own_time, mapping), pairing,
                   theirs.notes)  # fmt: skip


def _beside(cells: Cells, robot: Cells, log: RobotLog, theirs: Cells, time: Source, mapping: Path) -> Cells:
    """Both logs' cells of each pair; the robot's time, used up, does not clash with the instrument's."""
    used = {theirs.find(column, mapping, f"{log.key}.time") for column in time.columns}
    names = tuple(ROBOT_TIME if i in used else name for i, name in enumerate(robot.names))
    return replace(
        cells, names=(*cells.names, *names), columns=(*cells.columns, *robot.columns),
        origins=(*cells.origins, *robot.origins), readings=(*cells.readings, *robot.readings),
    )  # fmt: skip


def _one_target(part: TableMapping) -> bool:
    target = part.columns.get("target")
    return target is not None and target.value is not None


def _times(mapping: Path, source: Source | None, cells: Cells, key: str) -> FloatArray:
    """Increasing times ``(rows,)``, s."""
    if source is None or not source.columns:
        raise fault(mapping, expected=f"{key} = {{from, unit}}, the log's own clock", found="nothing", column=key)
    at = cells.find(source.columns[0], mapping, source.key)
    time = dates(cells, source, mapping) if source.unit == DATE else _si(cells, at, source)
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size:
        row = int(back[0]) + 1
        text = f"{cells.columns[at][row]!r} after {cells.columns[at][row - 1]!r}"
        raise cells.origins[at].fault(row, expected="a later time than before", found=text, column=cells.names[at])
    return time


def _si(cells: Cells, at: int, source: Source) -> FloatArray:
    return np.asarray(to_si(source.scale * numbers(cells, at), source.unit))


def _points(mapping: Path, part: TableMapping, cells: Cells) -> FloatArray:
    """Points ``(rows, 3)`` m of the instrument's log."""
    if part.position is not None:
        found = [numbers(cells, cells.find(c, mapping, part.position.key)) for c in part.position.columns]
        return np.asarray(points(part.position, np.column_stack(found)))
    return np.column_stack([_mapped(mapping, part, cells, axis) for axis in "xyz"])


def _joints(mapping: Path, part: TableMapping, cells: Cells, robot: RobotDescription) -> FloatArray:
    """Joint values ``(rows, n)`` of the robot's log."""
    return np.column_stack([_mapped(mapping, part, cells, f"q{i + 1}") for i in range(robot.n)])


def _mapped(mapping: Path, part: TableMapping, cells: Cells, name: str) -> FloatArray:
    source = part.columns.get(name)
    if source is None or not source.columns:
        key = f"{part.key}columns.{name}"
        raise fault(mapping, expected=f"a column of {cells.origins[0].files[0].name}", found="nothing", column=key)
    if not isinstance(source.columns[0], str):
        expected = f"the column's name, since {cells.origins[0].files[0].name} is one of two logs"
        raise fault(mapping, expected=expected, found=f"{source.columns[0]}", column=source.key)
    return _si(cells, cells.find(source.columns[0], mapping, source.key), source)
