"""Masses of a torque log follow the springs that only poses tell: the arm has yielded under its weight."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from virtual_arms import arm

from clampid.catalogue import catalogue
from clampid.fitting.log_springs import spring_torques, springs
from clampid.fitting.prior_and_start import prior_of
from clampid.identification.carried import carried_over
from clampid.identification.fitted_stage import fit_stage
from clampid.identification.identify import identify, stage_rows, standard_effects
from clampid.models.model import Model, load_model, save_model
from clampid.slots import Prior, Slot
from clampid.stages.fit_problem import FitProblem, fit_problem
from clampid.stages.layout import layout_of
from clampid.stages.loads import declared_weight, gravity_signals
from clampid.stages.rows import Array
from clampid.standard_sets import DYNAMICS, STANDARD
from experiments.campaign import Campaign, Tool
from experiments.simulate import measured_campaign
from experiments.virtual_robot import Measured, measure
from kinematics.description import load_robot

HEAVY = "abb_irb1200_5_09"  # yields by 5 mrad at joint 2
COUPLED = "kuka_kr20_r1810"


@cache
def measured(name: str) -> Measured:
    return measure(arm(name), seed=3, tables=("free_air", "wrist"))


def campaign_of(name: str) -> Campaign:
    return measured_campaign(measured(name), arm(name))


@cache
def model_of(name: str) -> Model:
    return identify(campaign_of(name))


def postures(n: int) -> Array:
    return np.random.default_rng(0).uniform(-1.0, 1.0, (20, n))


def _column(slot: Slot) -> int:
    """Of a mass or first moment, in the regressor."""
    return 4 * (int(slot.place.removeprefix("link")) - 1) + ("m", "mx", "my", "mz").index(slot.parameter)


@pytest.mark.parametrize("name", [HEAVY, COUPLED, "abb_irb2400_12_155"])
def test_torques_by_springs_are_those_of_the_arm_where_it_stands(name: str):
    """Against weights at postures that have yielded by -T' c T tau, central difference."""
    campaign = campaign_of(name)
    n, T, q = campaign.robot.n, np.asarray(campaign.robot.transmission), postures(campaign.robot.n)
    found = spring_torques(campaign.robot, declared_weight(campaign), np.asarray(campaign.gravity), q)
    load = gravity_signals(campaign, q)["gravity_torque"] @ T.T

    def torque(c: Array) -> Array:
        return np.asarray(gravity_signals(campaign, q - (load * c) @ T)["gravity_torque"] @ T.T)

    for drive in range(n):
        c = 1e-7 * np.eye(n)[drive]
        np.testing.assert_allclose(found[:, :, drive], (torque(c) - torque(-c)) / 2e-7, rtol=1e-6, atol=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "terms", "left"),
    [
        (HEAVY, STANDARD["free_air"], 0.3),
        (COUPLED, STANDARD["free_air"], 0.3),
        (HEAVY, (*STANDARD["free_air"], *DYNAMICS), 0.5),  # inertias take up a part of it, too
        (COUPLED, (*STANDARD["free_air"], *DYNAMICS), 0.5),
    ],
)
def test_a_log_of_an_arm_that_does_not_yield_has_other_masses(name: str, terms: tuple[str, ...], left: float):
    """What the weight's torques lose where the arm has yielded is put back: masses move by -B c, c the true springs."""
    campaign, plant = campaign_of(name), measured(name).truth.plant
    n, stage = campaign.robot.n, identify(campaign, {"free_air": terms}).stages["free_air"]
    T, c = np.asarray(campaign.robot.transmission), 1.0 / plant.drive.spring
    tables = dict(campaign.tables)
    for table in ("free_air", "wrist"):
        frame = campaign.tables[table].copy()
        q = frame[[f"q{i + 1}_rad" for i in range(n)]].to_numpy(float)
        at = (campaign.robot, declared_weight(campaign), np.asarray(campaign.gravity), q)
        frame[[f"tau{i + 1}_Nm" for i in range(n)]] -= spring_torques(*at) @ c
        tables[table] = frame
    stiff = identify(replace(campaign, tables=tables), {"free_air": terms}).stages["free_air"]
    assert stage.by_springs is not None
    masses = np.array([s.effect == "gravity" for s in stage.slots])
    moved, expected = (stiff.theta - stage.theta)[masses], (stage.by_springs @ c)[masses]
    # As loads in the log's postures: masses that cannot be told apart may trade. B is from some of the rows, and these
    # are not prewhitened: what it leaves must be little beside the noise.
    index = [_column(s) for s in stage.slots if s.effect == "gravity"]
    q = campaign.tables["free_air"][[f"q{i + 1}_rad" for i in range(n)]].to_numpy(float)[::20]
    Y = (T @ gravity_signals(campaign, q)["regressor"][:, :, index])[:, 1:3]
    variance = np.einsum("nip,pq,niq->ni", Y, stage.covariance[np.ix_(masses, masses)], Y)
    before, after = Y @ moved, Y @ (moved - expected)
    assert np.all(np.mean(after**2, axis=0) < 0.5**2 * np.mean(before**2, axis=0))
    assert np.all(np.mean(after**2, axis=0) < left**2 * np.mean(variance, axis=0))


