"""How far a block slipped, and how well that is known where friction hides which clearances it passed."""

from __future__ import annotations

from dataclasses import replace

import clamped_hidden
import numpy as np
import pytest
from scipy import stats

from clampid.fitting.kept_friction import AXES, with_kept_friction
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from experiments.simulate import measured_campaign
from experiments.virtual_robot import Hidden, measure
from kinematics.description import load_robot

SEEDS = range(1, 5)


@pytest.mark.slow
def test_without_a_slip_nothing_is_added():
    robot = load_robot("kuka_kr20_r1810")
    campaign = measured_campaign(measure(robot, seed=3, tables=("clamped",)), robot)
    estimate = on_campaign(identify(campaign, {"clamped": clamped_hidden.STANDARD}), campaign).refit("clamped").estimate
    np.testing.assert_array_equal(with_kept_friction(estimate).covariance, estimate.covariance)


@pytest.mark.study
def test_slips_are_known_as_well_as_is_said():
    off = []
    for seed in SEEDS:
        robot = load_robot("kuka_kr20_r1810")
        measured = measure(robot, [Hidden.parse("fixture_shift")], seed=seed, tables=("clamped",))
        campaign = clamped_hidden.campaign_of(measured, watched=False)
        model = identify(campaign, {"clamped": (*clamped_hidden.STANDARD, "fixture_shift")})
        stage, true = model.stages["clamped"], measured.hidden[0]["parameters"]
        index = {s.parameter: k for k, s in enumerate(stage.slots) if s.effect == "fixture_shift"}
        own = [index[axis] for axis in AXES]
        truth = np.array([true[f"{axis}_rad" if axis.startswith("r") else f"{axis}_m"] for axis in AXES])
        off.append((stage.theta[own] - truth) / stage.std[own])
    # So large a sum of squares comes once in a thousand where the errors are as stated.
    assert np.sum(np.square(off)) < stats.chi2.isf(1e-3, np.size(off))


@pytest.mark.slow
def test_only_clearances_leave_a_slip_open():
    robot = load_robot("kuka_kr20_r1810")
    measured = measure(robot, [Hidden.parse("fixture_shift")], seed=1, tables=("clamped",))
    campaign = clamped_hidden.campaign_of(measured, watched=False)
    model = identify(campaign, {"clamped": (*clamped_hidden.STANDARD, "fixture_shift")})
    estimate = on_campaign(model, campaign).refit("clamped").estimate
    gaps = [k for k, s in enumerate(estimate.slots) if s.effect == "backlash"]
    own = [k for k, s in enumerate(estimate.slots) if s.effect == "fixture_shift" and s.parameter in AXES]
    wide = with_kept_friction(estimate).covariance - estimate.covariance
    assert np.trace(wide[np.ix_(own, own)]) > 0.0
    assert np.linalg.eigvalsh(wide).min() > -1e-15
    theta = estimate.theta.copy()
    theta[gaps] = 0.0
    tight = replace(estimate, theta=theta)
    np.testing.assert_allclose(with_kept_friction(tight).covariance, estimate.covariance, atol=1e-18)
