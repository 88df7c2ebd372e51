"""Comparison and addition: the numbers, the keys of the contract, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
import pytest

from clampid.comparison.compare import compare
from clampid.display import error_text
from clampid.effect import EffectError
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.loop.add import add
from clampid.models.model import Model, ModelError
from clampid.report.placing import placing_tables
from experiments.campaign import Campaign

Simulated = Callable[..., Campaign]

POSES = ("poses", "verification")
STANDARD = ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction")
NUMBERS = {"rms", "mean", "max", "p95"}


@pytest.fixture(scope="module")
def eccentric(simulated: Simulated) -> Campaign:
    return simulated(seed=6, poses=100, tables=("poses",), hidden=("gear_eccentricity@joint3:2",))


@pytest.fixture(scope="module")
def eccentric_model(eccentric: Campaign) -> Model:
    return identify(eccentric, {"poses": STANDARD}, holdout=0.2, seed=1)


@pytest.fixture(scope="module")
def torques(simulated: Simulated) -> Campaign:
    return simulated(seed=6, tables=("free_air", "wrist"), hidden=("torque_offset@joint2:2",))


@pytest.fixture(scope="module")
def torque_model(torques: Campaign) -> Model:
    return identify(torques)


def test_compare_poses(eccentric: Campaign, eccentric_model: Model):
    out = compare(eccentric_model, eccentric).to_json()
    assert {"model", "campaign", "tables"} <= set(out)
    assert set(out["tables"]) == {"poses"}
    poses = out["tables"]["poses"]
    assert {"unit", "rows", "noise_floor", "noise_source", "heldout", *NUMBERS} <= set(poses)
    assert poses["unit"] == "m"
    assert {"rows", *NUMBERS} <= set(poses["heldout"])
    total, held = len(eccentric.tables["poses"]), eccentric_model.stages["poses"].held_out[0]
    numbers = np.unique(eccentric.tables["poses"]["pose"])
    rows_held = int(eccentric.tables["poses"]["pose"].isin(numbers[list(held)]).sum())
    rejected = len(eccentric_model.stages["poses"].outliers)
    assert poses["heldout"]["rows"] == rows_held
    assert poses["rows"] == total - rows_held - rejected
    assert len(held) == round(0.2 * len(numbers))
    for part in (poses, poses["heldout"]):
        assert part["mean"] <= part["rms"] <= part["p95"] <= part["max"]
    ledger = eccentric_model.ledger[-1]
    assert poses["rms"] == pytest.approx(ledger.rms, rel=1e-6)
    assert poses["heldout"]["rms"] == pytest.approx(ledger.heldout_rms, rel=1e-6)
    assert poses["noise_floor"] == pytest.approx(ledger.noise_floor, rel=1e-6)
    assert json.loads(json.dumps(out, allow_nan=False)) == out


def test_compare_says_how_poses_are_reached(eccentric: Campaign, eccentric_model: Model):
    sample = (1.2, 0.1, 0.9)
    poses = compare(eccentric_model, eccentric, sample=sample).to_json()["tables"]["poses"]
    table, iso = eccentric.tables["poses"], poses["iso9283"]["robot"]["position"]
    sides = [f"dir{i + 1}" for i in range(6)]
    again = table.groupby(["pose", "target", *sides]).filter(lambda g: len(g) > 1)
    groups = again.groupby(["pose", "target", *sides])
    assert iso["RP"]["places"] == groups.ngroups
    assert iso["RP"]["poses"] == again["pose"].nunique()
    # Of the measured points themselves, by hand: two returns, half of their distance.
    by_hand = groups[["x_m", "y_m", "z_m"]].agg(lambda g: g.iloc[1] - g.iloc[0])
    assert iso["RP"]["max"] == pytest.approx(np.linalg.norm(by_hand, axis=1).max() / 2, rel=1e-6)
    assert iso["vAP"]["mean"] > iso["RP_of_30"]["interval95"][0]
    # As its controller has it the robot errs by millimetres, and the model takes most of that out.
    left = poses["iso9283"]["compensated"]["position"]["AP"]["mean"]
    assert iso["AP"]["mean"] > 3 * left
    assert poses["robot"]["universal"]["P_mean"] > 3 * poses["universal"]["P_mean"]
    assert poses["iso9283"]["compensated_rows"] in ("held out", "all")
    assert poses["iso9283"]["reported_angles_differ_m"] < 1e-9
    turns = poses["iso9283"]["robot"]["orientation"]  # of three targets at a visit
    assert turns["RP"]["poses"] == iso["RP"]["poses"]
    assert turns["AP"]["mean"] > turns["AP"]["by_scatter"]
    held = poses["heldout"]
    assert poses["universal"]["P_mean"] == pytest.approx(held["mean"])
    assert poses["universal"]["P_max"] == pytest.approx(held["max"])
    both = poses["sample"]["radial"]["rms"] ** 2 + poses["sample"]["along"]["rms"] ** 2
    assert np.sqrt(both) == pytest.approx(held["rms"], rel=1e-9)


def test_the_report_says_how_poses_are_reached(eccentric: Campaign, eccentric_model: Model):
    tables = compare(eccentric_model, eccentric, sample=(1.2, 0.1, 0.9)).to_json()["tables"]
    robot, compensated, errors = placing_tables(tables)
    metrics = [row[0] for row in robot.rows]
    assert metrics[0] == "AP, pose accuracy"
    assert "RP as 30 returns would show it" in metrics
    assert any("not determinable" in metric and metric.startswith("dRP") for metric in metrics)
    assert len(robot.columns) == len(robot.rows[0])
    assert "compensated with this model" in compensated.caption
    mean = tables["poses"]["robot"]["universal"]["P_mean"]
    assert errors.rows[0][2] == error_text(mean, "m")
    assert [len(row) for row in errors.rows] == [len(errors.columns)] * 2


def test_compare_torques(torques: Campaign, torque_model: Model):
    out = compare(torque_model, torques).to_json()["tables"]
    assert set(out) == {"free_air", "wrist"}
    for table in out.values():
        assert table["unit"] == "sigma"
        assert table["noise_floor"] == 1.0
        assert table["heldout"]["rows"] > 0
        assert len(table["per_motor"]) == 6
        for motor in table["per_motor"]:
            assert {"rms_Nm", "noise_floor_Nm", "r2", "heldout"} <= set(motor)
            assert {"rms_Nm", "r2"} <= set(motor["heldout"])
    assert all(0.9 < m["r2"] <= 1.0 for m in out["free_air"]["per_motor"])


def test_two_comparisons_are_one(eccentric: Campaign, eccentric_model: Model):
    assert compare(eccentric_model, eccentric).to_json() == compare(eccentric_model, eccentric).to_json()


def test_another_day_needs_a_refit(simulated: Simulated, eccentric_model: Model, eccentric: Campaign):
    other = simulated(seed=6, poses=60, tables=("poses",), hidden=("gear_eccentricity@joint3:2",))
    assert other.fingerprint != eccentric.fingerprint
    with pytest.raises(ModelError, match="--refit"):
        compare(eccentric_model, other)
    out = compare(eccentric_model, other, refit=("base", "tool"), refit_fraction=0.3, seed=2).to_json()["tables"][
        "poses"
    ]
    poses = out["rows"] + out["heldout"]["rows"]
    assert 0.98 * len(other.tables["poses"]) <= poses <= len(other.tables["poses"])
    assert out["rows"] == pytest.approx(0.3 * poses, rel=0.1)
    before = compare(eccentric_model, eccentric).to_json()["tables"]["poses"]["heldout"]["rms"]
    assert out["heldout"]["rms"] < 1.3 * before
    again = compare(eccentric_model, other, refit=("base", "tool"), refit_fraction=0.3, seed=2).to_json()
    assert again["tables"]["poses"] == out


def test_wrong_calls(eccentric: Campaign, eccentric_model: Model, simulated: Simulated):
    with pytest.raises(ValueError, match="base or tool"):
        compare(eccentric_model, eccentric, refit=("joints",))
    with pytest.raises(ValueError, match="between 0 and 1"):
        compare(eccentric_model, eccentric, refit=("base",), refit_fraction=1.0)
    ur10 = simulated(seed=1, poses=20, tables=("poses",), robot="ur10")
    with pytest.raises(ModelError, match="ur10"):
        compare(eccentric_model, ur10)


def test_add_the_true_effect(eccentric: Campaign, eccentric_model: Model):
    mended, addition = add(eccentric_model, eccentric, ["gear_eccentricity@joint3"])
    out = addition.to_json()
    assert set(out) == {"stages"}
    stage = out["stages"]["poses"]
    assert {"unit", "added", "noise_floor", "heldout_rms_before", "heldout_rms_after"} <= set(stage)
    assert stage["unit"] == "m"
    assert [(a["effect"], a["where"]) for a in stage["added"]] == [("gear_eccentricity", ["joint3"])]
    assert len(stage["added"][0]["parameters"]) == 4
    assert {"name", "value", "std", "unit"} <= set(stage["added"][0]["parameters"][0])
    assert stage["heldout_rms_after"] < 0.8 * stage["heldout_rms_before"]
    assert stage["heldout_rms_before"] == pytest.approx(eccentric_model.ledger[-1].heldout_rms, rel=1e-3)
    assert len(mended.ledger) == len(eccentric_model.ledger) + 1
    last = mended.ledger[-1]
    assert last.added == ("gear_eccentricity@joint3",)
    assert last.heldout_rms == pytest.approx(stage["heldout_rms_after"])
    assert mended.stages["poses"].held_out == eccentric_model.stages["poses"].held_out
    assert json.loads(json.dumps(out, allow_nan=False)) == out
    # What was added is in force: the comparison of the mended model says the same error.
    compared = compare(mended, eccentric).to_json()["tables"]["poses"]["heldout"]["rms"]
    assert compared == pytest.approx(stage["heldout_rms_after"], rel=1e-3)


def test_add_moves_where_flanks_follow_free_masses(eccentric: Campaign):
    model = identify(eccentric, {"poses": ("geometry", "joint_compliance", "backlash", "gravity")}, holdout=0.2, seed=1)
    _, addition = add(model, eccentric, ["gear_eccentricity@joint3"])
    stage = addition.to_json()["stages"]["poses"]
    assert stage["heldout_rms_after"] < 0.8 * stage["heldout_rms_before"]


def test_add_in_torques(torques: Campaign, torque_model: Model):
    _, addition = add(torque_model, torques, ["free_air=torque_offset@joint2"])
    stage = addition.to_json()["stages"]["free_air"]
    assert stage["unit"] == "sigma"
    assert stage["heldout_rms_after"] < stage["heldout_rms_before"]


@pytest.mark.slow
def test_errors_before_and_after_are_in_the_same_unit(torques: Campaign):
    """A friction that is missing looks like noise in part: by its own noise, each model's error is another's number."""
    first = identify(torques, {"free_air": ("gravity", "coulomb_friction")})
    mended, addition = add(first, torques, ["free_air=viscous_friction"])
    before, after = (on_campaign(model, torques).refit("free_air") for model in (first, mended))
    stage = addition.stages["free_air"]
    assert stage.before.heldout_rms == pytest.approx(first.ledger[-1].heldout_rms, rel=1e-5)
    # Two rounds learn a log's noise, and `add` begins with that of the fit before: a tenth of the units' difference.
    assert stage.after.heldout_rms == pytest.approx(after.errors(None, 0, before.floor).heldout_rms, rel=1e-3)
    assert after.errors(None, 0).heldout_rms > 1.005 * stage.after.heldout_rms


def test_add_without_a_place_goes_wherever_it_can_be_identified(eccentric: Campaign, eccentric_model: Model):
    mended, _ = add(eccentric_model, eccentric, ["gear_eccentricity"])
    places = {s.place for s in mended.stages["poses"].slots if s.effect == "gear_eccentricity"}
    assert "joint3" in places
    assert len(places) > 1


@pytest.mark.parametrize(
    ("term", "said"),
    [
        ("gremlins", "gremlins"),
        ("gear_eccentricity@joint9", "joint9"),
        ("backlash", "in the model already"),
        ("stribeck_friction", "does not act"),
        ("clamped=backlash", "clamped"),
        ("pose=backlash", "stage"),
    ],
)
def test_add_refuses(eccentric: Campaign, eccentric_model: Model, term: str, said: str):
    with pytest.raises((EffectError, ModelError), match=said):
        add(eccentric_model, eccentric, [term])
