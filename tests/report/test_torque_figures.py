"""The torque figures: what is drawn is the model's formula, its covariance, and the robot's true friction."""

from __future__ import annotations

import numpy as np
import pytest

from clampid.identify import identify
from clampid.reopen import reopen
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
    data = stage_data(reopen(identify(campaign), campaign))
    return data["free_air"], made.truth.plant, {f.key: f for f in torque_section(data).blocks}


def axis(k):
    return "x" if k == 0 else f"x{k + 1}"


def lines(figure, k, color):
    """The traces of one panel in one colour: x, y, from slow to fast, of both sides of standstill."""
    found = [t for t in figure.plot.data if (t.xaxis or "x") == axis(k) and t.mode == "lines" and t.line.color == color]
    return np.concatenate([t.x for t in found]), np.concatenate([t.y for t in found])


def bands(figure, k, color):
    """Half the width of the bands of one panel at the x of its lines."""
    pale = "rgba(" + ",".join(str(int(color[i : i + 2], 16)) for i in (1, 3, 5))
    found = [
        t for t in figure.plot.data if (t.xaxis or "x") == axis(k) and t.fillcolor and t.fillcolor.startswith(pale)
    ]
    halves = [0.5 * (np.asarray(t.y)[: len(t.y) // 2] - np.asarray(t.y)[len(t.y) // 2 :][::-1]) for t in found]
    return np.concatenate(halves)


BLUE, ORANGE = "#0072B2", "#D55E00"


def test_the_motors_curve_is_coulomb_and_viscous_with_their_covariance(drawn):
    data, _, figures = drawn
    values, slots = data.model.values(), list(data.model.slots)
    for k in range(6):
        w, friction = lines(figures["friction"], k, BLUE)
        own = [Slot("coulomb_friction", "Fc", f"joint{k + 1}"), Slot("viscous_friction", "Fv", f"joint{k + 1}")]
        columns = np.c_[np.sign(w), w]
        np.testing.assert_allclose(friction, columns @ [values[s] for s in own], rtol=1e-6, atol=1e-9)
        C = data.model.covariance[np.ix_([slots.index(s) for s in own], [slots.index(s) for s in own])]
        expected = 1.96 * np.sqrt(np.einsum("ik,kl,il->i", columns, C, columns))
        np.testing.assert_allclose(bands(figures["friction"], k, BLUE), expected, rtol=1e-4)


def test_with_the_arms_side_the_whole_friction_of_one_motor_is_drawn(drawn):
    data, _, figures = drawn
    values, T = data.model.values(), np.asarray(load_robot(ROBOT).transmission)
    for k in (3, 4, 5):
        w, friction = lines(figures["friction"], k, ORANGE)
        expected = values[Slot("coulomb_friction", "Fc", f"joint{k + 1}")] * np.sign(w)
        expected = expected + values[Slot("viscous_friction", "Fv", f"joint{k + 1}")] * w
        for j in (3, 4, 5):  # joint j turns with T_kj w, and its friction comes back through T_kj
            arm = values[Slot("wrist_coupling_friction", "F", f"joint{j + 1}")]
            expected = expected + T[k, j] * arm * np.sign(T[k, j] * w)
        np.testing.assert_allclose(friction, expected, rtol=1e-6, atol=1e-9)
    assert not any(
        t.xaxis in ("x", "x2", "x3") and t.mode == "lines" and t.line.color == ORANGE
        for t in figures["friction"].plot.data
    )


def test_the_sum_of_both_sides_is_known_where_neither_is(drawn):
    """Joint 4 turns with its own motor alone: its two sides are one number, known far better than either."""
    data, plant, figures = drawn
    own, both = bands(figures["friction"], 3, BLUE), bands(figures["friction"], 3, ORANGE)
    assert np.median(both) < 0.1 * np.median(own)
    T = np.asarray(load_robot(ROBOT).transmission)
    w, friction = lines(figures["friction"], 3, ORANGE)
    true = plant.friction.coulomb[3] + np.abs(T[3]) @ plant.friction.arm + plant.friction.viscous[3] * np.abs(w)
    assert np.abs(np.abs(friction) - true).max() < 2.0 * both.max()
    keys = [f.key for f in friction_figures(data)]
    known = {s.place: ok for s, ok in zip(data.model.slots, data.model.identified, strict=True) if s.parameter == "F"}
    assert not known["joint4"]
    assert ("friction-arm" in keys) == any(known.values())


def test_means_are_the_true_friction_within_their_intervals(drawn):
    """Over motors 1 to 3, which have one side only, 95 % intervals hold the truth about so often."""
    _, plant, figures = drawn
    inside = []
    for k in range(3):
        (marks,) = [t for t in figures["friction"].plot.data if (t.xaxis or "x") == axis(k) and t.name == "its mean"]
        assert len(marks.x) >= 6
        true = np.sign(marks.x) * (plant.friction.coulomb[k] + plant.friction.viscous[k] * np.abs(marks.x))
        inside += (np.abs(np.asarray(marks.y) - true) < np.asarray(marks.error_y.array) * 1.5).tolist()
    assert np.mean(inside) > 0.7


def test_the_residual_below_is_measured_less_model(drawn):
    data, _, figures = drawn
    plot = figures["stretch"].plot
    by_name = {name: [t for t in plot.data if t.name == name] for name in ("measured", "model", "residual")}
    assert [len(v) for v in by_name.values()] == [6, 6, 6]
    for k, (measured, model, residual) in enumerate(zip(*by_name.values(), strict=True)):
        assert residual.xaxis != measured.xaxis
        told = np.isfinite(residual.y)
        assert told.sum() > 20
        np.testing.assert_allclose(residual.y[told], (measured.y - model.y)[told], atol=1e-5 * np.abs(measured.y).max())
        assert np.sqrt(np.mean(residual.y[told] ** 2)) < 2.0 * data.floor.sigma[k]
