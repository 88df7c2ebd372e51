"""Errors of the joints' angles over a turn, with their band: where angles were visited, and where nobody was."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go

from clampid.curves import AngleErrors, angle_errors
from clampid.effect import Effect
from clampid.model import Model
from clampid.report.panels import finish, grid, place_of
from clampid.report.style import BLUE, GREY, Figure, Section
from kinematics.description import RobotDescription

__all__ = ["angle_curves_section"]

STEPS = 720
BAND = "rgba(0,114,178,0.25)"


def angle_curves_section(model: Model, effects: Mapping[str, Effect], robot: RobotDescription) -> Section | None:
    """Section "Errors of the joints' angles"; None where the model has none that depend on the joint's own angle."""
    if "poses" not in model.stages:
        return None
    angle = np.linspace(-np.pi, np.pi, STEPS + 1)
    q = np.tile(angle[:, None], (1, robot.n))
    found = angle_errors(model.stages["poses"], effects, model.layout, robot, q)
    if not found.active.any():
        return None
    joints = np.flatnonzero(found.active).tolist()
    plot = grid(len(joints), [f"joint {j + 1}" for j in joints])
    for k, j in enumerate(joints):
        for trace in _traces(found, np.degrees(angle), j, first=k == 0):
            plot.add_trace(trace, *place_of(k, len(joints)))
    height = 240 * (-(-len(joints) // 3)) + 90
    plot = finish(plot, len(joints), height, "joint angle, degrees", "arm less controller, µrad")
    plot.update_xaxes(range=[-180, 180], dtick=90)
    caption = (
        "Error of each joint's angle over one turn, with a band of two standard errors. Where no pose came near, the "
        "curve is drawn grey: there nothing is known but the error's usual size, and the model takes it for zero."
    )
    far = [f"joint {j + 1}: {100 * np.mean(found.extrapolated[:, j]):.0f} % of a turn" for j in joints]
    notes = (f"Not visited by any pose: {'; '.join(far)}.",) if found.extrapolated.any() else ()
    return Section("angles", "Errors of the joints' angles", (), (Figure("angles", plot, caption, height),), notes)


def _traces(found: AngleErrors, degrees: np.ndarray, j: int, first: bool) -> list[go.Scatter]:
    """The band, the curve, and the part of it that is not known, in µrad."""
    error, two = 1e6 * found.error[:, j], 2e6 * found.std[:, j]
    far = found.extrapolated[:, j]
    x = degrees.astype(np.float32)

    def line(y: np.ndarray, name: str, color: str) -> go.Scatter:
        style = {"color": color, "width": 1.8}
        return go.Scatter(
            x=x, y=y.astype(np.float32), mode="lines", line=style, name=name, legendgroup=name, showlegend=first
        )

    edge = {"x": np.r_[x, x[::-1]], "y": np.r_[error + two, (error - two)[::-1]].astype(np.float32)}
    band = go.Scatter(
        **edge, fill="toself", fillcolor=BAND, line={"width": 0}, mode="lines", name="two standard errors",
        legendgroup="band", showlegend=first, hoverinfo="skip",
    )  # fmt: skip
    return [
        band,
        line(np.where(far, np.nan, error), "measured", BLUE),
        line(np.where(far, error, np.nan), "no pose near", GREY),
    ]
