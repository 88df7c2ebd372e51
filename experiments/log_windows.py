"""Logs read a window at a time, with the rows on either side that filters reach for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pa_parquet

from experiments.columns import temperature_columns
from experiments.errors import fault
from experiments.steady_temperatures import SteadyTemperatures

__all__ = ["LogTable", "Window", "batches", "windows"]

Columns = Mapping[str, npt.NDArray[np.float64]]
BATCH = 1 << 16  # rows decoded at once


@dataclass(frozen=True)
class Window:
    """Some rows of a log and their neighbours.

    Attributes
    ----------
    columns
        Name → ``(w,)``: the rows with those around them.
    first
        Which row of the log the first of them is, from 0.
    start, stop
        Of the rows, those that are the window's own; every row of the log is of one window.
    """

    columns: Columns
    first: int
    start: int
    stop: int


@dataclass(frozen=True, eq=False)
class LogTable:
    """A table ``free_air`` or ``wrist``: in memory, or in a Parquet file that is read, and checked, as it is needed.

    Attributes
    ----------
    source
        The table, or the path of the file.
    names
        Its columns.
    rows
        How many rows it has.
    steadies
        Whether temperatures are read with their noise averaged out, or as recorded.
    """

    source: pd.DataFrame | Path
    names: tuple[str, ...]
    rows: int
    steadies: bool = False

    @staticmethod
    def of(source: pd.DataFrame | Path) -> LogTable:
        """A table in memory and checked, or a Parquet file, whose rows are not read yet.

        Raises
        ------
        CampaignError
            The file is none, or damaged; later, when its rows are read: a cell is no number, time does not increase.
        """
        if isinstance(source, pd.DataFrame):
            return LogTable(source, tuple(map(str, source.columns)), len(source))
        try:
            with pa_parquet.ParquetFile(source) as file:
                return LogTable(source, tuple(file.schema_arrow.names), int(file.metadata.num_rows))
        except (pa.ArrowException, OSError) as error:
            reason = str(error).strip().splitlines()[0]
            raise fault(source, expected="a whole Parquet file", found=f"none that can be read ({reason})") from error

    def steadied(self) -> LogTable:
        """The same with the noise of its temperatures' readings averaged out."""
        return replace(self, steadies=True)

    @cached_property
    def _steady(self) -> SteadyTemperatures:
        """Its temperatures, smoothed; reads the whole table once."""
        return SteadyTemperatures.of(self._read(["run", "time_s", *temperature_columns(self.names)]))

    def frame(self, names: Sequence[str]) -> pd.DataFrame:
        """Columns of all of its rows, in memory."""
        return pd.concat([pd.DataFrame(dict(c)) for c in self.chunks(names)], ignore_index=True)

    def chunks(self, names: Sequence[str]) -> Iterator[Columns]:
        """Columns in pieces, one after the other: all at once if the table is in memory.

        Raises
        ------
        KeyError
            Temperatures are to be smoothed, and ``run`` or ``time_s`` is not among the names.
        """
        smoothed = self.steadies and temperature_columns(names)
        for columns in self._read(names):
            yield self._steady.replacing(columns) if smoothed else columns

    def _read(self, names: Sequence[str]) -> Iterator[Columns]:
        if isinstance(self.source, pd.DataFrame):
            yield {name: self.source[name].to_numpy(np.float64) for name in names}
            return
        done = 0
        with pa_parquet.ParquetFile(self.source) as file:
            for batch in batches(file, names):
                columns = {name: self._numbers(batch.column(name), name, done) for name in names}
                self._refuse_unordered(columns, done)
                done += batch.num_rows
                yield columns

    def _numbers(self, cells: pa.Array, name: str, done: int) -> npt.NDArray[np.float64]:
        """One column of some rows, the first of them row ``done`` from 0; speeds may be absent."""
        try:
            values = np.asarray(cells.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64)
        except pa.ArrowException as error:
            raise fault(Path(str(self.source)), expected="numbers", found=f"{cells.type}", column=name) from error
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad) and not name.startswith("qd"):
            row = done + int(bad[0]) + 1
            found = "an empty cell" if np.isnan(values[bad[0]]) else f"{values[bad[0]]}"
            raise fault(Path(str(self.source)), expected="a finite number", found=found, row=row, column=name)
        return values

    def _refuse_unordered(self, columns: Columns, done: int) -> None:
        if "time_s" in columns and "run" in columns:
            run, time = columns["run"], columns["time_s"]
            late = np.flatnonzero((run[1:] == run[:-1]) & (time[1:] <= time[:-1]))
            if len(late):
                k = int(late[0])
                found = f"{time[k + 1]:.10g} s after {time[k]:.10g} s"
                expected = f"time increasing within run {run[k]:.0f}"
                raise fault(Path(str(self.source)), expected=expected, found=found, row=done + k + 2, column="time_s")


def batches(file: pa_parquet.ParquetFile, names: Sequence[str]) -> Iterator[pa.RecordBatch]:
    """Rows of a Parquet file in pieces; what one of its row groups took is let go before the next is read.

    Asked for all row groups at once, pyarrow keeps what it has decoded until the end.
    """
    for group in range(file.metadata.num_row_groups):
        yield from file.iter_batches(BATCH, row_groups=[group], columns=list(names), use_threads=False)


def windows(table: LogTable, names: Sequence[str], rows: int, halo: int) -> Iterator[Window]:
    """A log in windows of at most ``rows`` rows, with ``halo`` rows on either side where there are so many.

    A window ends with a run where one ends in its second half, so that fewer filters have to reach across.

    Parameters
    ----------
    table
        The log.
    names
        Which columns; ``run`` among them.
    """
    buffered: dict[str, npt.NDArray[np.float64]] = {}
    first = own = 0  # the log's row that is buffered[0], and the buffered row that the next window starts with
    for chunk in table.chunks(names):
        buffered = {n: np.concatenate([buffered[n], v]) for n, v in chunk.items()} if buffered else dict(chunk)
        while len(buffered["run"]) - own >= rows + halo:
            stop = _end(buffered["run"], own, own + rows)
            start = max(own - halo, 0)
            part = {n: v[start : stop + halo] for n, v in buffered.items()}
            yield Window(part, first + start, own - start, stop - start)
            own = stop
        keep = max(own - halo, 0)
        buffered, first, own = {n: v[keep:] for n, v in buffered.items()}, first + keep, own - keep
    while buffered and own < len(buffered["run"]):
        stop = _end(buffered["run"], own, own + rows) if len(buffered["run"]) - own > rows else len(buffered["run"])
        start = max(own - halo, 0)
        yield Window({n: v[start : stop + halo] for n, v in buffered.items()}, first + start, own - start, stop - start)
        own = stop


def _end(run: npt.NDArray[np.float64], own: int, full: int) -> int:
    middle = (own + full + 1) // 2
    ends = np.flatnonzero(run[middle:full] != run[middle - 1 : full - 1])
    return middle + int(ends[-1]) if len(ends) else full
