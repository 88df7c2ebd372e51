"""Holds one table against the contract: its columns, types, ranges and order; the first deviation is an error."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from experiments.columns import POSITION, QUATERNION, Column, TableFormat, lookalike, temperature_columns
from experiments.errors import CampaignError
from experiments.tables import TableFile

__all__ = ["increasing", "typed_columns", "validate_table"]

# Nine printed digits give a norm right to 1e-8. Rounding to three digits stays within 1e-3; a wrong order or sign of
# components does not change the norm, so that what exceeds this is not a unit quaternion at all.
QUATERNION_TOLERANCE = 1e-3

LEAST_STEP_S = 1e-5  # of a log: controllers sample at 10 kHz at most
LARGEST_WHOLE = 2**53  # from here on, neighbouring numbers are one and the same as floats
LARGEST_NUMBER = 1e12  # in SI: beyond any angle, speed, torque, length, temperature and time, and far from overflow


def validate_table(
    frame: pd.DataFrame, table: TableFormat, source: TableFile, targets: Collection[str]
) -> pd.DataFrame:
    """Check a table and give its columns the contract's types.

    Parameters
    ----------
    frame
        The table as read.
    table
        Its format for this robot.
    source
        The file it came from, for messages.
    targets
        Names of the targets declared in ``campaign.toml``.

    Returns
    -------
    pandas.DataFrame
        The same rows; the contract's numbers float64, its counts int64; extra columns untouched.

    Raises
    ------
    CampaignError
        On the first deviation from the contract.
    """
    result = typed_columns(frame, table, source)
    if table.run is not None:
        _refuse_unordered(result, table.run, source)
        _refuse_tiny_steps(result, table.run, source)
    else:
        _refuse_repeated(result, source)
        _refuse_bad_quaternions(result, source)
        if "target" in table.known():
            _refuse_unknown_targets(result, targets, source)
        if "at" in table.known():
            _refuse_unknown_bodies(result, source)
    return result


def _refuse_tiny_steps(frame: pd.DataFrame, run: str, source: TableFile) -> None:
    """A clock in another unit than seconds: what looks at a log sample by sample would take for ever."""
    if "time_s" not in frame or len(frame) < 2:
        return
    step = np.diff(frame["time_s"].to_numpy())[np.diff(frame[run].to_numpy()) == 0]
    median = float(np.median(step)) if step.size else np.inf
    if median < LEAST_STEP_S:
        expected = f"seconds, with steps of at least {LEAST_STEP_S:g} s"
        raise source.fault(expected=expected, found=f"steps of {median:.3g} s", column="time_s")


def typed_columns(frame: pd.DataFrame, table: TableFormat, source: TableFile) -> pd.DataFrame:
    """The same rows with the columns of a format checked for what their cells may hold, and of its types.

    Raises
    ------
    CampaignError
        A column is missing, or a cell holds something else.
    """
    present = _present(frame, table, source)
    typed = {column.name: _typed(frame[column.name], column, source) for column in present}
    columns = {name: typed[name] if name in typed else frame[name] for name in frame.columns}
    return pd.DataFrame(columns, index=frame.index, copy=False)  # at once: ten times as fast as one after the other


def _present(frame: pd.DataFrame, table: TableFormat, source: TableFile) -> list[Column]:
    """Columns of the contract that this table has; a missing required one or half a group is an error."""
    extra = [str(name) for name in frame.columns if name not in table.known()]
    _refuse_missing([c for c in table.required if c.name not in frame], extra, "", source)
    present = list(table.required)
    for group in table.optional:
        missing = [c for c in group if c.name not in frame]
        if len(missing) == len(group):
            continue
        _refuse_missing(missing, extra, f" (all of {group[0].name} … {group[-1].name}, or none)", source)
        present += group
    return present + [Column(name, gaps=True) for name in temperature_columns(map(str, frame.columns))]


def _refuse_missing(missing: list[Column], extra: list[str], why: str, source: TableFile) -> None:
    if not missing:
        return
    names = [c.name for c in missing]
    near = {name: lookalike(name, extra) for name in names}
    misnamed = [f"{near[name]!r} in place of {name!r}" for name in names if near[name]]
    found = "no such column"
    if misnamed:
        found += ", but " + ", ".join(misnamed[:3]) + (" …" if len(misnamed) > 3 else "")
    if len(names) > 1:
        found += f"; missing in all: {', '.join(names)}"
    raise source.fault(expected=f"a column {names[0]!r}{why}", found=found, column=names[0])


def _typed(cells: pd.Series, column: Column, source: TableFile) -> npt.NDArray[np.float64] | pd.Series:
    return _text(cells, column, source) if column.kind == "text" else _numbers(cells, column, source)


def _text(cells: pd.Series, column: Column, source: TableFile) -> pd.Series:
    text = cells.astype(str)
    blank = np.fromiter((not str(one).strip() for one in text), dtype=bool, count=len(text))
    empty = np.flatnonzero(cells.isna().to_numpy() | blank)
    if empty.size:
        raise _cell_fault(cells, column, empty, source)
    return text


def _numbers(cells: pd.Series, column: Column, source: TableFile) -> npt.NDArray[np.float64]:
    kind = cells.dtype
    if isinstance(kind, np.dtype) and kind.kind in "fiu":
        values = cells.to_numpy().astype(np.float64, copy=False)
        empty = np.isnan(values)
    elif pd.api.types.is_numeric_dtype(cells) and not pd.api.types.is_bool_dtype(cells):
        empty, values = cells.isna().to_numpy(), cells.to_numpy(dtype=np.float64, na_value=np.nan)
    else:
        empty = cells.isna().to_numpy()
        # Text, dates and truth values are not numbers, even where they could be read as such.
        numbers = np.array([isinstance(v, int | float | np.number) and not isinstance(v, bool) for v in cells])
        if source.path.suffix == ".csv":
            numbers = pd.to_numeric(cells.astype(str), errors="coerce").notna().to_numpy()
        bad = np.flatnonzero(~(numbers | empty))
        if bad.size:
            raise _cell_fault(cells, column, bad, source)
        values = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
    bad = np.flatnonzero(~np.isfinite(values) & ~(empty & column.gaps))
    if bad.size:
        raise _cell_fault(cells, column, bad, source)
    beyond = np.abs(values) > LARGEST_NUMBER
    if beyond.any() and column.kind == "number" and column.upper is None:
        low = -LARGEST_NUMBER if column.lower is None else column.lower
        raise _cell_fault(cells, replace(column, lower=low, upper=LARGEST_NUMBER), np.flatnonzero(beyond), source)
    wrong = np.zeros(len(values), dtype=bool)
    if column.lower is not None:
        wrong |= values < column.lower
    if column.upper is not None:
        wrong |= values > column.upper
    if column.kind == "integer":
        wrong |= (values != np.rint(values)) | (np.abs(values) >= LARGEST_WHOLE)
    if wrong.any():
        raise _cell_fault(cells, column, np.flatnonzero(wrong), source)
    return values.astype(np.int64) if column.kind == "integer" else values


def _cell_fault(cells: pd.Series, column: Column, bad: npt.NDArray[np.intp], source: TableFile) -> CampaignError:
    row = int(bad[0])
    found = source.cell(row, column.name, cells.iloc[row])
    if bad.size > 1:
        found += f" (and {bad.size - 1} more such rows, the last in row {source.number(int(bad[-1]))})"
    return source.fault(expected=column.expected, found=found, row=row, column=column.name)


def _refuse_unordered(frame: pd.DataFrame, run: str, source: TableFile) -> None:
    """Time increases within a run; a repeated stamp is a repeated row, or two logs under one number."""
    runs, time = frame[run].to_numpy(), frame["time_s"].to_numpy()
    order = np.argsort(runs, kind="stable")
    if not ((np.diff(runs[order]) == 0) & (np.diff(time[order]) <= 0.0)).any():
        return
    repeated = np.flatnonzero(frame.duplicated([run, "time_s"]).to_numpy())
    if repeated.size:
        row = int(repeated[0])
        first = int(np.flatnonzero((runs == runs[row]) & (time == time[row]))[0])
        whole = ", the whole row repeated" if _equal_rows(frame, row)[first] else ""
        found = f"the time of row {source.number(first)} again ({time[row]:.10g} s{whole})" + _more(repeated.size)
        raise source.fault(expected=increasing(run, runs[row]), found=found, row=row, column="time_s")
    late = np.flatnonzero((np.diff(runs[order]) == 0) & (np.diff(time[order]) < 0.0))
    if late.size:
        before, row = int(order[late[0]]), int(order[late[0] + 1])
        found = f"{time[row]:.10g} s after {time[before]:.10g} s in row {source.number(before)}" + _more(late.size)
        raise source.fault(expected=increasing(run, runs[row]), found=found, row=row, column="time_s")


def increasing(run: str, number: int) -> str:
    """What a log's time must do, in words."""
    return f"time increasing within {run} {number}"


