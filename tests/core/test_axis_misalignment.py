"""Axes that are tilted against their description: what weight does about them, and what a log tells of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.effects.axis_misalignment import EFFECT
from clampid.identification.fitted_stage import fit_stage
from clampid.identification.identify import identify, stage_rows, standard_effects
from clampid.slots import Slot, Term
from clampid.stages.layout import layout_of
from clampid.stages.loads import axis_torque, declared_weight, with_tilts
from experiments.campaign import Campaign, read_campaign
from experiments.second_world import draw_robot, measure
from kinematics.gravity import torque_by_gravity

STEP = 1e-5  # rad


@pytest.mark.parametrize("robot", ["kuka_kr20_r1810", "ur10", "abb_irb2400_12_155"])
def test_torques_follow_a_tilt_as_those_of_an_arm_with_a_joint_more(
    robot: str, simulated: Callable[..., Campaign]
) -> None:
    """A joint across the axis, before it, turned by a little: central difference of all torques."""
    campaign = simulated(robot=robot, seed=1, poses=20, tables=("poses",))
    n, linkage = campaign.robot.n, np.asarray(campaign.robot.linkage)
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (7, n))
    found, screws, weight = axis_torque(campaign, q), with_tilts(campaign.robot), np.zeros((3 * n, 4))
    weight[2::3] = declared_weight(campaign).reshape(n, 4)

    def torque(tilt: int, angle: float) -> np.ndarray:
        angles = np.zeros((len(q), 3 * n))
        angles[:, 2::3] = q @ linkage.T
        angles[:, 3 * (tilt // 2) + tilt % 2] = angle
        return np.asarray(torque_by_gravity(screws, angles, weight.ravel())[:, 2::3] @ campaign.gravity) @ linkage

    assert not found[:, :, :2].any()  # of joint 1: an inclination of the base
    for tilt in range(2, 2 * n):
        change = (torque(tilt, STEP) - torque(tilt, -STEP)) / (2.0 * STEP)
        np.testing.assert_allclose(found[:, :, tilt], change, atol=1e-5 * max(np.abs(change).max(), 1.0))


def test_tilts_are_across_their_axes(simulated: Callable[..., Campaign]) -> None:
    robot = simulated(seed=1, poses=20, tables=("poses",)).robot
    three = with_tilts(robot).reshape(robot.n, 3, 6)[:, :, :3]
    np.testing.assert_allclose(three @ np.swapaxes(three, 1, 2), np.tile(np.eye(3), (robot.n, 1, 1)), atol=1e-12)


def test_a_log_read_by_windows_has_the_same_axes(simulated: Callable[..., Campaign]) -> None:
    """There the derivative is an expression, compiled; here it is an array."""
    campaign = simulated(seed=4, tables=("free_air", "wrist"))
    terms = [*standard_effects([campaign])["free_air"], Term(EFFECT.name)]
    rows = stage_rows([campaign], layout_of([campaign]), "free_air", active=[catalogue()["inertia"]])
    whole = fit_stage(rows, catalogue(), terms, {}).model
    windows = identify(campaign, {"free_air": [t.label for t in terms]}).stages["free_air"]
    mine = [k for k, s in enumerate(windows.slots) if s.effect == EFFECT.name]
    found = np.array([whole.values()[windows.slots[k]] for k in mine])
    np.testing.assert_allclose(windows.theta[mine], found, atol=0.1 * windows.std[mine].max())


@pytest.mark.slow
@pytest.mark.parametrize("joint", [2, 3])
def test_a_log_identifies_a_tilted_axis(joint: int, tmp_path: Path) -> None:
    """An arm as described but for one axis, 4 mrad off, of another simulator; to a fifth, for its weight differs."""
    robot = draw_robot("uncoupled6", 7)
    built, off = list(robot.nominal.joints), np.array([4e-3, 0.0, -4e-3])
    built[joint - 1] = replace(built[joint - 1], rpy_rad=tuple(np.asarray(built[joint - 1].rpy_rad) + off))
    arms = {"tilted": replace(robot.nominal, joints=tuple(built)), "straight": robot.nominal}
    theta: dict[str, dict[Slot, tuple[float, float]]] = {}
    session = {"log": "fourier_100hz", "noise": "white", "seed": 7}
    for name, arm in arms.items():
        measure(replace(robot, arm=arm), tmp_path / name, tables=("free_air",), **session)
        campaign = read_campaign(tmp_path / name)
        names = [*(t.label for t in standard_effects([campaign])["free_air"]), f"{EFFECT.name}@joint{joint}"]
        stage = identify(campaign, {"free_air": names}).stages["free_air"]
        theta[name] = {s: (v, e) for s, v, e in zip(stage.slots, stage.theta, stage.std, strict=True)
                       if s.effect == EFFECT.name}  # fmt: skip
    tilts = with_tilts(campaign.robot).reshape(robot.n, 3, 6)[joint - 1, :2, :3]
    assert min(error for _, error in theta["tilted"].values()) < 0.1 * np.abs(off).max()
    for parameter, true in zip(("alpha", "beta"), tilts @ off, strict=True):
        slot = Slot(EFFECT.name, parameter, f"joint{joint}")
        (value, error), (none, _) = theta["tilted"][slot], theta["straight"][slot]
        assert abs(none) < 4.0 * error
        assert value == pytest.approx(true, abs=4.0 * error + 0.2 * abs(true))
