"""The shape of a residual that no known effect explains: curves with their bands, and the command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clampid.charts import Axis, Band, Chart, Line, Mark, Panel
from clampid.charts.marks import COLORS
from clampid.display import Scale, number, scale_for
from clampid.report.stage_data import in_order, stage_title
from clampid.report.style import Figure, Section

__all__ = ["unknown_shape_section"]

Json = Mapping[str, Any]
DEGREES = Scale(180.0 / np.pi, "degrees")


def unknown_shape_section(diagnosis: Json | None) -> Section | None:
    """Section "The shape of what is not known"; None where no verdict has one."""
    stages: Json = (diagnosis or {}).get("stages") or {}
    blocks: list[str | Figure] = []
    notes: list[str] = []
    for stage in in_order(stages):
        shape = stages[stage].get("shape")
        if shape:
            blocks += [stage_title(stage), _figure(stage, shape)]
            notes.append(f"{stage_title(stage)}, to make it an effect of your own: {shape['command']}")
    if not blocks:
        return None
    text = (
        "No effect of the catalogue explains the residual, which depends on the variables that the verdict names. The "
        "curve shows how. It is the part that the model's own parameters cannot explain, less its mean over the rows. "
        "The command writes an effect of this shape, with amplitudes to be fitted. Fit, diagnosis and compensation "
        "then treat it like any other effect."
    )
    return Section("shape", "The shape of what is not known", (text,), tuple(blocks), tuple(notes), "What to type")


def _figure(stage: str, shape: Json) -> Figure:
    curves: Sequence[Json] = shape["curves"]
    axes = list(dict.fromkeys(str(c["axis"]) for c in curves))
    scales = {axis: _scale([c for c in curves if c["axis"] == axis]) for axis in axes}
    titles = [f"{axis}, {scales[axis].unit}" if len(axes) > 1 else "" for axis in axes]
    across = _scale_of_variable(str(curves[0]["variable"]), str(curves[0]["variable_unit"]))
    height = 240 * (-(-len(axes) // 3)) + (90 if len(axes) > 1 else 160)
    up = "" if len(axes) > 1 else f"{'angle' if axes[0] == 'dq' else 'torque'} at {shape['at']}, {scales[axes[0]].unit}"
    title = f"{curves[0]['variable']}{f', {across.unit}' if across.unit else ''}"
    panels = [
        Panel(
            tuple(m for i, c in enumerate(c for c in curves if c["axis"] == axis) for m in _marks(c, scales[axis], i)),
            Axis(),
            Axis("" if k % 3 else up),
            titles[k],
        )
        for k, axis in enumerate(axes)
    ]
    plot = Chart(tuple(panels), height, below=title)
    caption = (
        f"What acts at {shape['at']} as a function of {' and '.join(shape['depends_on'])}, with a band that holds the "
        f"whole curve with 95 % probability (simultaneous). It explains {number(100 * float(shape['share']), 2)} % of "
        "the squares of what is left."
    )
    return Figure(f"shape-{stage}", plot, caption)


def _scale(curves: Sequence[Json]) -> Scale:
    return scale_for(str(curves[0]["unit"]), [float(v) for c in curves for v in (*c["low"], *c["high"])])


def _scale_of_variable(name: str, unit: str) -> Scale:
    """The unit for people: degrees of joint angles, minutes of times, kelvin above 20 °C, else the unit itself."""
    if unit == "rad" and name.startswith("q"):
        return DEGREES
    if unit == "s":
        return Scale(1.0 / 60.0, "min")
    if unit == "K":
        return Scale(1.0, "K above 20 °C")
    return Scale(1.0, unit)


def _given(curve: Json) -> str:
    """The values of the other variables, as a legend has them."""
    parts = []
    for name, value in curve["given"].items():
        if name.startswith("dir"):
            parts.append(f"{name} = {'+' if value > 0 else '−'}1")
        elif name.startswith("q") and name[1:].isdigit():
            parts.append(f"{name} = {number(float(np.degrees(value)), 2)}°")
        else:
            parts.append(f"{name} = {number(float(value), 2)}")
    return ", ".join(parts) or "shape"


def _marks(curve: Json, scale: Scale, index: int) -> tuple[Mark, ...]:
    across = _scale_of_variable(str(curve["variable"]), str(curve["variable_unit"]))
    x = np.asarray(curve["x"], dtype=float) * across.factor
    value, low, high = (np.asarray(curve[k], dtype=float) * scale.factor for k in ("value", "low", "high"))
    color = COLORS[index % 3]
    symbol = "" if len(x) > 2 else "square"
    return Band(x, low, high, "", color), Line(x, value, _given(curve), color, 2.0, symbol=symbol)
