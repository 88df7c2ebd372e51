"""The measured campaign: the contract's columns, determinism, independent streams, noise."""

import time

import numpy as np
import pandas as pd
import pytest

from experiments.virtual_robot import Hidden, measure
from experiments.virtual_robot.instrument import to_instrument, torque_noise
from experiments.virtual_robot.pose_tables import tracked_points

JOINTS = range(1, 7)
TEMPERATURES = [f"temp_link{i}_C" for i in JOINTS] + [f"temp_motor{i}_C" for i in JOINTS] + ["temp_ambient_C"]
Q, TAU = [f"q{i}_rad" for i in JOINTS], [f"tau{i}_Nm" for i in JOINTS]
LOG = ["run", "time_s", *Q, *(f"qd{i}_rad_s" for i in JOINTS), *TAU]
FIXTURE = [f"fixture_{a}" for a in ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")]
CLAMPED = ["sweep", "joint", "time_s", *(f"motor{i}_rad" for i in JOINTS), *TAU, *FIXTURE]
POSES = ["pose", "visit", "time_s", *Q, *(f"dir{i}" for i in JOINTS), "target", "x_m", "y_m", "z_m"]


@pytest.mark.parametrize(
    ("name", "head"),
    [("free_air", LOG), ("wrist", LOG), ("clamped", CLAMPED), ("poses", POSES), ("verification", POSES)],
)
def test_columns_are_those_of_the_contract(clean, name, head):
    table = clean.tables[name]
    assert list(table.columns) == head + TEMPERATURES
    assert not table.isna().any(axis=None)
    assert len(clean.truth.noise_free[name]) == len(table)


def test_header_is_that_of_the_contract(clean):
    h = clean.header
    assert h["format"] == "clampid-campaign/1"
    assert h["robot"] == "kuka_kr20_r1810"
    assert h["tool"] == {"mass_kg": 12.0, "com_m": [0.0, 0.0, 0.08]}
    assert h["targets_m"]["T2"] == [-0.05, 0.0866, 0.12]
    assert 2e-5 <= h["instrument"]["position_std_m"] <= 6e-5
    assert clean.hidden == []


@pytest.mark.parametrize("name", ["free_air", "wrist", "clamped"])
def test_time_increases_within_runs(clean, name):
    table = clean.tables[name]
    key = "sweep" if name == "clamped" else "run"
    assert (table.groupby(key)["time_s"].diff().dropna() > 0).all()
    assert table.groupby(key)["time_s"].min().is_monotonic_increasing


def test_visits_replicates_and_the_clock_of_verification(clean):
    poses, verification = clean.tables["poses"], clean.tables["verification"]
    assert poses["time_s"].is_monotonic_increasing
    assert verification["time_s"].min() > poses["time_s"].max()
    assert poses["pose"].nunique() == 60
    assert verification["pose"].nunique() == 80
    visits = poses.groupby(["pose", "visit"]).first()
    assert (poses.groupby(["pose", "visit"]).size() == 3).all()
    dirs = [f"dir{i}" for i in JOINTS]
    again = visits.loc[visits.index.get_level_values("visit") == 2]
    same = [bool((visits.loc[(p, 1), dirs] == row[dirs]).all()) for (p, _), row in again.iterrows()]
    assert len(same) == 6
    assert any(same)
    assert not all(same)


def test_two_runs_of_a_seed_are_the_same_and_of_two_seeds_are_not(robot, clean):
    again = measure(robot, seed=3, poses=60)
    for name, table in clean.tables.items():
        pd.testing.assert_frame_equal(table, again.tables[name])
    other = measure(robot, seed=4, poses=60, tables=["poses"])
    assert not np.allclose(other.tables["poses"]["x_m"], clean.tables["poses"]["x_m"])


def test_leaving_tables_out_changes_no_other(robot, clean):
    some = measure(robot, seed=3, poses=60, tables=["verification", "clamped"])
    assert list(some.tables) == ["clamped", "verification"]
    for name, table in some.tables.items():
        pd.testing.assert_frame_equal(table, clean.tables[name])


def test_hiding_changes_neither_plant_nor_program_nor_noise(robot, clean):
    hidden = measure(robot, [Hidden("payload"), Hidden("backlash", "joint2")], seed=3, poses=60)
    for name, table in hidden.tables.items():
        values = [c for c in table.columns if c[:3] in ("tau", "x_m", "y_m", "z_m")]
        rest = [c for c in table.columns if c not in values]
        pd.testing.assert_frame_equal(table[rest], clean.tables[name][rest])
        noise = table[values].to_numpy() - hidden.truth.noise_free[name]
        before = clean.tables[name][values].to_numpy() - clean.truth.noise_free[name]
        # Repeatability passes through a slightly bent arm: a millionth of it differs.
        np.testing.assert_allclose(noise, before, atol=1e-7)


def test_what_one_effect_draws_does_not_depend_on_the_others(robot):
    alone = measure(robot, [Hidden("gear_eccentricity")], seed=3, poses=2, tables=["poses"]).hidden
    both = measure(robot, [Hidden("payload"), Hidden("gear_eccentricity")], seed=3, poses=2, tables=["poses"]).hidden
    assert both[1] == alone[0]


def test_scatter_of_points_is_instrument_and_repeatability(clean, plant):
    table = clean.tables["verification"]
    scatter = table[["x_m", "y_m", "z_m"]].to_numpy() - clean.truth.noise_free["verification"]
    assert plant.instrument.sigma < scatter.std() < np.hypot(plant.instrument.sigma, 25e-6)


def test_the_robot_itself_repeats_within_ten_to_twenty_micrometres(plant, bodies, q):
    joints = plant.instrument.repeatability * np.random.default_rng(0).standard_normal(q.shape)
    cold = np.full_like(q, 20.0)
    apart = tracked_points(plant, bodies, q + joints, cold) - tracked_points(plant, bodies, q, cold)
    assert 1e-5 < np.sqrt(np.mean(np.sum(apart**2, axis=-1))) < 2e-5
    shared = apart.mean(axis=1, keepdims=True)  # the targets of a visit move together
    assert np.sum((apart - shared) ** 2) < 0.1 * np.sum(apart**2)


def test_torque_noise_is_correlated_in_time():
    noise = torque_noise(np.array([0.1, 1.0]), 40_000, 0.1, np.random.default_rng(0))
    np.testing.assert_allclose(noise.std(axis=0), [0.1, 1.0], rtol=0.05)
    for lag, expected in ((1, 0.5 * np.exp(-0.05)), (20, 0.5 * np.exp(-1.0))):
        found = np.mean(noise[lag:] * noise[:-lag], axis=0) / noise.var(axis=0)
        np.testing.assert_allclose(found, expected, atol=0.06)


def test_the_instrument_frame_is_a_rotation_somewhere_else(plant):
    points = np.random.default_rng(0).standard_normal((10, 3))
    seen = to_instrument(plant.instrument, points)
    np.testing.assert_allclose(
        np.linalg.norm(seen[1:] - seen[:-1], axis=1), np.linalg.norm(np.diff(points, axis=0), axis=1)
    )
    np.testing.assert_allclose(np.linalg.det(plant.instrument.rotation), 1.0)
    assert np.linalg.norm(plant.instrument.origin) > 0.5


def test_wrist_runs_turn_motors_and_joints_apart(clean, robot):
    table = clean.tables["wrist"]
    motor_only = joint_only = 0
    for _, run in table.groupby("run"):
        q = run[Q].to_numpy()
        joint = np.ptp(q, axis=0)
        motor = np.ptp(q @ np.linalg.inv(robot.transmission), axis=0)
        motor_only += bool(np.any((joint < 1e-9) & (motor > 0.1)))
        joint_only += bool(np.any((joint > 1e-3) & (motor < 1e-9)))
    assert motor_only >= 4
    assert joint_only >= 4


def test_motors_at_rest_keep_their_friction_through_the_wrist_runs(clean, plant):
    truth = clean.truth.noise_free["wrist"]
    runs = clean.tables["wrist"]["run"].to_numpy()
    # Motor 1 stands still throughout, and so does its dry friction; the inertia of the wrist is small beside it.
    assert np.ptp([truth[runs == r, 0].mean() for r in np.unique(runs)]) < 0.1 * plant.friction.coulomb[0]


def test_outliers_are_reported_and_nothing_else_changes(robot, clean):
    spoilt = measure(robot, seed=3, poses=60, outliers=0.02)
    for name, table in spoilt.tables.items():
        rows = list(spoilt.truth.outliers[name])
        assert len(rows) == (0 if name == "verification" else round(0.02 * len(table)))
        changed = np.flatnonzero((table != clean.tables[name]).any(axis=1))
        assert list(changed) == rows
    size = (spoilt.tables["poses"] - clean.tables["poses"][["x_m", "y_m", "z_m"]])[["x_m", "y_m", "z_m"]]
    assert np.linalg.norm(size.to_numpy(), axis=1).max() > 1e-3


def test_a_campaign_takes_less_than_five_seconds(robot):
    start = time.process_time()
    measure(robot, [Hidden("hysteresis"), Hidden("fixture_compliance"), Hidden("link_bending")], seed=9)
    assert time.process_time() - start < 5


@pytest.mark.parametrize("name", ["ur10", "staubli_tx40", "abb_irb2400_12_155"])
def test_other_robots(name):
    from kinematics.description import load_robot

    measured = measure(load_robot(name), [Hidden("backlash"), Hidden("gear_eccentricity")], poses=10)
    assert {"poses", "verification"} <= set(measured.tables)
    for table in measured.tables.values():
        assert np.isfinite(table.select_dtypes("number").to_numpy()).all()


def test_a_robot_without_links_has_no_torques(robot):
    from dataclasses import replace

    bare = replace(robot, links=())
    measured = measure(bare, poses=5)
    assert list(measured.tables) == ["poses", "verification"]
    with pytest.raises(ValueError, match="no links"):
        measure(bare, tables=["clamped"])
    with pytest.raises(ValueError, match="leaves no trace"):
        measure(bare, [Hidden("payload")], poses=5)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ({"poses": 0}, "poses"),
        ({"outliers": 1.0}, "outliers"),
        ({"tables": ["pose"]}, "'pose'.*free_air"),
    ],
)
def test_wrong_calls_say_what_is_wrong(robot, call, message):
    with pytest.raises(ValueError, match=message):
        measure(robot, **call)
