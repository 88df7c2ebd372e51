"""The error, round by round, and the noise floor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from clampid.charts import Axis, Chart, Line, Mark, Panel
from clampid.comparison.nominal import nominal_points
from clampid.display import error_text, error_texts
from clampid.effect import Stage
from clampid.models.model import Model, Round
from clampid.report.spread import Spread, spread_table
from clampid.report.stage_data import StageData, in_order, stage_title
from clampid.report.style import Figure, Section, as_table
from clampid.stages.stage_kind import kind_of

Array = npt.NDArray[np.float64]
MOST_LONG_TICKS = 4

__all__ = ["rounds_of", "rounds_section", "unit_of"]


def unit_of(stage: str) -> str:
    """The unit of a stage's errors."""
    return kind_of(stage).error_unit


def rounds_of(model: Model, first: Model | None, stage: Stage) -> tuple[Round, ...]:
    """A stage's rounds; those of the start model go before, where the ledger does not hold them."""
    own = tuple(r for r in model.ledger if r.stage == stage)
    before = tuple(r for r in first.ledger if r.stage == stage) if first is not None else ()
    if own[: len(before)] == before or not before:
        return own
    return (*before, *(r for r in own if r not in before))


def nominal_error(data: StageData) -> float | None:
    """Error of the robot as described, base and targets fitted to the same rows, m; of fitted poses only."""
    piece = data.first
    good = piece.good[:, 0] & ~piece.held_out
    if not data.kind.points or not good.any():
        return None
    return nominal_points(piece.rows, piece.problem.effects, good)


def rounds_section(
    model: Model, first: Model | None, stages: Mapping[Stage, StageData], spreads: Mapping[Stage, Spread] | None = None
) -> Section | None:
    """Section "The error, round by round"."""
    listed = [(s, rounds_of(model, first, s)) for s in in_order(model.stages)]
    listed = [(s, r) for s, r in listed if r]
    if not listed:
        return None
    panels = []
    rows = []
    for stage, rounds in listed:
        nominal = nominal_error(stages[stage]) if stage in stages else None
        panels.append(_panel(stage, rounds, nominal))
        rows += _table_rows(stage, rounds, nominal)
    plot = Chart(tuple(panels), 440)
    table = as_table(("Stage", "Round", "Fitted#", "Held out#", "Noise floor#"), rows)
    norms = ["Poses: norm of the position error."] if any(kind_of(s).points for s, _ in listed) else []
    if any(not kind_of(s).points for s, _ in listed):
        norms.append("Torques: in units of each motor's noise, so that the floor is 1.")
    caption = f"Root mean square error after each round. {' '.join(norms)} The floor has the same norm."
    sure = spread_table(spreads or {})
    blocks = (Figure("rounds", plot, caption), table, *(() if sure is None else (sure,)))
    return Section("rounds", "The error, round by round", (), blocks)


NOMINAL = "robot as described, base and targets fitted"


def _panel(stage: Stage, rounds: Sequence[Round], nominal: float | None) -> Panel:
    """One stage: error on rows fitted and held out, round by round, above the noise floor."""
    factor, unit = (1e6, "m") if kind_of(stage).points else (1.0, "sigma")
    at = np.arange(len(rounds), dtype=float)
    fit, held_out, floor = (
        factor * np.array([getattr(r, name) for r in rounds]) for name in ("rms", "heldout_rms", "noise_floor")
    )
    start = -1.0 if nominal is not None else 0.0
    marks: list[Mark] = [
        Line(np.r_[start - 0.3, at, at[-1] + 0.3], np.r_[floor[0], floor, floor[-1]], "noise floor", "green", 2, "6 4"),
        _line(at, fit, "rows fitted", "blue", "circle", [error_text(v / factor, unit) for v in fit.tolist()]),
        _line(
            at, held_out, "rows held out", "orange", "square", [error_text(v / factor, unit) for v in held_out.tolist()]
        ),
    ]
    values = np.r_[fit, held_out, floor]
    ticks = [(float(k), f"round {k}" if k else "start model") for k in range(len(rounds))]
    if nominal is not None:
        values = np.r_[values, factor * nominal]
        ticks.insert(0, (-1.0, "as described"))
        place = np.array([-1.0]), np.array([factor * nominal])
        marks.append(_line(*place, NOMINAL, "grey", "diamond", [error_text(nominal, unit)]))
    values = values[np.isfinite(values)]
    wide = bool(values.size and values.min() > 0 and values.max() > 8 * values.min())
    title = "RMS error, µm" if kind_of(stage).points else "RMS error, units of noise (σ)"
    low, high = (None, None) if wide or not values.size else (0.0, 1.15 * float(values.max()))
    x = Axis("", start - 0.4, float(at[-1]) + 0.4, ticks=_spaced(ticks))
    return Panel(tuple(marks), x, Axis(title, low, high, log=wide), stage_title(stage))


def _spaced(ticks: list[tuple[float, str]]) -> tuple[tuple[float, str], ...]:
    """Ticks with short texts where there are many: the table beneath says what each round added."""
    short = ticks if len(ticks) <= MOST_LONG_TICKS else [(at, text.removeprefix("round ")) for at, text in ticks]
    return tuple((at, "0" if text == "start model" and short is not ticks else text) for at, text in short)


def _table_rows(stage: Stage, rounds: Sequence[Round], nominal: float | None) -> list[tuple[str, ...]]:
    """The same in numbers, with what each round added."""
    unit, title = unit_of(stage), stage_title(stage)
    rows: list[tuple[str, ...]] = [] if nominal is None else [(title, NOMINAL, error_text(nominal, unit), "–", "–")]
    columns = ([r.rms for r in rounds], [r.heldout_rms for r in rounds], [r.noise_floor for r in rounds])
    for k, (r, *errors) in enumerate(zip(rounds, *(error_texts(c, unit) for c in columns), strict=True)):
        label = f"start model: {', '.join(r.effects)}" if k == 0 else f"round {k}: {_added(r)}"
        rows.append((title, label, *errors))
    return rows


def _added(entry: Round) -> str:
    return "+ " + " + ".join(entry.added) if entry.added else "fitted again"


def _line(x: Array, y: Array, name: str, color: str, symbol: str, tips: Sequence[str]) -> Line:
    return Line(x, y, name, color, 2.0, symbol=symbol, tips=[f"{name}: {tip}" for tip in tips])
