"""The error falling round by round, against what noise alone leaves."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from clampid.comparison.nominal import nominal_points
from clampid.display import error_text
from clampid.effect import Stage
from clampid.models.model import Model, Round
from clampid.report.spread import Spread, spread_table
from clampid.report.stage_data import StageData, in_order, stage_title
from clampid.report.style import BLUE, GREEN, GREY, ORANGE, Figure, Section, as_table, axes, layout

__all__ = ["rounds_of", "rounds_section", "unit_of"]


def unit_of(stage: str) -> str:
    """The unit of a stage's errors."""
    return "m" if stage == "poses" else "sigma"


def rounds_of(model: Model, first: Model | None, stage: Stage) -> tuple[Round, ...]:
    """A stage's rounds; those of the first model go before, where the ledger does not hold them."""
    own = tuple(r for r in model.ledger if r.stage == stage)
    before = tuple(r for r in first.ledger if r.stage == stage) if first is not None else ()
    if own[: len(before)] == before or not before:
        return own
    return (*before, *(r for r in own if r not in before))


def nominal_error(data: StageData) -> float | None:
    """Error of the robot as described, base and targets fitted to the same rows, m; of fitted poses only."""
    piece = data.first
    good = piece.good[:, 0] & ~piece.held
    if data.stage != "poses" or not good.any():
        return None
    return nominal_points(piece.rows, piece.experiment.effects, good)


def rounds_section(
    model: Model, first: Model | None, stages: Mapping[Stage, StageData], spreads: Mapping[Stage, Spread] | None = None
) -> Section | None:
    """Section "The error, round by round"."""
    listed = [(s, rounds_of(model, first, s)) for s in in_order(model.stages)]
    listed = [(s, r) for s, r in listed if r]
    if not listed:
        return None
    plot = make_subplots(
        rows=1, cols=len(listed), subplot_titles=[stage_title(s) for s, _ in listed], horizontal_spacing=0.09
    )
    rows = []
    for column, (stage, rounds) in enumerate(listed, 1):
        factor = 1e6 if stage == "poses" else 1.0
        nominal = nominal_error(stages[stage]) if stage in stages else None
        labels = [_label(r, k) for k, r in enumerate(rounds)]
        position = list(range(len(rounds)))
        unit = unit_of(stage)
        if nominal is not None:
            x = [-1, 0]
            y = [nominal * factor, rounds[0].rms * factor]
            plot.add_trace(
                _line(
                    x[:1],
                    y[:1],
                    "robot as described, base and targets fitted",
                    GREY,
                    "diamond-open",
                    column == len(listed),
                ),
                1,
                column,
            )
            rows.append(
                (stage_title(stage), "robot as described, base and targets fitted", error_text(nominal, unit), "–", "–")
            )
        show = column == 1
        fit, held = [r.rms * factor for r in rounds], [r.heldout_rms * factor for r in rounds]
        floor = [r.noise_floor * factor for r in rounds]
        plot.add_trace(_line(position, fit, "rows fitted", BLUE, "circle", show), 1, column)
        plot.add_trace(_line(position, held, "rows held out", ORANGE, "square", show), 1, column)
        start = -1 if nominal is not None else 0
        ends = {"x": [start - 0.3, *position, position[-1] + 0.3], "y": [floor[0], *floor, floor[-1]]}
        line = {"color": GREEN, "dash": "dash", "width": 2}
        plot.add_trace(go.Scatter(**ends, mode="lines", name="noise alone", line=line, showlegend=show), 1, column)
        ticks = ([-1] if nominal is not None else []) + position
        texts = (["as described"] if nominal is not None else []) + labels
        plot.update_xaxes(
            axes(
                tickvals=ticks,
                ticktext=texts,
                tickangle=-35 if any(len(t) > 16 for t in labels) else 0,
                range=[start - 0.4, position[-1] + 0.4],
            ),
            row=1,
            col=column,
        )
        values = [v for v in (*fit, *held, *floor, *([nominal * factor] if nominal else [])) if np.isfinite(v)]
        wide = values and max(values) > 8 * min(values) > 0
        title = "RMS error, µm" if stage == "poses" else "RMS error, units of noise (σ)"
        upper = None if wide else [0, 1.15 * max(values)]
        plot.update_yaxes(axes(title=title, type="log" if wide else "linear", range=upper, nticks=7), row=1, col=column)
        if wide:
            plot.update_yaxes(dtick="D2", row=1, col=column)
        rows += [
            (
                stage_title(stage),
                labels[k].replace("<br>", " ") if k else f"{labels[k].replace('<br>', ' ')}: {', '.join(r.effects)}",
                error_text(r.rms, unit),
                error_text(r.heldout_rms, unit),
                error_text(r.noise_floor, unit),
            )
            for k, r in enumerate(rounds)
        ]
    plot.update_layout(layout(430))
    for note in plot.layout.annotations:
        note.font = {"size": 13}
    plot.update_layout(margin={"l": 64, "r": 16, "t": 76, "b": 100})
    table = as_table(("Stage", "Round", "Fitted#", "Held out#", "Noise alone#"), rows)
    norms = ["Poses: norm of the position error."] if any(s == "poses" for s, _ in listed) else []
    if any(s != "poses" for s, _ in listed):
        norms.append("Torques: in units of each motor's noise, so that the floor is 1.")
    caption = f"Root mean square error after each round. {' '.join(norms)} The floor has the same norm."
    sure = spread_table(spreads or {})
    blocks = (Figure("rounds", plot, caption, 430), table, *(() if sure is None else (sure,)))
    return Section("rounds", "The error, round by round", (), blocks)


def _label(entry: Round, index: int) -> str:
    if entry.added:
        return "+ " + "<br>+ ".join(entry.added)
    return "first model" if index == 0 else f"round {index + 1}"


def _line(x: list[int], y: list[float], name: str, color: str, symbol: str, show: bool) -> go.Scatter:
    marker = {"color": color, "size": 9, "symbol": symbol}
    hover = f"%{{y:.4g}}<extra>{name}</extra>"
    return go.Scatter(
        x=x,
        y=y,
        mode="lines+markers",
        name=name,
        line={"color": color, "width": 2},
        marker=marker,
        legendgroup=name,
        showlegend=show,
        hovertemplate=hover,
    )
