"""The identified arm: one forward model, and solutions on it, singular or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ik_arms import MOUNT, conditions, drawn_arm, postures
from ik_general import general

from clampid.catalogue import catalogue
from clampid.stages.fit_problem import parameter_of
from kinematics.description import load_robot
from kinematics.poe import forward
from kinematics.screws import log_so3
from offline_ik.arm.identified import Conditions, nominal_arm
from offline_ik.inverse.solver import Solver

POSES = sorted(name for name, effect in catalogue().items() if "poses" in effect.stages)


@pytest.mark.slow
@pytest.mark.parametrize("name", POSES)
def test_the_kernel_is_clampids_own_prediction(name: str) -> None:
    effects = tuple(dict.fromkeys(("geometry", "gravity", "joint_compliance", name)))
    arm = drawn_arm(effects=effects)
    given_, q = conditions(), postures(arm, 20)
    solver = Solver(arm, MOUNT)
    mine = arm.base @ solver.pose(q, given_)
    position, rotation, _ = general(arm, q, given_, MOUNT[:3, 3])
    assert np.abs(mine[:, :3, 3] - position).max() < 1e-12
    assert np.abs(mine[:, :3, :3] - rotation @ MOUNT[:3, :3]).max() < 1e-12


def test_the_kernel_is_clampids_own_prediction_with_a_linkage() -> None:
    arm = drawn_arm("abb_irb2400_12_155", ("geometry", "backlash"))
    given_, q = conditions(), postures(arm, 20)
    mine = arm.base @ Solver(arm, MOUNT).pose(q, given_)
    position, _, _ = general(arm, q, given_, MOUNT[:3, 3])
    assert np.abs(mine[:, :3, 3] - position).max() < 1e-12


@pytest.mark.slow
def test_the_sensitivity_is_clampids_own() -> None:
    """That of its prediction: a fit's own derivative holds the loads while the parameters move."""
    arm, given_ = drawn_arm(), conditions()
    solver, q = Solver(arm, MOUNT), postures(arm, 1)[0]
    R, mine, _ = solver.sensitivity.one(np.r_[q, given_.vector])
    mine = np.kron(np.eye(2), arm.base[:3, :3]) @ mine.reshape(6, -1)
    _, rotation, held = general(arm, q[None], given_, MOUNT[:3, 3])
    assert np.abs(arm.base[:3, :3] @ R.reshape(3, 3) - rotation[0] @ MOUNT[:3, :3]).max() < 1e-12
    assert np.abs(mine - held[0]).max() < 1e-3 * np.abs(held).max()
    for k, slot in enumerate(arm.slots):
        step = 1e-3 * parameter_of(slot, arm.effects, arm.robot).size * np.eye(len(arm.theta))[k]
        up, down = (general(arm.with_theta(arm.theta + s * step), q[None], given_, MOUNT[:3, 3]) for s in (1.0, -1.0))
        turned = log_so3(up[1] @ np.swapaxes(down[1], 1, 2))[0]
        slope = np.r_[up[0][0] - down[0][0], turned] / (2.0 * step[k])
        np.testing.assert_allclose(mine[:, k], slope, rtol=1e-6, atol=1e-6 * np.abs(mine).max(axis=1).max())


def test_a_block_of_rows_is_its_rows_also_where_no_weight_presses(solver: Solver) -> None:
    """No weight acts on an upright joint 1: which flank it stands on must not be for rounding to say."""
    q, still = postures(solver.arm, 100), Conditions.still(6)
    apart = np.vstack([solver.pose(one, still) for one in q])
    assert np.abs(solver.pose(q, still) - apart).max() < 1e-12
    assert (solver.forward.many(q, np.tile(still.vector, (len(q), 1)))[3][:, 0] == 0).all()


def test_without_effects_the_arm_is_the_nominal_one() -> None:
    robot = load_robot("kuka_kr20_r1810")
    arm = nominal_arm(robot)
    q = postures(arm, 20)
    assert np.abs(Solver(arm, np.eye(4)).pose(q, conditions()) - forward(robot.screws, robot.flange, q)).max() < 1e-13


@pytest.fixture(scope="module")
def solver() -> Solver:
    return Solver(drawn_arm(), MOUNT)


