"""What the data do not determine is exported at its nominal value; the table is the best one for a controller."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clampid.exports.determined import determined_shifts, fix_undetermined
from clampid.exports.dh_export import NOT_DETERMINED, calibrated_chain, dh_export, dh_table, postures
from clampid.exports.kuka_export import kuka_machine_data
from clampid.exports.urdf_export import urdf_export
from clampid.identification.identify import identify
from clampid.models.model import Model
from clampid.report.limits import shifted
from clampid.slots import Slot
from experiments.campaign import read_campaign
from kinematics.description import load_robot
from kinematics.kuka import forward as machine_data_forward
from kinematics.poe import forward
from kinematics.urdf import read_urdf

SERIES_D = Path(__file__).parents[3] / "shared" / "real" / "ur10_series_d"


def loosened(model: Model) -> tuple[Model, int, int]:
    """A model that knows the sum of y of base and flange, and hardly their difference: both far from nominal."""
    stage = model.stages["poses"]
    a, b = (stage.slots.index(Slot("geometry", f"{end}_y", "session1")) for end in ("base", "flange"))
    theta, covariance = stage.theta.copy(), stage.covariance.copy()
    theta[[a, b]] = 0.0296, -0.0291
    covariance[np.ix_([a, b], [a, b])] += 0.006**2 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return model.with_stage(replace(stage, theta=theta, covariance=covariance)), a, b


@pytest.fixture
def loose(make_model) -> tuple[Model, int, int]:
    """Such a UR10."""
    return loosened(make_model("ur10", size=1e-4))


def test_what_is_not_determined_is_held_and_what_is_known_stays(loose):
    model, a, b = loose
    fixed = fix_undetermined(model)
    assert fixed.combinations == ("base_y@session1, flange_y@session1",)
    old, new = model.stages["poses"].theta, fixed.model.stages["poses"].theta
    assert new[a] + new[b] == pytest.approx(old[a] + old[b], abs=1e-7)
    assert abs(new[a] - new[b]) < 1e-6
    others = np.delete(np.arange(len(old)), [a, b])
    np.testing.assert_array_equal(new[others], old[others])
    assert fixed.model.stages["poses"].std[a] < 1e-5


@pytest.mark.slow
def test_a_determined_model_is_left_alone(make_model):
    model = make_model("ur10")
    assert fix_undetermined(model).model is model
    assert set(dh_table(model, "hayati")[NOT_DETERMINED]) == {""}


def test_table_marks_fixed_numbers_without_standard_error(loose):
    found = dh_export(loose[0], "hayati", fit="static")
    for _, row in found.table.iterrows():
        open_ = row[NOT_DETERMINED].split()
        numbers = [c for c in row.index if f"std_{c}" in row.index and np.isfinite(row[c])]
        assert [c for c in numbers if not np.isfinite(row[f"std_{c}"])] == open_
    assert any(found.table[NOT_DETERMINED])
    assert any(
        "fixed at its nominal value: a combination of base_y@session1, flange_y@session1" in s for s in found.said
    )
    assert found.to_json()["held_at_nominal"] == ["base_y@session1, flange_y@session1"]
    assert "fixed at its nominal value" in urdf_export(loose[0]).text


def test_the_urdf_is_the_arm_with_what_is_not_determined_at_its_nominal_value(loose, tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(urdf_export(loose[0]).text)
    back, q = read_urdf(path, "flange"), postures(load_robot("ur10"))
    there = forward(back.screws, back.flange, q)
    np.testing.assert_allclose(there, calibrated_chain(fix_undetermined(loose[0]).model).flange(q), atol=1e-9)
    assert np.abs(there - calibrated_chain(loose[0]).flange(q)).max() > 0.02


def test_machine_data_are_of_the_arm_with_what_is_not_determined_at_its_nominal_value(make_model):
    model = loosened(make_model("kuka_kr20_r1810", size=1e-4))[0]
    q = postures(load_robot("kuka_kr20_r1810"))
    there = machine_data_forward(kuka_machine_data(model).data, q)
    assert np.abs(there - calibrated_chain(fix_undetermined(model).model).flange(q)).max() < 2e-3
    assert np.abs(there - calibrated_chain(model).flange(q)).max() > 0.02


@pytest.fixture(scope="module")
def series_d() -> tuple[Model, Model]:
    """UR10 series D with geometry alone, and with springs that are no part of a table."""
    if not SERIES_D.is_dir():
        pytest.skip("the real measurements are not here")
    campaign = read_campaign(SERIES_D)
    sprung = ["geometry", "joint_compliance@joint2", "joint_compliance@joint3", "joint_compliance@joint4"]
    return identify(campaign, {"poses": ["geometry"]}), identify(campaign, {"poses": sprung})


def test_a_constant_of_the_table_has_no_standard_error_of_rounding(series_d):
    """Row ``tool``: z and the turn about z are given by convention; 2.5e-14 m and 2.9e-13 rad were printed."""
    table = dh_table(series_d[0], "hayati")
    std = table[[c for c in table.columns if c.startswith("std_")]].to_numpy(float)
    assert not ((std > 0) & (std < 1e-10)).any()
    tool = table[table["row"] == "tool"].iloc[0]
    assert (tool["std_z_m"], tool["std_rz_rad"]) == (0.0, 0.0)


def test_the_ur10_table_keeps_its_nominal_last_offset(series_d):
    """The probe's mount absorbs it: 174.5 mm were exported, nominal is 92.2 mm."""
    for model in series_d:
        table = dh_table(model, "hayati")
        row = table[table["row"] == "6"].iloc[0]
        assert row["d_m"] == pytest.approx(0.0922, abs=0.002)
        assert np.isnan(row["std_d_m"])
        assert "d_m" in row[NOT_DETERMINED].split()
    said = dh_export(series_d[0], "hayati").said
    assert any("row 6: d_m 0.091" in line and "(nominal 0.0922)" in line for line in said), said
    assert any(line.startswith("the measured frame is mounted at -89.9 deg on the flange") for line in said), said


