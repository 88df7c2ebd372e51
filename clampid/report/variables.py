"""Every recorded variable that a residual may depend on, and how much of the residual it explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clampid.report.stage_data import StageData
from clampid.stages.further_columns import further_of
from clampid.stages.rows import Array, Bools
from experiments.checks.clock import counts_rows

__all__ = ["Trend", "Variable", "explained", "trend", "variables_of"]

BINS = 12
FLIPS = 99
GAP = 0.1  # of a variable's range without a row: no line is drawn across
MIN_ROWS_PER_MEDIAN = 3  # rows that a median is drawn of
EQUAL_WITHIN = 1e-9  # of a variable's largest value, or of 1: values that differ by less are equal
MOST_SINGLE_VALUES = 8  # distinct values up to which a variable is grouped by value instead of by quantiles


@dataclass(frozen=True)
class Variable:
    """A recorded variable.

    Attributes
    ----------
    name
        As the campaign format calls it, without unit.
    values
        ``(N,)``, or ``(N, channels)`` where each panel has its own (a motor against its own speed).
    labels
        Names of the values of a variable that is a category.
    """

    name: str
    title: str
    values: Array
    labels: tuple[str, ...] = ()

    def of(self, channel: int) -> Array:
        """Values for one panel ``(N,)``."""
        return self.values if self.values.ndim == 1 else self.values[:, channel]


@dataclass(frozen=True)
class Trend:
    """Running median and quartiles of a residual along a variable ``(bins,)``, in stretches parted by NaN."""

    x: Array
    median: Array
    low: Array
    high: Array


def variables_of(data: StageData) -> tuple[Variable, ...]:
    """The recorded variables of a stage that vary at all, in units for people."""
    n = data.first.rows.robot.n
    found: list[Variable] = []

    def joints(name: str, title: str, values: Array) -> None:
        found.extend(Variable(f"{name}{i + 1}", title.format(i + 1), values[:, i]) for i in range(n))

    motors = not data.kind.points
    if motors:
        found.append(Variable("motor angle", "angle of the same motor, rad", data.stacked("motor")))
    if data.kind.moving:
        found.append(Variable("motor speed", "speed of the same motor, rad/s", data.stacked("motor_speed")))
        acceleration = data.stacked("joint_acceleration")
    if motors:
        predicted = np.concatenate([p.rows.measured - p.residual for p in data.pieces])
        found.append(Variable("torque", "torque predicted at the same motor, Nm", predicted))
    joints("q", "joint angle q{}, deg", np.degrees(data.stacked("q")))
    if data.kind.points:
        joints("dir", "direction of the last motion of joint {}, ±1", data.stacked("direction"))
        joints("load", "gravity torque at joint {}, Nm", data.stacked("gravity_torque"))
    if data.kind.moving:
        joints("qd", "speed of joint {}, rad/s", data.stacked("joint_speed"))
        joints("qdd", "acceleration of joint {}, rad/s²", acceleration)
        joints("load", "gravity torque at joint {}, Nm", data.stacked("gravity_torque"))
    if data.kind.solved:
        found.append(_category("joint driven", "joint driven", data.first.rows.sweep.driven + 1))
        found.append(_category("sweep", "sweep", data.first.rows.series.run + 1))
        found.append(Variable("sweep_fraction", "fraction of the sweep, 0 to 1", data.stacked("sweep_fraction")))
        joints("dir", "direction of motor {}, ±1", data.stacked("motor_motion"))
    time = np.concatenate([p.rows.constants.time for p in data.pieces])
    factor, unit = (60.0, "min") if np.ptp(time) > 600.0 else (1.0, "s")
    if counts_rows(np.sort(time)):
        found.append(Variable("time", "number of the row", time))
    else:
        found.append(Variable("time", f"time, {unit}", (time - time.min()) / factor))
    found += [*_temperatures(data), *_further(data)]
    if data.kind.points:
        position = data.stacked("position")
        found += [Variable(a, f"{a} in the instrument's frame, m", position[:, k]) for k, a in enumerate("xyz")]
        target = data.column("target")
        if target is not None:
            found.append(_category("target", "target", target.astype(str).to_numpy()))
    rounded = (_rounded(variable) for variable in found)
    return tuple(variable for variable in rounded if np.nanmax(variable.values, initial=-np.inf) > _least(variable))


def _rounded(variable: Variable) -> Variable:
    """The variable without rounding errors, which would otherwise split rows into bins by chance."""
    finite = variable.values[np.isfinite(variable.values)]
    step = EQUAL_WITHIN * max(1.0, float(np.abs(finite).max(initial=0.0)))
    return replace(variable, values=step * np.round(variable.values / step))


def _least(variable: Variable) -> float:
    return float(np.nanmin(variable.values, initial=np.inf))


def _category(name: str, title: str, values: np.ndarray) -> Variable:
    labels, index = np.unique(values, return_inverse=True)
    return Variable(name, title, index.astype(float), tuple(str(v) for v in labels))


def _temperatures(data: StageData) -> list[Variable]:
    found = []
    columns = next(iter(data.frames.values())).columns if not data.pieces else data.frames[_table(data)].columns
    for column in columns:
        if str(column).startswith("temp_"):
            series = data.column(str(column))
            if series is not None:
                name = str(column).removesuffix("_C")
                where = name.removeprefix("temp_")
                found.append(Variable(name, f"temperature of {where}, °C", series.to_numpy(float)))
    return found


def _further(data: StageData) -> list[Variable]:
    """Columns beyond the contract that all rows have as signals."""
    everywhere = [name for name in further_of(data.first.rows) if all(name in p.rows.signals for p in data.pieces)]
    return [Variable(name, f"column {name}", data.stacked(name)) for name in everywhere]


def _table(data: StageData) -> str:
    return str(data.first.rows.table[0])


def groups_of(x: Array) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """The bin of each value ``(N,)``, −1 where it is not finite: by value where there are few, else by quantiles."""
    out = np.full(len(x), -1, dtype=np.int64)
    finite = np.isfinite(x)
    if not finite.any():
        return out
    distinct = np.unique(x[finite])
    if len(distinct) <= MOST_SINGLE_VALUES:
        out[finite] = np.searchsorted(distinct, x[finite])
        return out
    edges = np.unique(np.quantile(x[finite], np.linspace(0, 1, BINS + 1)[1:-1]))
    out[finite] = np.searchsorted(edges, x[finite], side="right")
    return out


def trend(x: Array, y: Array, good: Bools) -> Trend:
    """Running median and quartiles of ``y`` along ``x``; where nothing was measured, nothing is drawn across."""
    x = np.where(good, x, np.nan)
    group, stretch = groups_of(x), _stretches(x)
    columns: list[list[float]] = []
    before = 0
    for s, g in np.unique(np.c_[stretch, group][group >= 0], axis=0).tolist():
        rows = np.flatnonzero((stretch == s) & (group == g))
        if len(rows) < MIN_ROWS_PER_MEDIAN:
            continue
        if columns and s != before:
            columns.append([np.nan] * 4)
        columns.append([float(np.median(x[rows])), *np.quantile(y[rows], (0.5, 0.25, 0.75)).tolist()])
        before = s
    return Trend(*np.array(columns).reshape(-1, 4).T)


def _stretches(x: Array) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Which stretch of neighbouring values each ``(N,)`` is of: a variable of many values parts at wide gaps."""
    out = np.zeros(len(x), dtype=np.int64)
    distinct = np.unique(x[np.isfinite(x)])
    if len(distinct) > MOST_SINGLE_VALUES:
        gaps = np.flatnonzero(np.diff(distinct) > GAP * np.ptp(distinct))
        out = np.searchsorted(0.5 * (distinct[gaps] + distinct[gaps + 1]), x)
    return np.asarray(out)


