"""Rows that a fit has rejected, or far off along a variable, are drawn at the edge; no line counts the former."""

from __future__ import annotations

import base64
from dataclasses import replace

import numpy as np

from clampid.charts import Points
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.report.stage_data import StageData, stage_data
from clampid.report.style import Figure
from clampid.report.where import where_section
from experiments.campaign import Campaign
from experiments.simulate import measured_campaign
from experiments.virtual_robot import measure
from kinematics.description import load_robot

WRONG = (12, 47, 101)


def section(rows: tuple[int, ...]) -> tuple[StageData, Figure]:
    """Poses of which some rows are wrong by 5 mm, as the report tells of them."""
    robot = load_robot("kuka_kr20_r1810")
    made = measured_campaign(measure(robot, seed=4, tables=("poses",), poses=60), robot)
    table = made.tables["poses"].copy()
    table.loc[list(rows), "x_m"] += 5e-3
    campaign: Campaign = replace(made, tables={"poses": table})
    model = identify(campaign)
    data = stage_data(on_campaign(model, campaign))["poses"]
    found = where_section({"poses": data}, 0)
    assert found is not None
    return data, next(b for b in found.blocks if isinstance(b, Figure) and b.selector is not None)


def test_rejected_rows_are_drawn_and_counted() -> None:
    data, figure = section(WRONG)
    assert np.flatnonzero(data.rejected.any(axis=1)).tolist() == list(WRONG)
    assert not np.any(data.rejected & data.good)
    assert figure.selector is not None
    panel = figure.plot.panels[0]
    (x_of,) = panel.named("rows rejected")
    assert isinstance(x_of, Points)
    limit = panel.y.high
    assert limit is not None
    assert np.abs(x_of.y).max() < limit  # 5 mm stand at the edge
    assert np.all(np.abs(x_of.y) > 0.9 * limit)
    assert len(base64.b64decode(figure.selector.values[0])) // 2 - figure.selector.ends[1] == len(WRONG)
    assert "3 rows rejected as outliers" in figure.caption


def test_without_rejected_rows_none_are_spoken_of() -> None:
    data, figure = section(())
    assert not data.rejected.any()
    assert "rejected" not in figure.caption
    assert [len(mark.y) for mark in figure.plot.named("rows rejected") if isinstance(mark, Points)] == [0, 0, 0]


def test_a_row_far_off_along_a_variable_is_drawn_at_the_edge() -> None:
    data, _ = section(())
    torque = data.first.rows.signals["gravity_torque"]
    torque[:, 4] = 1e-3 * np.sin(np.arange(len(torque)))
    torque[7, 4] = 10.0
    found = where_section({"poses": data}, 0)
    assert found is not None
    selector = next(b.selector for b in found.blocks if isinstance(b, Figure) and b.selector is not None)
    below = {name: choice["below"] for name, choice in zip(selector.names, selector.choices, strict=True)}
    far = "gravity torque at joint 5, Nm"
    assert below.pop(far) == f"{far}; rows beyond are drawn at the edge"
    assert all(text == name for name, text in below.items())