def test_a_frame_mounted_straight_is_not_spoken_of(make_model):
    assert not any("mounted" in line for line in dh_export(make_model("ur10", size=1e-3), "hayati").said)


def test_the_best_table_leaves_no_more_than_a_geometric_fit(series_d):
    """For a controller that knows tables only; the geometry of a model with springs leaves nearly twice as much."""
    campaign = read_campaign(SERIES_D)
    geometric = dh_export(series_d[0], "hayati", campaign=campaign).measured
    static, best = (dh_export(series_d[1], "hayati", fit=f, campaign=campaign) for f in ("static", "best"))
    assert geometric is not None
    assert static.measured is not None
    assert best.measured is not None
    assert geometric.mean < 0.37e-3
    assert best.measured.mean < 1.03 * geometric.mean
    assert static.measured.mean > 1.3 * best.measured.mean
    assert best.fit is not None
    assert best.fit.best.position_rms < best.fit.static.position_rms
    assert best.said[0].startswith("fitted to the whole model at the 632 poses of ur10_series_d")


@pytest.mark.slow
def test_the_best_table_has_standard_errors_of_the_whole_model(make_model):
    """Half a play in either direction shifts no table; the rest follows the geometry one to one.

    But for what this model, unlike a fitted one, has twice (base and first link): the fit shares it between both.
    """
    model = make_model("ur10", size=1e-4)
    both = [dh_table(model, "hayati", fit=f) for f in ("best", "static")]  # type: ignore[arg-type]
    for column in ("std_theta_offset_rad", "std_a_m", "std_alpha_rad"):
        ratio = both[0][column].dropna().to_numpy() / np.maximum(both[1][column].dropna().to_numpy(), 1e-12)
        used = both[1][column].dropna().to_numpy() > 1e-7
        assert np.all((ratio[used] > 0.6) & (ratio[used] < 1.5))


@pytest.mark.slow
def test_an_uncertain_spring_makes_the_best_table_uncertain(series_d):
    """By as much as the table moves with it, in each row; the model's own geometry does not.

    Found at a fifth of the postures, standard errors of some rows were half as large again.
    """
    model = series_d[1]
    stage = model.stages["poses"]
    k = stage.slots.index(Slot("joint_compliance", "c", "joint2"))
    more = 20.0 * stage.std[k]
    theta, covariance = stage.theta.copy(), stage.covariance.copy()
    theta[k] += more
    covariance[k, k] += more**2
    softer, unsure = (model.with_stage(replace(stage, **new)) for new in ({"theta": theta}, {"covariance": covariance}))
    rows = [f"{i}" for i in range(1, 7)]

    def column(model: Model, name: str, fit: str = "best") -> np.ndarray:
        table = dh_table(model, "hayati", fit=fit)
        return table[table["row"].isin(rows)][name].to_numpy(float)

    for name in ("theta_offset_rad", "a_m"):
        std = f"std_{name}"
        moved = np.abs(column(softer, name) - column(model, name))
        gained = np.sqrt(np.maximum(column(unsure, std) ** 2 - column(model, std) ** 2, 0.0))
        assert np.argmax(gained) == np.argmax(moved) == 1
        np.testing.assert_allclose(gained, moved, rtol=0.05, atol=0.05 * moved[1])
        assert moved.max() > column(model, std).max()
        np.testing.assert_allclose(column(unsure, std, "static"), column(model, std, "static"), rtol=1e-6)


def test_shifts_of_what_is_not_determined_are_not_shown():
    """The table "biased by what was missing" said 53.2 ± 2.1 mm of flange_y, of which only a combination is known."""
    found = [
        {"name": "geometry.flange_y@session1", "shift": 0.0532, "std": 0.0021, "unit": "m"},
        {"name": "geometry.base_z@session1", "shift": -788e-6, "std": 12e-6, "unit": "m"},
        {"name": "joint_compliance.c@joint5", "shift": -2e-3, "std": 9e-4, "unit": "rad/Nm"},  # as motors see it
        {"name": "mine.c@joint1", "shift": 1.0, "std": 0.5, "unit": "rad"},
    ]
    assert determined_shifts(found) == found[1:]
    (table,) = shifted(found[:2])
    assert [row[0] for row in table.rows] == ["geometry.base_z@session1"]
