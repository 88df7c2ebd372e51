"""Torque logs larger than memory: every row is checked against the contract, and an extract is kept for checks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow.parquet as pa_parquet

from experiments.columns import TableFormat, joint_columns, temperature_columns
from experiments.errors import CampaignError
from experiments.log_windows import LogTable, batches
from experiments.tables import TableFile, refuse_duplicates
from experiments.validate import increasing, validate_table

__all__ = ["LONG_ROWS", "LongLog", "is_long", "read_long"]

STRETCHES, STRETCH_ROWS = 16, 1 << 15  # of the extract
LONG_ROWS = STRETCHES * STRETCH_ROWS  # a longer log is not held by the verbs that can do without


@dataclass(frozen=True, eq=False)
class LongLog:
    """What is known of the whole of such a log.

    Attributes
    ----------
    table
        Its file.
    runs
        How many there are.
    seconds
        From its first to its last stamp, s.
    travel
        ``(n,)``: how far each joint moves, rad.
    warmth
        The lowest and the highest temperature, degC; None where it has none.
    stretches
        ``(k, 2)``: first row, from 0, and number of rows of each stretch of the extract.
    """

    table: LogTable
    runs: int
    seconds: float
    travel: npt.NDArray[np.float64]
    warmth: tuple[float, float] | None
    stretches: npt.NDArray[np.int64]

    @property
    def words(self) -> str:
        """What the checks beyond the contract judge of it."""
        rows = int(self.stretches[:, 1].sum())
        return (
            f"the log has {self.table.rows} rows: all of them follow the contract; the other findings on it are those "
            f"of {rows} rows in {len(self.stretches)} stretches spread over it, and count rows within these"
        )


def is_long(path: Path, rows: float) -> bool:
    """Whether a table is a Parquet file of more rows; one that cannot be read is not: reading it whole says why."""
    if path.suffix != ".parquet" or rows == np.inf:
        return False
    try:
        return LogTable.of(path).rows > rows
    except CampaignError:
        return False


def read_long(path: Path, layout: TableFormat, n: int) -> tuple[LongLog, pd.DataFrame]:
    """Check every row of a log against the contract, as `experiments.validate` does, and take an extract.

    Parameters
    ----------
    path
        A Parquet file.
    layout
        Its format: ``free_air`` or ``wrist``.
    n
        Number of joints.

    Returns
    -------
    LongLog, pandas.DataFrame
        The extract has the rows of stretches spread evenly; where two stretches are of one run, they get numbers of
        their own.

    Raises
    ------
    CampaignError
        On the first deviation from the contract.
    """
    table = LogTable.of(path)
    refuse_duplicates(path, table.names)
    stretches = _stretches(table.rows)
    kept: list[list[pd.DataFrame]] = [[] for _ in stretches]
    known: dict[int, float] = {}
    ends = np.full((2, n + 1), np.inf) * [[1.0], [-1.0]]
    warmth = (np.inf, -np.inf)
    for first, frame in _pieces(path, layout, known):
        values = frame[["time_s", *joint_columns("q{}_rad", n)]].to_numpy(dtype=np.float64)
        ends = np.array([np.minimum(ends[0], values.min(axis=0)), np.maximum(ends[1], values.max(axis=0))])
        warm = frame[list(temperature_columns(map(str, frame.columns)))].to_numpy(dtype=np.float64)
        if warm.size:
            warmth = min(warmth[0], float(warm.min())), max(warmth[1], float(warm.max()))
        for own, (start, rows) in zip(kept, stretches, strict=True):
            part = frame[max(start - first, 0) : max(start + rows - first, 0)]
            if len(part):
                own.append(part)
    span = ends[1] - ends[0]
    known_warmth = warmth if np.isfinite(warmth[0]) else None
    whole = LongLog(table, len(known), float(span[0]), span[1:], known_warmth, stretches)
    return whole, _joined([pd.concat(own, ignore_index=True) for own in kept])


def _pieces(path: Path, layout: TableFormat, known: dict[int, float]) -> Iterator[tuple[int, pd.DataFrame]]:
    """First row and rows of each piece that follows the contract; the last stamp of every run goes to ``known``, s."""
    first = 0
    with pa_parquet.ParquetFile(path) as file:
        for batch in batches(file, file.schema_arrow.names):
            source = TableFile(path, first)
            frame = validate_table(batch.to_pandas(ignore_metadata=True), layout, source, ())
            _refuse_gaps(frame, source)
            run, time = frame["run"].to_numpy(), frame["time_s"].to_numpy()
            numbers, begins = np.unique(run, return_index=True)
            for number, row in sorted(zip(numbers.tolist(), begins.tolist(), strict=True), key=lambda pair: pair[1]):
                if time[row] <= known.get(number, -np.inf):
                    found = f"{time[row]:.10g} s after {known[number]:.10g} s"
                    raise source.fault(expected=increasing("run", number), found=found, row=row, column="time_s")
                known[number] = float(time[run == number][-1])
            yield first, frame
            first += len(frame)


def _refuse_gaps(frame: pd.DataFrame, source: TableFile) -> None:
    """A log that is not held has every temperature: gaps are bridged in whole tables."""
    for name in temperature_columns(map(str, frame.columns)):
        lost = np.flatnonzero(frame[name].isna().to_numpy())
        if lost.size:
            expected = "a temperature in every row of so long a log"
            raise source.fault(expected=expected, found="an empty cell", row=int(lost[0]), column=name)


def _stretches(rows: int) -> npt.NDArray[np.int64]:
    """``(k, 2)``: first row and number of rows of stretches in the middles of equal parts of a log."""
    count = min(STRETCHES, -(-rows // STRETCH_ROWS))
    edges = np.arange(count + 1) * rows // count
    length = np.minimum(np.diff(edges), STRETCH_ROWS)
    return np.asarray(np.c_[edges[:-1] + (np.diff(edges) - length) // 2, length])


def _joined(parts: list[pd.DataFrame]) -> pd.DataFrame:
    """Stretches one after the other; a run that one before was cut out of gets a new number."""
    free = max(int(part["run"].max()) for part in parts) + 1
    seen: set[int] = set()
    for part in parts:
        for number in part["run"].unique().tolist():
            if number in seen:
                part.loc[part["run"] == number, "run"] = free
                free += 1
            seen.add(number)
    return pd.concat(parts, ignore_index=True)
