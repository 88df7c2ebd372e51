"""Pose predictions and the loads that feed them, against independent ways to the same numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clampid.catalogue import catalogue
from clampid.chain.chain import Deviations
from clampid.effect import Stage
from clampid.slots import Slot
from clampid.stages import poses
from clampid.stages.fit_problem import fit_problem
from clampid.stages.loads import bearing_signals, gravity_signals, inertia_torque
from clampid.stages.pose_kernel import kernel
from clampid.stages.pose_rows import align
from clampid.stages.rows import Rows
from experiments.campaign import Campaign, Instrument, Tool
from kinematics.description import RobotDescription, load_robot
from kinematics.gravity import gravity_parameters
from kinematics.masses import usual_links
from kinematics.poe import forward, joint_transforms
from kinematics.screws import exp_so3, log_so3

GRAVITY = np.array([0.4, -1.1, -9.6])
WEIGHED = ["kuka_kr20_r1810", "ur10", "linkage"]


def campaign_of(
    robot: RobotDescription,
    tables: Mapping[str, pd.DataFrame] | None = None,
    targets: Mapping[str, Any] | None = None,
    tool: Tool | None = None,
) -> Campaign:
    """A campaign that never was a folder."""
    return Campaign(
        name="made",
        path=None,
        robot=robot,
        gravity=GRAVITY,
        tool=tool or Tool(7.0, np.array([0.02, -0.05, 0.11])),
        targets={name: np.asarray(at, dtype=float) for name, at in (targets or {}).items()},
        instrument=Instrument(name="made", position_std=5e-5, orientation_std=None),
        tables=tables or {},
        fingerprint="0" * 64,
    )


def weighed(name: str) -> RobotDescription:
    """A robot with masses; ``linkage``: one whose controller counts joint 3 as a parallel linkage does."""
    if name == "linkage":
        return replace(load_robot("kuka_kr20_r1810"), linkage=load_robot("abb_irb2400_12_155").linkage)
    return load_robot(name)


def postures(robot: RobotDescription, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-2.0, 2.0, (count, robot.n))


@pytest.fixture
def rows(few_rows: dict[Stage, Rows]) -> Rows:
    return few_rows["poses"]


def _deviations(rows: Rows, values: np.ndarray) -> Deviations:
    nothing = np.zeros(0, dtype=np.int64)
    return Deviations(values, np.zeros((len(rows), 0)), nothing, nothing, None)


def _width(rows: Rows) -> int:
    chain = fit_problem(rows, catalogue(), (Slot("geometry", "x", "link1"),)).chain
    return max(s.stop for s in chain.offsets.values())


def test_without_deviations_it_is_the_nominal_robot(rows: Rows):
    width = _width(rows)
    position, rotation, _ = poses.predict(rows, _deviations(rows, np.zeros((len(rows), width))))
    X = rows.pose.base_reference @ forward(rows.robot.screws, rows.robot.flange, rows.signals["q"])
    target = np.c_[rows.pose.target, np.ones(len(rows))]
    np.testing.assert_allclose(position, np.einsum("nij,nj->ni", X, target)[:, :3], atol=1e-12)
    np.testing.assert_allclose(rotation, X[:, :3, :3], atol=1e-12)


@pytest.mark.parametrize("size", [0.0, 1e-3, 0.2])
def test_sensitivities_are_differences(rows: Rows, size: float):
    width = _width(rows)
    rng = np.random.default_rng(7)
    values = size * rng.standard_normal((len(rows), width))
    *_, sensitivity = poses.predict(rows, _deviations(rows, values))
    step = 1e-5
    for k in range(width):
        shift = step * np.eye(width)[k]
        p1, R1, _ = poses.predict(rows, _deviations(rows, values + shift))
        p0, R0, _ = poses.predict(rows, _deviations(rows, values - shift))
        np.testing.assert_allclose((p1 - p0) / (2 * step), sensitivity[:, :3, k], atol=1e-8)
        turned = log_so3(R1 @ np.swapaxes(R0, 1, 2)) / (2 * step)
        np.testing.assert_allclose(turned, sensitivity[:, 3:, k], atol=1e-8)


def test_what_a_drive_is_off_by_passes_through_the_linkage():
    robot, rng = weighed("linkage"), np.random.default_rng(5)
    q, off = rng.uniform(-1.5, 1.5, (8, 6)), rng.uniform(-0.2, 0.2, (8, 6))
    frame, target = np.tile(np.r_[np.eye(3).ravel(), 0.1, 0.2, 0.3], (8, 1)), rng.uniform(-0.1, 0.1, (8, 3))

    def predicted(q: np.ndarray, joints: np.ndarray) -> list[np.ndarray]:
        rest = np.zeros((8, 6 + 6 * 6 + 6))
        return kernel(robot)(np.zeros(0), q, frame[:, :9], frame[:, 9:], target, np.hstack([joints, rest]))

    for there, commanded in zip(predicted(q, off), predicted(q + off, np.zeros((8, 6))), strict=True):
        np.testing.assert_allclose(there, commanded, atol=1e-12)
    step = 1e-6
    slope = predicted(q, off)[2].reshape(8, 6, -1)[:, :3, :6]
    for j in range(6):
        more = step * np.eye(6)[j]
        moved = (predicted(q, off + more)[0] - predicted(q, off - more)[0]) / (2 * step)
        np.testing.assert_allclose(moved, slope[:, :, j], atol=1e-8)


vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)


@settings(derandomize=True, deadline=None, max_examples=30)
@given(turn=vectors, shift=vectors)
def test_align_finds_any_frame(turn: np.ndarray, shift: np.ndarray):
    points = np.random.default_rng(3).standard_normal((25, 3))
    R = exp_so3(turn)
    found = align(points, points @ R.T + shift)
    np.testing.assert_allclose(found[:3, :3], R, atol=1e-12)
    np.testing.assert_allclose(found[:3, 3], shift, atol=1e-12)


def test_align_is_not_turned_by_wrong_rows():
    rng = np.random.default_rng(4)
    points = rng.standard_normal((200, 3))
    R, shift = exp_so3(np.array([0.3, -1.0, 0.5])), np.array([1.0, -2.0, 0.5])
    measured = points @ R.T + shift + 1e-4 * rng.standard_normal((200, 3))
    measured[:6] += 0.3
    found = align(points, measured)
    np.testing.assert_allclose(found[:3, :3], R, atol=1e-4)
    np.testing.assert_allclose(found[:3, 3], shift, atol=1e-4)


def _bodies(campaign: Campaign) -> list[tuple[int, float, np.ndarray]]:
    """Every weight: the link that it moves with, its mass, its centre in the base frame at the zero pose."""
    robot = campaign.robot
    bodies = [(k, link.mass, np.asarray(link.com)) for k, link in enumerate(robot.links)]
    at = robot.flange[:3, :3] @ campaign.tool.com + robot.flange[:3, 3]
    return [*bodies, (robot.n - 1, campaign.tool.mass, at)]


@pytest.mark.parametrize("name", WEIGHED)
def test_loads_are_sums_over_the_weights(name: str):
    robot = weighed(name)
    campaign, q = campaign_of(robot), postures(robot, 15)
    signals = bearing_signals(campaign, q)
    G = joint_transforms(robot.screws, q @ np.asarray(robot.linkage).T)
    points = np.array([*(j.point for j in robot.joints), robot.flange[:3, 3]])
    for row in range(len(q)):
        held = [(k, m * GRAVITY, G[row, k + 1, :3, :3] @ c + G[row, k + 1, :3, 3]) for k, m, c in _bodies(campaign)]
        base = sum(np.cross(at, weight) for _, weight, at in held)
        np.testing.assert_allclose(signals["base_moment"][row], base, atol=1e-9)
        for i in range(robot.n + 1):
            R = G[row, i, :3, :3]
            pivot = R @ points[i] + G[row, i, :3, 3]
            # Beyond the flange hangs the tool only.
            beyond = [(w, at) for k, w, at in held if k >= i] if i < robot.n else [held[-1][1:]]
            moment = R.T @ sum(np.cross(at - pivot, w) for w, at in beyond)
            force = R.T @ sum(w for w, _ in beyond)
            if i > 0:
                np.testing.assert_allclose(signals["link_moment"][row, i - 1], moment, atol=1e-9)
                np.testing.assert_allclose(signals["link_force"][row, i - 1], force, atol=1e-9)
            if i < robot.n:
                axis = robot.joints[i].axis
                behind = G[row, i + 1, :3, :3].T @ R @ moment
                across = behind - axis * (axis @ behind)
                np.testing.assert_allclose(signals["transverse_moment"][row, i], across, atol=1e-9)


@pytest.mark.parametrize("name", WEIGHED)
def test_regressors_times_masses_are_the_signals(name: str):
    robot = weighed(name)
    campaign, q = campaign_of(robot), postures(robot, 15)
    signals = {**bearing_signals(campaign, q), **gravity_signals(campaign, q)}
    links = np.asarray(gravity_parameters(robot.links), dtype=float)
    at = robot.flange[:3, :3] @ campaign.tool.com + robot.flange[:3, 3]
    masses = links.copy()
    masses[-4:] += campaign.tool.mass * np.r_[1.0, at]
    torque = signals["regressor"] @ masses
    np.testing.assert_allclose(torque, signals["gravity_torque"], atol=1e-9)
    tool = signals["tool_regressor"] @ (campaign.tool.mass * np.r_[1.0, campaign.tool.com])
    np.testing.assert_allclose(signals["regressor"] @ links + tool, signals["gravity_torque"], atol=1e-9)
    for name_, shape in (("base_moment", (3,)), ("transverse_moment", (robot.n, 3))):
        product = (signals[f"{name_}_regressor"] @ masses).reshape(len(q), *shape)
        np.testing.assert_allclose(product, signals[name_], atol=1e-9)
    for name_ in ("link_moment", "link_force"):  # the last link's far end is the flange: no link hangs on it
        product = (signals[f"{name_}_regressor"] @ masses).reshape(len(q), robot.n, 3)
        np.testing.assert_allclose(product[:, :-1], signals[name_][:, :-1], atol=1e-9)
        np.testing.assert_array_equal(product[:, -1], 0.0)


def _pin_model(campaign: Campaign) -> Any:
    model, robot = pin.Model(), campaign.robot
    model.gravity.linear = campaign.gravity
    parent, last = 0, np.zeros(3)
    kinds = {"revolute": pin.JointModelRevoluteUnaligned, "prismatic": pin.JointModelPrismaticUnaligned}
    for k, joint in enumerate(robot.joints):
        at = pin.SE3(np.eye(3), np.asarray(joint.point) - last)
        parent = model.addJoint(parent, kinds[joint.kind](np.array(joint.axis)), at, joint.name)
        inertia = robot.links[k].inertia
        for body, mass, com in _bodies(campaign):
            if body == k:
                own = np.zeros((3, 3)) if inertia is None else np.array(inertia)
                model.appendBodyToJoint(parent, pin.Inertia(mass, com - joint.point, own), pin.SE3.Identity())
                inertia = None  # the tool is a point
        last = np.asarray(joint.point)
    return model


@pytest.mark.parametrize("name", WEIGHED)
def test_torques_of_motion_are_those_of_pinocchio(name: str):
    robot = weighed(name)
    campaign, rng = campaign_of(robot), np.random.default_rng(2)
    q, speed, acceleration = (rng.uniform(-2.0, 2.0, (20, robot.n)) for _ in range(3))
    model = _pin_model(campaign)
    data, linkage = model.createData(), np.asarray(robot.linkage)
    expected = [
        linkage.T @ pin.rnea(model, data, linkage @ a, linkage @ b, linkage @ c)
        for a, b, c in zip(q, speed, acceleration, strict=True)
    ]
    torque = inertia_torque(campaign, q, speed, acceleration) + gravity_signals(campaign, q)["gravity_torque"]
    np.testing.assert_allclose(torque, expected, atol=1e-9)


def test_own_inertia_of_links_counts():
    robot = weighed("kuka_kr20_r1810")
    rng = np.random.default_rng(6)
    spread = [np.diag(rng.uniform(0.1, 2.0, 3)) for _ in robot.links]
    robot = replace(robot, links=tuple(replace(k, inertia=s) for k, s in zip(robot.links, spread, strict=True)))
    campaign = campaign_of(robot)
    q, speed, acceleration = (rng.uniform(-2.0, 2.0, (10, robot.n)) for _ in range(3))
    model = _pin_model(campaign)
    data = model.createData()
    expected = [pin.rnea(model, data, a, b, c) for a, b, c in zip(q, speed, acceleration, strict=True)]
    torque = inertia_torque(campaign, q, speed, acceleration) + gravity_signals(campaign, q)["gravity_torque"]
    np.testing.assert_allclose(torque, expected, atol=1e-9)


def test_no_motion_needs_no_torque_beyond_gravity():
    robot = weighed("ur10")
    q = postures(robot, 5)
    np.testing.assert_allclose(inertia_torque(campaign_of(robot), q, 0 * q, 0 * q), 0.0, atol=1e-12)


def test_links_of_unknown_mass_have_the_inertia_of_the_weight_that_they_are_given():
    robot = load_robot("abb_irb1200_5_09")
    assert not robot.has_masses
    described = campaign_of(replace(robot, links=usual_links(robot)))
    rng = np.random.default_rng(7)
    q, speed, acceleration = (rng.uniform(-2.0, 2.0, (10, robot.n)) for _ in range(3))
    torques = [
        inertia_torque(c, q, speed, acceleration) + gravity_signals(c, q)["gravity_torque"]
        for c in (campaign_of(robot), described)
    ]
    np.testing.assert_allclose(*torques, atol=1e-9)
    assert np.abs(inertia_torque(campaign_of(robot), q, speed, acceleration)).max() > 1.0
