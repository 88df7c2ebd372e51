"""KUKA machine data of a model: what they hold, what they leave, and which arms are refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from clampid.exports.dh_export import calibrated_chain, postures
from clampid.exports.kuka_export import FITTED, LEVER, kuka_machine_data
from clampid.exports.kuka_export import _Fit as Fit
from clampid.exports.kuka_export import _nearest as nearest
from clampid.exports.kuka_export import _numbers as numbers
from clampid.models.model import Model, ModelError
from clampid.slots import Slot
from experiments.campaign import Campaign, Instrument, Tool
from kinematics.description import load_robot
from kinematics.kuka import MachineDataError, forward, frame_numbers
from kinematics.kuka_text import read_machine_data
from kinematics.screws import log_so3

Make = Callable[..., Model]


def with_values(model: Model, values: dict[Slot, float]) -> Model:
    """Give the model these values, and zero for all others."""
    stage = model.stages["poses"]
    return model.with_stage(replace(stage, theta=np.array([values.get(slot, 0.0) for slot in stage.slots])))


def link(parameter: str, number: int) -> Slot:
    return Slot("geometry", parameter, f"link{number}")


def test_a_robot_of_the_form_is_exact(make_model: Make) -> None:
    """Lengths, mastering and frames are what the form has; a nominal robot with others of them is lost nowhere."""
    model = with_values(
        make_model("kuka_kr20_r1810"),
        {
            link("x", 1): 5e-4, link("x", 2): -8e-4, link("ry", 1): 1e-3, link("ry", 2): -2e-3, link("z", 3): 7e-4,
            link("rx", 3): 1e-3, link("ry", 4): -1e-3, link("z", 6): 1e-3, link("rx", 6): 2e-3, link("rz", 6): 1e-3,
            Slot("geometry", "base_rx", "session1"): 0.01,
        },
    )  # fmt: skip
    found = kuka_machine_data(model)
    assert found.left.position_max < 1e-9
    assert found.left.orientation_max < 1e-9
    assert found.nominal.position_max > 1e-4
    data = found.data
    np.testing.assert_allclose((data.length_a, data.length_b), (0.1605, 0.7792), atol=1e-9)
    np.testing.assert_allclose(data.mastering, [0, 1e-3, -2e-3, -1e-3, -1e-3, 0], atol=1e-9)


def test_axes_that_the_form_makes_perpendicular_leave_what_the_arm_says(make_model: Make) -> None:
    """A twist between axes 2 and 3 turns what follows, the other way once the forearm has turned; a part is left."""
    twist = 1e-3
    found = kuka_machine_data(with_values(make_model("kuka_kr20_r1810"), {link("rx", 2): twist}))
    assert 0.2 * twist < found.left.orientation_rms < twist
    assert 1e-5 < found.left.position_rms < found.left.position_max < 2e-3


def test_the_text_read_back_errs_by_what_it_says(make_model: Make) -> None:
    model = make_model("kuka_kr20_r1810", size=3e-4)
    found = kuka_machine_data(model)
    chain = calibrated_chain(model)
    q = postures(chain.robot, 3000, seed=9)
    there, here = chain.flange(q), forward(read_machine_data(found.text), q)
    off = np.linalg.norm(here[:, :3, 3] - there[:, :3, 3], axis=1)
    turned = np.linalg.norm(log_so3(there[:, :3, :3].transpose(0, 2, 1) @ here[:, :3, :3]), axis=1)
    # Other postures than those it was measured at: means agree closely, maxima less so.
    assert np.sqrt(np.mean(off**2)) == pytest.approx(found.left.position_rms, rel=0.05)
    assert np.sqrt(np.mean(turned**2)) == pytest.approx(found.left.orientation_rms, rel=0.05)
    assert off.max() == pytest.approx(found.left.position_max, rel=0.2)
    assert f"position rms {1e3 * found.left.position_rms:.4f} mm" in found.text
    assert found.left.position_rms < found.nominal.position_rms
    assert found.text.isascii()


def test_a_short_lever_serves_position_and_a_long_one_orientation(make_model: Make) -> None:
    model = make_model("kuka_kr20_r1810")
    short, long = (kuka_machine_data(model, lever=lever).left for lever in (0.01, 5.0))
    assert short.position_rms < long.position_rms
    assert long.orientation_rms < short.orientation_rms


@pytest.mark.slow
def test_standard_errors_are_those_of_a_drawn_sample(make_model: Make) -> None:
    std = 1e-6
    model = make_model("kuka_kr20_r1810", std=std, size=3e-4)
    stage = model.stages["poses"]
    rng = np.random.default_rng(4)
    fit = Fit(postures(load_robot(model.robot), FITTED), LEVER)
    best, drawn = kuka_machine_data(model), []
    for _ in range(60):
        chain = calibrated_chain(model, theta=stage.theta + std * rng.standard_normal(len(stage.theta)))
        start = replace(best.data, robroot=frame_numbers(chain.base))
        drawn.append(numbers(nearest(start, chain, fit, every=True)))
    told = [line.partition("; std")[2] for line in best.text.splitlines()]
    promised = np.array([float(part.split()[-1]) for line in told for part in line.split(",") if part.strip()])
    # The text has $ROBROOT first, then $TIRORO, $TFLWP, $TX3P3 (X, Y, Z, C), the lengths and the mastering.
    order = [*range(12), *range(14, 18), 12, 13, *range(18, 22)]
    sample = np.std(drawn, axis=0)[order]
    mm, deg = 1e-3, np.radians(1.0)
    units = np.array([*[mm] * 3, *[deg] * 3, *[mm] * 3, *[deg] * 3, *[mm] * 3, deg, mm, mm, *[deg] * 4])
    # 60 draws know a standard error to 9 %; four of those over 22 numbers; two printed digits are another 5 %.
    np.testing.assert_allclose(sample, promised[6:] * units, rtol=0.4)
    assert np.mean(sample / (promised[6:] * units)) == pytest.approx(1.0, abs=0.1)


def test_what_the_form_is_not_for_is_refused(make_model: Make) -> None:
    with pytest.raises(MachineDataError, match="ur10: expected an ortho-parallel arm"):
        kuka_machine_data(make_model("ur10"))
    with pytest.raises(ModelError, match="lever: expected a length above 0 m, found -1"):
        kuka_machine_data(make_model("kuka_kr20_r1810"), lever=-1.0)
    with pytest.raises(ModelError, match="session 2"):
        kuka_machine_data(make_model("kuka_kr20_r1810"), session=1)
    with pytest.raises(ModelError, match="thermal_expansion"):
        kuka_machine_data(make_model("kuka_kr20_r1810"), temperature=30.0)


def test_what_the_data_leave_of_measured_points_is_said(make_model: Make) -> None:
    """Points where the model has them, but for a sag of 2 mm that no machine data hold."""
    model = make_model("kuka_kr20_r1810", size=1e-4)
    robot, target = load_robot(model.robot), np.array([0.1, 0.0, 0.2])
    q = postures(robot, 40, seed=5)
    pose = calibrated_chain(model).flange(q)
    point = pose[:, :3, :3] @ target + pose[:, :3, 3] - [0.0, 0.0, 2e-3]
    table = pd.DataFrame(np.c_[q, point], columns=[*(f"q{i + 1}_rad" for i in range(6)), "x_m", "y_m", "z_m"])
    campaign = Campaign(
        "made", None, robot, np.array([0, 0, -9.81]), Tool(0.0, np.zeros(3)), {"T1": target},
        Instrument("none", 1e-5, None), {"poses": table.assign(target="T1")}, model.sessions[0].fingerprint,
    )  # fmt: skip
    found = kuka_machine_data(model, campaign=campaign)
    assert found.on_points is not None
    mean = 1e3 * found.on_points.mean
    assert mean == pytest.approx(2.0, abs=3e3 * found.left.position_rms)
    assert mean != pytest.approx(2.0, abs=1e-4)
    assert (found.on_points.rows, found.on_points.table) == (40, "poses")
    assert f"These data alone leave {found.on_points}" in found.text
    with pytest.raises(ModelError, match="expected the campaign that session 1 of the model was fitted on"):
        kuka_machine_data(model, campaign=replace(campaign, fingerprint="other"))


def test_every_kuka_arm_is_written(make_model: Make) -> None:
    for name in ("kuka_kr16_2", "kuka_kr30_3"):
        found = kuka_machine_data(make_model(name))
        assert name in found.text
        assert f"not in these numbers: {found.whole.worth}." in found.text
        assert str(found.whole.error) in found.text
        assert set(found.whole.effects) == {"backlash"}
        assert found.whole.error.position_rms > found.left.position_rms
        assert found.left.position_rms < found.nominal.position_rms
        assert load_robot(name).n == len(found.data.axis_dir)
