"""The error budget as figures and tables, against what noise alone leaves."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from clampid.display import error_text, number
from clampid.effect import Stage
from clampid.report.budget import Share, pose_budget, torque_budget
from clampid.report.stage_data import StageData, stage_title
from clampid.report.style import BLUE, GREEN, GREY, ORANGE, Figure, Section, Table, as_table, axes, layout

__all__ = ["budget_section"]


def budget_section(stages: Mapping[Stage, StageData]) -> Section | None:
    """Section "Error budget"."""
    blocks: list[str | Table | Figure] = []
    for stage, data in stages.items():
        if not data.good.any():
            continue
        blocks.append(stage_title(stage))
        blocks += _pose_blocks(data) if stage == "poses" else _torque_blocks(data)
    if not blocks:
        return None
    text = (
        "How much each effect amounts to over this campaign: its amplitudes set to zero in the fitted model, "
        "everything else as it is, and the difference of the two predictions. Parts do not add up: a model without one "
        "effect, fitted again, would hide some of it in the others."
    )
    return Section("budget", "Error budget by effect", (text,), tuple(blocks))


def _pose_blocks(data: StageData) -> list[Table | Figure]:
    shares = [s for s in pose_budget(data) if float(s.total[0]) > 0.0]
    floor = data.floor.norm
    plot = go.Figure()
    names = [s.name for s in shares]
    totals = [1e6 * float(s.total[0]) for s in shares]
    smallest = min([*totals, *(1e6 * v for s in shares for v in s.places.values() if v > 0), 1e6 * floor], default=1.0)
    low = 10.0 ** np.floor(np.log10(max(smallest, 1e-2)))
    plot.add_trace(
        go.Bar(
            y=names,
            x=totals,
            orientation="h",
            marker={"color": BLUE, "opacity": 0.75},
            name="effect as a whole",
            hovertemplate="%{y}: %{x:.3g} µm<extra></extra>",
            width=0.6,
        )
    )
    dots = [(s.name, 1e6 * v, p) for s in shares for p, v in s.places.items() if 1e6 * v > low]
    if dots:
        marker = {"symbol": "circle", "size": 15, "color": "white", "line": {"color": ORANGE, "width": 1.5}}
        plot.add_trace(
            go.Scatter(
                y=[d[0] for d in dots],
                x=[d[1] for d in dots],
                text=[_short(d[2]) for d in dots],
                mode="markers+text",
                marker=marker,
                textfont={"size": 9},
                name="single joints and links",
                customdata=[d[2] for d in dots],
                hovertemplate="%{customdata}: %{x:.3g} µm<extra></extra>",
            )
        )
    plot.add_vline(
        x=1e6 * floor,
        line={"color": GREEN, "dash": "dash", "width": 2},
        annotation_text="noise alone",
        annotation_position="top",
        annotation_font={"color": GREEN},
    )
    height = 130 + 34 * len(names)
    high = np.log10(max([*totals, 1e6 * floor])) + 0.15
    plot.update_xaxes(
        axes(type="log", title="RMS shift of the measured points, µm", range=[np.log10(low), high], dtick=1)
    )
    plot.update_yaxes(axes(autorange="reversed", ticks=""))
    plot.update_layout(layout(height, margin={"l": 200, "r": 24, "t": 60, "b": 52}, bargap=0.3))
    rows = [
        (s.name, error_text(float(s.total[0]), "m"), number(float(s.total[0]) / floor, 2), _largest(s)) for s in shares
    ]
    caption = (
        f"RMS shift at the campaign's {int(data.first.good[:, 0].sum())} points. Base, targets and "
        "flange belong to the setup; their shift is from the nominal robot aligned with the points, and depends on how "
        "the geometry's freedom is shared out."
    )
    table = as_table(("Effect", "RMS shift#", "Times the noise#", "Largest single places"), rows)
    return [Figure("budget-poses", plot, caption, height), table]


def _short(place: str) -> str:
    """The number of a joint or link."""
    return place.removeprefix("joint").removeprefix("link")


def _largest(share: Share) -> str:
    listed = sorted(share.places.items(), key=lambda item: -item[1])[:3]
    return ", ".join(f"{place} {error_text(v, 'm')}" for place, v in listed if v > 0) or "–"


def _torque_blocks(data: StageData) -> list[Table | Figure]:
    shares = torque_budget(data)
    motors = data.channels
    floor = data.floor.sigma[:motors]
    lines = [*shares, Share("noise alone", floor, {})]
    across = min(motors, 6)
    plot = make_subplots(
        rows=1,
        cols=across,
        shared_yaxes=True,
        horizontal_spacing=0.015,
        subplot_titles=[f"motor {k + 1}" for k in range(across)],
    )
    for k in range(across):
        values = np.array([float(s.total[k]) for s in lines])
        tiny = 0.2 * float(floor[k])
        shown = np.where(values > tiny, values, np.nan)
        colors = [GREY if s.name in ("torque measured", "gravity as described") else BLUE for s in shares] + [GREEN]
        plot.add_trace(
            go.Bar(
                y=[s.name for s in lines],
                x=shown,
                orientation="h",
                marker={"color": colors, "opacity": 0.75},
                showlegend=False,
                hovertemplate="%{y}: %{x:.3g} Nm<extra></extra>",
                width=0.6,
            ),
            1,
            k + 1,
        )
        plot.add_vline(x=float(floor[k]), line={"color": GREEN, "dash": "dash", "width": 1.5}, row=1, col=k + 1)
        top = np.log10(np.nanmax([*shown, floor[k]])) + 0.1
        plot.update_xaxes(axes(type="log", range=[np.log10(tiny), top], dtick=1, title="Nm"), row=1, col=k + 1)
    plot.update_yaxes(axes(autorange="reversed", ticks="", automargin=True))
    height = 130 + 30 * len(lines)
    plot.update_layout(layout(height, margin={"l": 170, "r": 12, "t": 40, "b": 48}))
    for note in plot.layout.annotations:
        note.font = {"size": 12}
    rows = [(s.name, *(number(float(v)) if v > 1e-9 else "0" for v in s.total)) for s in lines]
    note = (
        " The springs are left out: a clamped drive without them has no finite torque."
        if data.stage == "clamped"
        else ""
    )
    caption = f"RMS torque at each motor that an effect stands for, Nm.{note}"
    return [
        Figure(f"budget-{data.stage}", plot, caption, height),
        Table(
            ("Nm, RMS", *(f"Motor {k + 1}#" for k in range(motors))), tuple(rows), "The same in numbers", folded=True
        ),
    ]
