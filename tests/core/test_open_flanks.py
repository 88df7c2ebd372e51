"""Robots that lean: which flank an upright joint stands on, told by poses where its clearance shows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import clampid.identification.fitted_stage
from clampid.catalogue import catalogue
from clampid.fitting.open_flanks import _fitted
from clampid.fitting.unknown_friction import unknown_frictions
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.models.model import Model, StageModel, load_model, save_model
from clampid.slots import Slot
from clampid.stages import poses
from clampid.stages.fit_problem import fit_problem
from clampid.stages.loads import gravity_signals, lean_torque
from experiments.campaign import Campaign
from experiments.simulate import measured_campaign
from experiments.virtual_robot import Plant, measure
from kinematics.description import load_robot
from offline_ik.arm.identified import Conditions, arm_of
from offline_ik.inverse.kernels import forward_kernel

EFFECTS = ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction")
GAP = 1.5e-4  # rad: three times the largest that is drawn, so that flanks show


def leaning(seed: int, lean: float) -> Campaign:
    """A robot whose axis 1 leans by ``lean``, rad, from upright."""

    def alter(plant: Plant) -> Plant:
        axes, gap = plant.geometry.axes.copy(), plant.drive.gap.copy()
        axes[0] = [np.sin(lean), 0.0, -np.cos(lean)]
        gap[0] = GAP
        return replace(plant, geometry=replace(plant.geometry, axes=axes), drive=replace(plant.drive, gap=gap))

    robot = load_robot("kuka_kr20_r1810")
    measured = measure(robot, seed=seed, poses=120, tables=("poses",), alter=alter)
    return measured_campaign(measured, robot)


def model_of(campaign: Campaign, monkeypatch: pytest.MonkeyPatch, *, open_flanks: bool) -> Model:
    with monkeypatch.context() as patch:
        if not open_flanks:
            patch.setattr(clampid.identification.fitted_stage, "with_open_flanks", lambda estimate: estimate)
        return identify(campaign, {"poses": EFFECTS})


def stage_of(campaign: Campaign, monkeypatch: pytest.MonkeyPatch, *, open_flanks: bool) -> StageModel:
    return model_of(campaign, monkeypatch, open_flanks=open_flanks).stages["poses"]


def gap_of(stage: StageModel) -> float:
    return stage.values()[Slot("backlash", "gap", "joint1")]


def test_a_lean_turns_gravity() -> None:
    robot = load_robot("kuka_kr20_r1810")
    campaign = measured_campaign(measure(robot, seed=0, poses=10, tables=("poses",)), robot)
    q, lean = np.random.default_rng(0).uniform(-1.5, 1.5, (20, 6)), np.array([3e-4, -2e-4, 1e-4])
    turned = replace(campaign, gravity=campaign.gravity + np.cross(lean, campaign.gravity))
    change = gravity_signals(turned, q)["gravity_torque"] - gravity_signals(campaign, q)["gravity_torque"]
    assert np.abs(change[:, 0]).max() > 0.1
    np.testing.assert_allclose(lean_torque(campaign, q) @ lean, change, atol=1e-9)


@pytest.mark.slow
def test_the_clearance_of_a_leaning_joint_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 1.5 mrad its weight decides wherever the arm is not folded; the direction alone tells half the clearance."""
    campaign = leaning(3, 1.5e-3)
    without, mean = (stage_of(campaign, monkeypatch, open_flanks=o) for o in (False, True))
    assert abs(gap_of(without) - GAP) > 0.3 * GAP
    assert abs(gap_of(mean) - GAP) < 0.1 * GAP


@pytest.mark.slow
def test_an_upright_joint_keeps_its_flanks(monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = leaning(3, 0.0)
    without, mean = (stage_of(campaign, monkeypatch, open_flanks=o) for o in (False, True))
    assert np.abs((mean.theta - without.theta) / without.std).max() < 0.1


@pytest.mark.slow
def test_a_leaning_robot_is_predicted_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """On poses of which none was fitted, the flanks that the lean says, and not the direction alone."""
    campaign = leaning(5, 1.2e-3)
    models = [model_of(campaign, monkeypatch, open_flanks=o) for o in (False, True)]
    without, mean = (m.ledger[-1].heldout_rms for m in models)
    assert mean < 0.9 * without


@pytest.mark.slow
def test_the_lean_is_kept_in_the_file_and_in_commands(tmp_path: Path) -> None:
    """The kernel of inverse kinematics presses on the same flanks as the fit does."""
    campaign = leaning(3, 1.5e-3)
    model = identify(campaign, {"poses": EFFECTS})
    stage = model.stages["poses"]
    assert stage.lean is not None
    save_model(model, tmp_path / "model.json")
    again = load_model(tmp_path / "model.json")
    np.testing.assert_array_equal(again.stages["poses"].lean, stage.lean)
    rows = on_campaign(again, campaign).rows("poses")
    chain = fit_problem(rows, catalogue(), stage.slots, stage.lean).chain
    theta = np.maximum(stage.theta, chain.least)
    found = poses.pressing(rows, chain, theta)
    assert found is not None
    arm = arm_of(again, gravity=campaign.gravity, tool_com=campaign.tool.com).with_theta(theta)
    forward = forward_kernel(arm, np.eye(4))
    for k in range(0, len(rows), 40):
        conditions = Conditions(rows.signals["direction"][k], np.zeros(6), np.zeros(6))
        pressing = forward.one(np.r_[rows.signals["q"][k], conditions.vector])[3]
        np.testing.assert_allclose(pressing, found[k], rtol=1e-6, atol=1e-6)
    level = fit_problem(rows, catalogue(), stage.slots).chain
    assert np.any(np.sign(found) != poses.flanks(rows, level, theta))


def test_fit_with_a_flank_pattern_equals_fit_with_frozen_flanks() -> None:
    """Sums over visits lead where the normal equations of all parameters lead, written down with the pattern held."""
    campaign = leaning(3, 0.0)
    estimate = on_campaign(identify(campaign, {"poses": EFFECTS}), campaign).refit("poses").estimate
    theta, white, rng = estimate.theta, estimate.whitened, np.random.default_rng(0)
    visit = np.unique(estimate.problem.rows.unit, return_inverse=True)[1]
    side = rng.choice([-1.0, 1.0], (3, visit.max() + 1, 1))
    gap = np.array([estimate.slots.index(Slot("backlash", "gap", "joint1"))])
    found, weight = _fitted(estimate, gap, visit, side, np.full(3, 1 / 3))
    assert weight.sum() == pytest.approx(1.0)
    free = np.setdiff1d(np.arange(len(theta)), unknown_frictions(estimate))
    size = estimate.std[free]
    for k in range(3):
        J = white.jacobian.copy()
        J[:, gap] *= side[k, visit[white.entry]]
        residual = white.residual + (white.jacobian - J)[:, gap] @ theta[gap]
        normal = (J.T @ J + estimate.prior_precision)[np.ix_(free, free)] * np.outer(size, size)
        slope = J.T @ residual - estimate.prior_precision @ (theta - estimate.prior_mean)
        np.testing.assert_allclose(
            (found[k] - theta)[free] / size, np.linalg.solve(normal, slope[free] * size), atol=1e-6
        )