def test_rows_and_windows_give_the_same():
    """As loads, each from a sample of its own."""
    campaign = campaign_of(HEAVY)
    layout, effects = layout_of([campaign]), catalogue()
    rows = stage_rows([campaign], layout, "free_air")
    whole = fit_stage(rows, effects, standard_effects([campaign])["free_air"], {}).model
    windows = model_of(HEAVY).stages["free_air"]
    assert whole.by_springs is not None
    assert windows.by_springs is not None
    index = [k for k, s in enumerate(windows.slots) if s.effect == "gravity"]
    q = rows.signals["q"][::40]
    Y = gravity_signals(campaign, q)["regressor"][:, :, [_column(windows.slots[k]) for k in index]][:, 1]
    one, other = (Y @ found[index][:, 1] for found in (whole.by_springs, windows.by_springs))
    assert np.sqrt(np.mean((one - other) ** 2)) < 0.3 * np.sqrt(np.mean(other**2))


def test_no_spring_slope_without_masses():
    robot = load_robot(HEAVY)
    assert not robot.has_masses
    campaign = replace(measured_campaign(measured(HEAVY), robot), tool=Tool(0.0, np.zeros(3)))
    assert identify(campaign).stages["free_air"].by_springs is None


def test_a_model_keeps_it(tmp_path: Path):
    model = model_of(HEAVY)
    save_model(model, tmp_path / "model.json")
    kept, was = load_model(tmp_path / "model.json").stages["free_air"].by_springs, model.stages["free_air"].by_springs
    assert kept is not None
    np.testing.assert_array_equal(kept, was)


@cache
def log_problem() -> FitProblem:
    campaign = campaign_of(HEAVY)
    return fit_problem(stage_rows([campaign], layout_of([campaign]), "free_air"), catalogue(), SLOTS)


SLOTS = (Slot("coulomb_friction", "Fc", "joint1"), Slot("gravity", "mx", "link2"), Slot("gravity", "mz", "link2"))


@given(hnp.arrays(float, 3, elements=st.floats(-2, 2)), hnp.arrays(float, 2, elements=st.floats(-5, 5)))
@settings(max_examples=30, deadline=None)
def test_a_prior_that_follows_is_one_of_the_difference(theta: Array, slope: Array):
    """(m - mean - s f)' C^-1 (m - mean - s f), and the prior of what is followed."""
    trial = log_problem()
    covariance, mean = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([0.3, -0.7])
    friction = Prior(SLOTS[:1], np.array([1.5]), np.array([[0.04]]))
    loads = Prior(SLOTS[1:], mean, covariance, SLOTS[:1], slope[:, None])
    own = (theta[0] - 1.5) ** 2 / 0.04
    off = theta[1:] - mean - slope * theta[0]
    expected = own + off @ np.linalg.inv(covariance) @ off
    for priors in ((friction, loads), (loads, friction)):
        precision, at = prior_of(trial, priors)
        precision, step = precision[:3, :3], theta - at[:3]
        # A constant: where both are at their best the two differ by nothing.
        assert step @ precision @ step == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_poses_take_over_how_masses_follow():
    model = model_of(HEAVY)
    poses = measured_campaign(measure(arm(HEAVY), seed=3, tables=("poses",), poses=30), arm(HEAVY))
    rows = stage_rows([poses], layout_of([poses]), "poses")
    ((prior,), _) = carried_over(rows, {"free_air": model.stages["free_air"]})
    assert prior.follows == springs(6)
    stage = model.stages["free_air"]
    assert stage.by_springs is not None
    np.testing.assert_array_equal(prior.slope, stage.by_springs[[stage.slots.index(s) for s in prior.slots]])
