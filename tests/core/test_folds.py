"""What is held out: whole runs where they are exchangeable, parts where they differ in what a candidate needs."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.diagnosis.diagnose import diagnose
from clampid.diagnosis.folds import extrapolated_in, parts_of_runs, runs_determine_each_other, stability_folds
from clampid.fitting.accuracy import cross_validated
from clampid.identification.identify import identify, stage_rows
from clampid.identification.model_on_campaign import on_campaign
from clampid.stages.layout import layout_of
from clampid.stages.rows import Rows
from experiments.campaign import Campaign, read_campaign
from experiments.simulate import simulate
from experiments.virtual_robot import Plant

PER_KELVIN = 0.01  # of the motors' friction


def rubs_less_warm(plant: Plant) -> Plant:
    """Every motor's friction falls with its warmth, and every motor warms up twice as much as usual."""
    friction = replace(plant.friction, thermal=np.full(plant.n, PER_KELVIN))
    return replace(plant, friction=friction, heat=replace(plant.heat, motor_rise=2.0 * plant.heat.motor_rise))


@pytest.fixture(scope="module")
def warming(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """Two runs, the second warmer than the first."""
    folder = tmp_path_factory.mktemp("folds") / "arm"
    simulate(folder, seed=3, tables=("free_air",), alter=rubs_less_warm)
    return read_campaign(folder)


@pytest.fixture(scope="module")
def rows(warming: Campaign) -> Rows:
    return stage_rows([warming], layout_of([warming]), "free_air")


def test_runs_that_differ_in_warmth_are_no_test_of_warmth(rows: Rows):
    effects = catalogue()
    all_alike, thermal = np.ones(len(rows)), effects["temperature_dependent_friction"]
    assert extrapolated_in(rows, thermal, ("joint1",), all_alike) == ("motor_temperature",)
    assert extrapolated_in(rows, effects["warm_up_friction"], (), all_alike) == ("elapsed",)
    for name in ("viscous_friction", "torque_ripple", "load_dependent_friction", "torque_offset"):
        assert extrapolated_in(rows, effects[name], ("joint1",), all_alike) == ()


def test_runs_of_the_same_warmth_are(warming: Campaign):
    log = warming.tables["free_air"]
    first = log["run"] == 1
    again = np.interp(np.linspace(0, 1, (~first).sum()), np.linspace(0, 1, first.sum()), log["temp_motor1_C"][first])
    log = log.copy()
    log.loc[~first, "temp_motor1_C"] = again
    alike = replace(warming, tables=MappingProxyType({"free_air": log}))
    rows = stage_rows([alike], layout_of([alike]), "free_air")
    effect = catalogue()["temperature_dependent_friction"]
    assert extrapolated_in(rows, effect, ("joint1",), np.ones(len(rows))) == ()
    assert extrapolated_in(rows, effect, ("joint2",), np.ones(len(rows))) == ("motor_temperature",)


def test_slow_runs_are_no_test_of_what_only_the_fastest_shows(rows: Rows):
    """Most rows of the slower run lie within the speeds of the faster; the curvature of friction does not."""
    speed = rows.signals["motor_speed"]
    slow = rows.fold == rows.fold.max()
    fast = speed / np.where(slow, speed[slow, 0].max(), speed[~slow, 0].max())[:, None]
    effect = catalogue()["quadratic_friction"]
    for top, wanted in ((1.0, ()), (0.99, ()), (0.3, ("motor_speed",))):
        signals = MappingProxyType({**rows.signals, "motor_speed": np.where(slow[:, None], top * fast, fast)})
        shows = signals["motor_speed"][:, 0] ** 4  # the square of what a unit of it does
        assert extrapolated_in(replace(rows, signals=signals), effect, ("joint1",), shows) == wanted
    assert extrapolated_in(replace(rows, signals=signals), effect, ("joint1",), np.ones(len(rows))) == ()


@pytest.mark.parametrize("alone", [True, False])
def test_a_run_that_moves_a_joint_alone_is_predicted_by_no_other(warming: Campaign, alone: bool):
    """Its own friction, and masses behind it, are only in its rows: without them any value of these is possible."""
    log = warming.tables["free_air"].copy()
    first = (log["run"] == 1).to_numpy()
    if alone:
        columns = ["q6_rad", *(c for c in log if c == "qd6_rad_s")]
        log.loc[~first, columns] = log.loc[~first, columns].iloc[0].to_numpy()
    campaign = replace(warming, tables=MappingProxyType({"free_air": log}))
    estimate = on_campaign(identify(campaign), campaign).refit("free_air").estimate
    assert runs_determine_each_other(estimate, seed=0) != alone
    if alone:
        rows, residual = cross_validated(estimate, estimate.problem.rows, 0)
        mine = rows.used[:, 5] & (rows.fold == rows.fold.min())
        assert np.std(residual[mine, 5]) > 3.0 * np.std(estimate.residual[mine, 5])


def test_every_part_has_a_piece_of_every_run_and_is_judged_off_its_ends(rows: Rows):
    part, judged = parts_of_runs(rows)
    for run in np.unique(rows.fold):
        mine = np.flatnonzero(rows.fold == run)
        assert set(part[mine]) == set(range(5))
        cut = mine[1:][np.diff(part[mine]) != 0]
        assert len(cut) == 4  # contiguous
        for k in cut:  # a unit of noise on either side of a cut is not judged
            assert not judged[rows.unit == rows.unit[k]].any()
            assert not judged[rows.unit == rows.unit[k - 1]].any()
    assert judged.mean() > 0.9
    np.testing.assert_array_equal(stability_folds(rows), part)  # of two runs, a fifth of the rows is no run


@pytest.mark.slow
def test_friction_that_warms_up_over_all_motors_is_named_where_runs_differ_in_warmth(warming: Campaign):
    found = diagnose(identify(warming), warming).stages["free_air"]
    assert found.verdict == "missing"
    assert {c["effect"] for c in found.candidates} == {"temperature_dependent_friction"}
    assert len({place for c in found.candidates for place in c["where"]}) >= 3
    assert found.after < found.before
    assert found.to_json()["folds"] == {"held_out": "parts of runs", "because": ["motor_temperature"]}
    assert "outside the others in motor temperature" in found.summary
