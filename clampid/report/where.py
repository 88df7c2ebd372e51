"""Where the model fails: residuals against every recorded variable, and their size compared with noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clampid.charts import Axis, Band, Chart, Level, Line, Mark, Panel, Points
from clampid.display import number
from clampid.effect import Stage
from clampid.report.choices import selector
from clampid.report.sizes import sizes_figure
from clampid.report.stage_data import StageData, stage_title
from clampid.report.style import Figure, Section, as_table
from clampid.report.variables import Variable, explained, trend, variables_of
from clampid.stages.rows import Array, Integers

__all__ = ["where_section"]

MOST_POINTS = 1200  # of torque logs, per motor
MOST_ROWS = 3000
LISTED = 6
EDGE = 0.97  # of an axis
LARGEST_RANGE = 20.0  # times the range of the middle 98 % of the rows: beyond, single rows would hide all others


def where_section(stages: Mapping[Stage, StageData], seed: int) -> Section | None:
    """Section "Where it fails"."""
    blocks: list[Any] = []
    most: list[tuple[str, str, float, float]] = []
    for stage, data in stages.items():
        variables = variables_of(data)
        if not variables or not data.good.any():
            continue
        shares, chance = explained(data, variables, seed)
        order = sorted(range(len(variables)), key=lambda k: -shares[k])
        rows = [(variables[k].title, _percent(shares[k]), _percent(chance)) for k in order[:LISTED]]
        most.append((stage_title(stage), variables[order[0]].title, shares[order[0]], chance))
        blocks.append(stage_title(stage))
        blocks.append(
            as_table(
                ("Residual against", "Explained#", "Chance gives up to#"),
                rows,
                _beyond(shares, chance),
            )
        )
        blocks.append(_against(data, variables, order))
        blocks.append(sizes_figure(data))
    return Section("where", "Where it fails", (), tuple(blocks), finding=_finding(most)) if blocks else None


def _finding(most: Sequence[tuple[str, str, float, float]]) -> str:
    """On what the residual of each stage depends most, in one sentence: title, variable, share and chance of each."""
    beyond = [
        f"{stage} on {variable.rpartition(', ')[0] or variable} ({_percent(share)} of the variance, by chance up to "
        f"{_percent(chance)})"
        for stage, variable, share, chance in most
        if share > chance
    ]
    if not beyond:
        return "The residual depends on no recorded variable beyond chance."
    return f"Residuals depend on a recorded variable beyond chance: {'; '.join(beyond)}."


def _beyond(shares: Sequence[float], chance: float) -> str:
    """The explained shares in words, and how much of the error a significant one accounts for."""
    beyond, largest = sum(s > chance for s in shares), max(shares)
    text = (
        "Share of the residual's variance that a running mean along one variable explains: the "
        f"{min(LISTED, len(shares))} largest of {len(shares)}, {beyond or 'none'} beyond what chance gives to the "
        "largest of them (95 %, signs flipped unit by unit)."
    )
    if beyond:
        text += (
            " A dependence beyond chance can be small: the largest one accounts for "
            f"{_percent(1.0 - np.sqrt(1.0 - largest))} of the RMS error. The verdict requires more: a known effect, or "
            "a curve over a variable, must lower the error of held-out rows. Slow noise in logs does not, so the "
            "verdict may be “adequate” all the same."
        )
    return text


def _percent(share: float) -> str:
    return f"{number(100 * share, 2)} %"


def _chosen(data: StageData) -> list[Integers]:
    """Rows drawn: those fitted, held out and rejected; the first two thinned evenly where there are too many."""
    usable = data.good.any(axis=1)
    limit = MOST_ROWS if data.kind.points else MOST_POINTS
    step = max(1, int(np.ceil(usable.sum() / limit)))
    kept = [np.flatnonzero(usable & (data.held_out == held_out))[::step] for held_out in (False, True)]
    return [*kept, np.flatnonzero(data.rejected.any(axis=1))]


def _panels(data: StageData) -> tuple[list[str], float, str]:
    if data.kind.points:
        return [f"{a} (instrument's frame)" for a in "xyz"], 1e6, "µm"
    return [f"motor {k + 1}" for k in range(data.channels)], 1.0, "Nm"


@dataclass(frozen=True)
class _Drawn:
    """The rows of a figure: those fitted, held out and rejected, with residuals ``(N, channels)`` as they are drawn."""

    rows: Integers
    fitted: int
    kept: int
    residual: Array
    limits: Array


def _drawn(data: StageData, factor: float) -> _Drawn:
    """Residuals in the figure's unit; rejected ones beyond the axis stand at its edge."""
    kinds = _chosen(data)
    rows, ends = np.concatenate(kinds), np.cumsum([len(part) for part in kinds])
    fitted, kept = int(ends[0]), int(ends[1])
    shown = data.good[rows] | data.rejected[rows]
    y = np.where(shown, factor * data.residual[rows], np.nan)
    limits = np.zeros(data.channels)
    for c in range(data.channels):
        level, used = factor * float(data.floor.sigma[c]), y[:kept, c]
        spread = float(np.nanquantile(np.abs(used), 0.995)) if np.isfinite(used).any() else level
        limits[c] = 1.15 * max(spread, 1.5 * level)
        y[kept:, c] = np.clip(y[kept:, c], -EDGE * limits[c], EDGE * limits[c])
    return _Drawn(rows, fitted, kept, y, limits)


