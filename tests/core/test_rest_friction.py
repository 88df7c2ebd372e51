"""Dry friction that only the flanks of poses tell: found past their flips, with the error that they leave."""

from __future__ import annotations

from functools import cache

import numpy as np
import pose_coverage
import pytest
from virtual_arms import ARMS, arm

import clampid.fitting.rest_friction
from clampid.evidence.space import space_of
from clampid.fitting.friction_profile import FrictionProfile
from clampid.fitting.rest_friction import _cost
from clampid.fitting.solve import solve
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.models.model import Model
from clampid.slots import Slot
from experiments.campaign import Campaign
from experiments.simulate import measured_campaign
from experiments.virtual_robot import measure

UNCOUPLED = "abb_irb4600_40_255"  # its description has no gears: logs do not tell the wrist's friction


@cache
def robot_and_model() -> tuple[Campaign, Model]:
    measured = measure(
        arm(UNCOUPLED),
        seed=pose_coverage.BETWEEN_ARMS * ARMS.index(UNCOUPLED) + 2,
        tables=("free_air", "wrist", "poses"),
    )
    campaign = measured_campaign(measured, arm(UNCOUPLED))
    return campaign, identify(campaign)


@pytest.mark.slow
def test_frictions_and_clearances_of_an_uncoupled_wrist():
    """Of this robot a search that moved its flanks ended with clearances ten standard errors off, friction at 42 Nm."""
    errors = pose_coverage.trial(UNCOUPLED, 2).errors
    wrist = [f"{name}@joint{j}" for name in ("backlash.gap", "joint_compliance.c") for j in (4, 5)]
    assert "wrist_coupling_friction.F@joint5" in errors
    assert max(abs(errors[name]) for name in wrist) < 3.5
    assert abs(errors["wrist_coupling_friction.F@joint5"]) < 3.5


@pytest.mark.slow
def test_a_fit_again_holds_the_frictions_where_they_were(monkeypatch: pytest.MonkeyPatch):
    campaign, model = robot_and_model()
    monkeypatch.setattr(clampid.fitting.rest_friction, "_solved", None)  # nothing is sought
    stage = model.stages["poses"]
    found = on_campaign(model, campaign).refit("poses").model
    k = stage.slots.index(Slot("wrist_coupling_friction", "F", "joint5"))
    assert found.theta[k] == pytest.approx(stage.theta[k], abs=1e-6)
    np.testing.assert_allclose(found.theta, stage.theta, atol=0.1 * stage.std.max(), rtol=0.1)


def test_friction_profile_equals_fits_with_the_friction_fixed():
    """To first order: linear in all but the product of friction and compliance, so near the fit."""
    campaign, model = robot_and_model()
    estimate = on_campaign(model, campaign).refit("poses").estimate
    k = estimate.slots.index(Slot("wrist_coupling_friction", "F", "joint5"))
    profile = FrictionProfile.of(estimate, k)
    best = int(np.argmin(profile.cost))
    assert abs(profile.value[best] - estimate.theta[k]) < 0.5
    off = (profile.theta[best] - estimate.theta) / estimate.std
    assert np.abs(off).max() < 0.5
    assert profile.weight.sum() == pytest.approx(1.0)
    # What is said to be lost elsewhere is what a fit with the friction held there loses.
    near = np.flatnonzero(np.abs(profile.value - profile.value[best]) < 2.0)
    at = int(near[np.argmax(profile.cost[near])])
    theta, mean = estimate.theta.copy(), estimate.prior_mean.copy()
    theta[k] = mean[k] = profile.value[at]
    found = solve(estimate.problem, theta, estimate.noise, estimate.prior_precision, mean)
    lost = _cost(found) - _cost(estimate)
    assert lost > 20.0
    assert profile.cost[at] - profile.cost[best] == pytest.approx(lost, rel=0.1, abs=3.0)


@pytest.mark.slow
def test_prior_width_of_a_fixed_friction_is_not_counted_as_evidence(simulated):
    """Its column is the fit's own to the score test, although the search held it."""
    campaign = simulated(seed=2, poses=150, tables=("free_air", "wrist", "poses"))
    estimate = on_campaign(identify([campaign]), campaign).refit("poses").estimate
    held = [
        k
        for k, slot in enumerate(estimate.slots)
        if slot.effect == "wrist_coupling_friction" and estimate.std[k] ** 2 * estimate.prior_precision[k, k] > 4.0
    ]
    space, open_ = space_of(estimate), 0
    for k in held:
        column = np.zeros(len(space.residual))
        column[: space.rows] = estimate.whitened.jacobian[:, k]
        left, size = column - space.basis @ (space.basis.T @ column), float(np.linalg.norm(column))
        assert np.linalg.norm(left) < 0.99 * size
        if size * estimate.std[k] > 10.0:  # standard deviations that it may explain
            open_ += 1
            assert np.linalg.norm(left) < 0.2 * size
    assert open_