def check(solver: Solver, q: np.ndarray, seed: int = 0) -> None:
    given_ = conditions(seed=seed)
    T = solver.pose(q, given_)
    found = solver.solve(T, np.zeros_like(q), solver.signs(q), given_)
    assert found.reached.all(), f"{(~found.reached).sum()} of {len(q)} not reached"
    assert np.abs(solver.pose(found.q, given_) - T).max() < 1e-9


@pytest.mark.slow
def test_every_reachable_pose_is_reached(solver: Solver) -> None:
    check(solver, postures(solver.arm, 10_000))


def test_with_the_wrist_singular(solver: Solver) -> None:
    q, rng = postures(solver.arm, 300, seed=1), np.random.default_rng(1)
    q[:, 4] = rng.normal(size=len(q)) * 10 ** rng.uniform(-9, -2, len(q))
    check(solver, q)


def test_with_the_arm_stretched(solver: Solver) -> None:
    q, rng = postures(solver.arm, 300, seed=2), np.random.default_rng(2)
    assert solver.ortho is not None
    q[:, 2] = solver.ortho.stretched + rng.normal(size=len(q)) * 10 ** rng.uniform(-9, -2, len(q))
    check(solver, q)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6), st.integers(0, 5))
def test_any_posture_is_found_again(values: list[float], seed: int) -> None:
    solver = shared()
    middle = 0.5 * (solver.arm.robot.lower + solver.arm.robot.upper)
    check(solver, (middle + np.array(values) * np.minimum(solver.arm.robot.upper - middle, np.pi))[None], seed)


_shared: list[Solver] = []


def shared() -> Solver:
    """One solver for all examples: compiling takes longer than solving."""
    if not _shared:
        _shared.append(Solver(drawn_arm(), MOUNT))
    return _shared[0]


@pytest.mark.slow
def test_a_singular_posture_far_along_its_valley_is_found() -> None:
    """The wrist's centre on axis 1, where joint 1 is as good as free: a search ends at a fold half a turn away."""
    solver = Solver(drawn_arm(seed=4), MOUNT)
    q = np.array([[0.138714, 0.428528, 2.790031, 1.440885, -2.262073, 0.263078]])
    check(solver, q)


@pytest.mark.slow
def test_an_arm_without_a_spherical_wrist_is_solved_from_a_posture_nearby() -> None:
    arm = drawn_arm("ur10", ("geometry", "joint_compliance"))
    solver = Solver(arm, MOUNT)
    q, given_ = postures(arm, 20) / 2, conditions()
    T = solver.pose(q, given_)
    found = solver.solve(T, q + 0.05, solver.signs(q), given_)
    assert found.reached.all()
    assert np.abs(solver.pose(found.q, given_) - T).max() < 1e-9


def test_directions_and_temperatures_count() -> None:
    arm = drawn_arm()
    solver, q = Solver(arm, np.eye(4)), np.array([[0.3, -1.2, 1.0, 0.4, 0.8, 0.2]])
    here = conditions()
    there = replace(here, direction=-here.direction)
    warm = replace(here, link_temperature=here.link_temperature + 10)
    assert np.abs(solver.pose(q, there) - solver.pose(q, here)).max() > 1e-6
    assert np.abs(solver.pose(q, warm) - solver.pose(q, here)).max() > 1e-6
    cold = arm.without("thermal_expansion")
    assert np.array_equal(Solver(cold, np.eye(4)).pose(q, warm), Solver(cold, np.eye(4)).pose(q, here))


@pytest.mark.parametrize(
    "count",
    [
        pytest.param(10_000, marks=pytest.mark.slow),
        pytest.param(100_000, marks=pytest.mark.study),
        pytest.param(1_000_000, marks=pytest.mark.study),
    ],
)
def test_poses_without_number(count: int) -> None:
    solver = Solver(drawn_arm(seed=4), MOUNT)
    q = postures(solver.arm, count)
    given_ = conditions()
    T = solver.pose(q, given_)
    found = solver.solve(T, np.zeros_like(q), solver.signs(q), given_)
    assert found.reached.all()
    assert np.abs(solver.pose(found.q, given_) - T).max() < 1e-9
