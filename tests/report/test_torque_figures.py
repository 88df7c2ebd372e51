"""The torque figures: what is drawn is the model's formula, its covariance, and the robot's true friction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clampid.charts import Band, Line
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.report.friction import friction_figures
from clampid.report.stage_data import stage_data
from clampid.report.torque import torque_section
from clampid.slots import Slot
from experiments.campaign import read_campaign, write_campaign
from experiments.virtual_robot import measure
from kinematics.description import load_robot

ROBOT = "kuka_kr20_r1810"


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A campaign of torques, its model's data as the report sees them, and the truth."""
    made = measure(load_robot(ROBOT), seed=6, poses=1, tables=("free_air", "wrist"))
    folder = tmp_path_factory.mktemp("torques") / "campaign"
    write_campaign(folder, made.header, made.tables)
    campaign = read_campaign(folder)
    data = stage_data(on_campaign(identify(campaign), campaign))
    return data["free_air"], made.truth.plant, {f.key: f for f in torque_section(data).blocks}


def lines(figure, k, color):
    """The traces of one panel in one colour: x, y, from slow to fast, of both sides of standstill."""
    found = [m for m in figure.plot.panels[k].marks if isinstance(m, Line) and m.color == color]
    return np.concatenate([t.x for t in found]), np.concatenate([t.y for t in found])


def bands(figure, k, color):
    """Half the width of the bands of one panel at the x of its lines."""
    found = [m for m in figure.plot.panels[k].marks if isinstance(m, Band) and m.color == color]
    return np.concatenate([0.5 * (m.high - m.low) for m in found])


BLUE = "blue"


def whole_friction(data, k, w):
    """What a motor feels when it turns alone at ``w``: slots, and their columns."""
    T = np.asarray(load_robot(ROBOT).transmission)
    slots = [Slot("coulomb_friction", "Fc", f"joint{k + 1}"), Slot("viscous_friction", "Fv", f"joint{k + 1}")]
    columns = [np.sign(w), w]
    if k >= 3:  # joint j turns with T_kj w, and its friction comes back through T_kj
        slots += [Slot("wrist_coupling_friction", "F", f"joint{j + 1}") for j in (3, 4, 5)]
        columns += [T[k, j] * np.sign(T[k, j] * w) for j in (3, 4, 5)]
    return slots, np.array(columns).T


def test_the_curve_is_the_friction_of_a_motor_that_turns_alone_with_its_covariance(drawn):
    data, _, figures = drawn
    values, slots = data.model.values(), list(data.model.slots)
    for k in range(6):
        w, friction = lines(figures["friction"], k, BLUE)
        own, columns = whole_friction(data, k, w)
        np.testing.assert_allclose(friction, columns @ [values[s] for s in own], rtol=1e-6, atol=1e-9)
        C = data.model.covariance[np.ix_([slots.index(s) for s in own], [slots.index(s) for s in own])]
        expected = 1.96 * np.sqrt(np.einsum("ik,kl,il->i", columns, C, columns))
        np.testing.assert_allclose(bands(figures["friction"], k, BLUE), expected, rtol=1e-4)


def test_points_lie_about_the_curve_also_in_the_wrist(drawn):
    """What is drawn of a row is the curve at its speed and the row's residual, whatever else turned then."""
    data, _, _ = drawn
    theta = np.where([s.parameter == "F" for s in data.model.slots], 3.0, data.model.theta)  # much, on the arm's side
    rows = data.first.rows
    others = np.random.default_rng(0).choice([-1.0, 1.0], rows.signals["joint_motion"].shape)
    turning = replace(data.first, rows=replace(rows, signals={**rows.signals, "joint_motion": others}))
    data = replace(data, model=replace(data.model, theta=theta), pieces=(turning,))
    figure = friction_figures(data)[0]
    for k in range(6):
        (points,) = figure.plot.panels[k].named("model and residual")
        own, columns = whole_friction(data, k, np.asarray(points.x))
        beside = points.y - columns @ [data.model.values()[s] for s in own]
        assert abs(np.mean(beside)) < 0.2 * data.floor.sigma[k]
        assert np.sqrt(np.mean(beside**2)) < 1.5 * data.floor.sigma[k]


def test_the_sum_of_both_sides_is_known_where_neither_is(drawn):
    """Joint 4 turns with its own motor alone: its two sides are one number, known far better than either."""
    data, plant, figures = drawn
    slots = list(data.model.slots)
    own = data.model.std[slots.index(Slot("coulomb_friction", "Fc", "joint4"))]
    both = bands(figures["friction"], 3, BLUE)
    assert np.median(both) < 0.1 * 1.96 * own
    T = np.asarray(load_robot(ROBOT).transmission)
    w, friction = lines(figures["friction"], 3, BLUE)
    true = plant.friction.coulomb[3] + np.abs(T[3]) @ plant.friction.arm + plant.friction.viscous[3] * np.abs(w)
    assert np.abs(np.abs(friction) - true).max() < 2.0 * both.max()


def test_the_arms_side_is_drawn_where_it_differs_from_zero(drawn):
    data, _, _ = drawn
    told = {
        s.place
        for s, ok, value, std in zip(
            data.model.slots, data.model.identified, data.model.theta, data.model.std, strict=True
        )
        if s.parameter == "F" and ok and abs(value) > 2.0 * std
    }
    by_key = {f.key: f for f in friction_figures(data)}
    assert ("friction-arm" in by_key) == bool(told)
    for joint in {"joint4", "joint5", "joint6"} - told:
        assert joint.removeprefix("joint") in by_key["friction"].caption.rpartition("do not separate the two at ")[2]


def test_means_are_the_true_friction_within_their_intervals(drawn):
    """Over motors 1 to 3, which have one side only, 95 % intervals hold the truth about so often."""
    _, plant, figures = drawn
    inside = []
    for k in range(3):
        (marks,) = figures["friction"].plot.panels[k].named("its mean with 95 % interval")
        assert len(marks.x) >= 6
        true = np.sign(marks.x) * (plant.friction.coulomb[k] + plant.friction.viscous[k] * np.abs(marks.x))
        inside += (np.abs(np.asarray(marks.y) - true) < marks.error * 1.5).tolist()
    assert np.mean(inside) > 0.7


def test_the_residual_below_is_measured_less_model(drawn):
    data, _, figures = drawn
    plot = figures["stretch"].plot
    by_name = {name: plot.named(name) for name in ("measured", "model", "residual")}
    assert [len(v) for v in by_name.values()] == [6, 6, 6]
    for k, (measured, model, residual) in enumerate(zip(*by_name.values(), strict=True)):
        told = np.isfinite(residual.y)
        assert told.sum() > 20
        np.testing.assert_allclose(residual.y[told], (measured.y - model.y)[told], atol=1e-5 * np.abs(measured.y).max())
        assert np.sqrt(np.mean(residual.y[told] ** 2)) < 2.0 * data.floor.sigma[k]