def _against(data: StageData, variables: Sequence[Variable], order: Sequence[int]) -> Figure:
    drawn = _drawn(data, _panels(data)[1])
    listed = [variables[k] for k in order]
    charts = [_chart(data, drawn, variable) for variable in listed]
    counted, crossed = int(data.good.any(axis=1).sum()), len(drawn.rows) - drawn.kept
    thinned = f" {drawn.kept} of {counted} rows are drawn; medians are over all." if drawn.kept < counted else ""
    what = "1 row rejected as an outlier" if crossed == 1 else f"{crossed} rows rejected as outliers"
    left_out = (
        f" Crosses: {what}; those beyond the axis are drawn at its edge. Medians are without them." if crossed else ""
    )
    caption = (
        "Measured less predicted, against the variable that explains most; on a screen, others can be chosen above. "
        f"Dashed: ± 1 σ of noise alone.{left_out}{thinned}"
    )
    return Figure(f"against-{data.stage}", charts[0], caption, selector([v.title for v in listed], charts))


def _chart(data: StageData, drawn: _Drawn, variable: Variable) -> Chart:
    """Residuals against one variable, channel by channel."""
    titles, factor, unit = _panels(data)
    few = len(np.unique(variable.values[np.isfinite(variable.values)])) <= 8
    shake = np.random.default_rng(0).uniform(-0.12, 0.12, len(drawn.rows)) if few else np.zeros(len(drawn.rows))
    a, b = drawn.fitted, drawn.kept
    labels = tuple((float(k), text) for k, text in enumerate(variable.labels)) or None
    low, high = _middle(variable.values)
    panels = []
    for c, title in enumerate(titles):
        x, y, limit = variable.of(c)[drawn.rows] + shake, drawn.residual[:, c], float(drawn.limits[c])
        x = x if low is None else np.clip(x, low, high)
        line = trend(variable.of(c), factor * data.residual[:, c], data.good[:, c])
        level = factor * float(data.floor.sigma[c])
        marks: tuple[Mark, ...] = (
            Level(-level),
            Level(level, name="± 1 σ of noise alone"),
            Points(x[:a], y[:a], "rows fitted", "blue", 4, 0.45),
            Points(x[a:b], y[a:b], "rows held out", "orange", 4, 0.45),
            Points(x[b:], y[b:], "rows rejected", "ink", 7, symbol="cross"),
            Band(line.x, line.low, line.high, "middle half", "grey"),
            Line(line.x, line.median, "running median", "ink", 2.0, symbol="circle", symbol_size=4.0),
        )
        up = Axis(f"residual, {unit}" if c % 3 == 0 else "", -limit, limit)
        panels.append(Panel(marks, Axis("", low, high, ticks=labels), up, title))
    below = variable.title if low is None else f"{variable.title}; rows beyond are drawn at the edge"
    return Chart(tuple(panels), 360 if len(titles) <= 3 else 560, across=3, below=below)


def _middle(x: Array) -> tuple[float, float] | tuple[None, None]:
    """Ends of an axis without the few rows far from all others; two None where all rows fit on one."""
    finite = x[np.isfinite(x)]
    if not finite.size:
        return None, None
    low, high = (float(v) for v in np.quantile(finite, (0.01, 0.99)))
    if np.ptp(finite) <= LARGEST_RANGE * (high - low) or high <= low:
        return None, None
    edge = 0.1 * (high - low)
    return low - edge, high + edge