def _more(count: int) -> str:
    return f" (and {count - 1} more such rows)" if count > 1 else ""


def _refuse_repeated(frame: pd.DataFrame, source: TableFile) -> None:
    for name in ("time_s", POSITION[0]):  # rows that differ in one column are not equal: no need to look at the others
        if name in frame and len(np.unique(frame[name].to_numpy())) == len(frame):
            return
    repeated = np.flatnonzero(frame.duplicated(keep="first").to_numpy())
    if repeated.size == 0:
        return
    row = int(repeated[0])
    first = int(np.flatnonzero(_equal_rows(frame, row))[0])
    known = [name for name in ("pose", "visit", "target", "at") if name in frame]
    said = ", ".join(f"{name} {frame[name].iloc[row]}" for name in known)
    found = f"row {first + 1} again ({said})" + _more(repeated.size)
    raise source.fault(expected="every measurement once", found=found, row=row, column=known[0])


def _equal_rows(frame: pd.DataFrame, row: int) -> npt.NDArray[np.bool_]:
    """Rows equal to one row, where empty cells of extra columns equal each other."""
    alike = np.ones(len(frame), dtype=bool)
    for position in range(frame.shape[1]):
        cells = frame.iloc[:, position]
        value = cells.iloc[row]
        alike &= (cells.isna() if pd.isna(value) else cells == value).to_numpy(dtype=bool, na_value=False)
    return alike