def explained(data: StageData, variables: Sequence[Variable], seed: int) -> tuple[list[float], float]:
    """Share of the residual's variance that its mean along each variable explains, and what chance would give.

    Channels in units of noise. By chance: the largest share over all variables when the residual's signs are flipped
    unit by unit (a pose's visit, a block of a log); its 95 % point of 99 flips.
    """
    floor = data.floor.sigma[: data.channels]
    residual = np.where(data.good, data.residual / floor, 0.0)
    unit, shift = [], 0
    for piece in data.pieces:
        unit.append(piece.rows.unit + shift)
        shift = int(unit[-1].max()) + 1
    _, unit_index = np.unique(np.concatenate(unit), return_inverse=True)
    units = int(unit_index.max()) + 1
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(FLIPS, units))
    total = float((residual**2).sum()) or 1.0
    shares, chance = [], np.zeros(FLIPS)
    for variable in variables:
        true, flipped = 0.0, np.zeros(FLIPS)
        for c in range(data.channels):
            good = data.good[:, c]
            group = groups_of(np.where(good, variable.of(c), np.nan))
            inside = group >= 0
            if not inside.any():
                continue
            bins = int(group.max()) + 1
            sums = np.zeros((units, bins))
            np.add.at(sums, (unit_index[inside], group[inside]), residual[inside, c])
            count = np.maximum(np.bincount(group[inside], minlength=bins), 1)
            true += float((sums.sum(axis=0) ** 2 / count).sum())
            flipped += ((signs @ sums) ** 2 / count).sum(axis=1)
        shares.append(true / total)
        chance = np.maximum(chance, flipped / total)
    return shares, float(np.quantile(chance, 0.95)) if shares else 0.0