def _refuse_bad_quaternions(frame: pd.DataFrame, source: TableFile) -> None:
    if QUATERNION[0] not in frame:
        return
    norms = np.linalg.norm(frame[list(QUATERNION)].to_numpy(dtype=np.float64), axis=1)  # (rows,)
    bad = np.flatnonzero(np.abs(norms - 1.0) > QUATERNION_TOLERANCE)
    if bad.size:
        found = f"norm {norms[bad[0]]:.6g}" + _more(bad.size)
        expected = f"a unit quaternion (norm 1 within {QUATERNION_TOLERANCE:g})"
        raise source.fault(expected=expected, found=found, row=int(bad[0]), column="qw, qx, qy, qz")


def _refuse_unknown_targets(frame: pd.DataFrame, targets: Collection[str], source: TableFile) -> None:
    oriented = QUATERNION[0] in frame
    allowed = [*targets, "flange"] if oriented else list(targets)
    bad = np.flatnonzero(~frame["target"].isin(allowed).to_numpy())
    if bad.size:
        expected = f"a target of [targets_m] ({', '.join(targets) or 'it declares none'})"
        # Without orientations a measured flange is a point like any other, and has to be declared as one.
        expected += " or flange" if oriented else "; flange only with columns qw, qx, qy, qz"
        row = int(bad[0])
        found = repr(frame["target"].iloc[row]) + _more(bad.size)
        raise source.fault(expected=expected, found=found, row=row, column="target")


def _refuse_unknown_bodies(frame: pd.DataFrame, source: TableFile) -> None:
    joints = sum(1 for name in frame if re.fullmatch(r"q\d+_rad", str(name)))
    allowed = ["base", *(f"link{i + 1}" for i in range(joints))]
    bad = np.flatnonzero(~frame["at"].isin(allowed).to_numpy())
    if bad.size:
        row = int(bad[0])
        found = repr(frame["at"].iloc[row]) + _more(bad.size)
        raise source.fault(expected=f"base or link1 … link{joints}", found=found, row=row, column="at")
