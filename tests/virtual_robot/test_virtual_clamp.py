"""A clamped arm: the equilibrium, the gap, the block that yields."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.clamp import block_compliance, clamped_torques, press
from experiments.virtual_robot.drive import arm_at_rest, compliance_matrix, nonlinear_yield


@pytest.fixture
def pressed(plant):
    C, gap = compliance_matrix(plant.drive), plant.drive.gap
    torque = np.random.default_rng(0).standard_normal((200, 6)) * plant.drive.rated * 0.3
    angle = torque @ C + 0.5 * gap * np.sign(torque)
    return C, gap, angle, torque


def test_pressing_finds_the_torques_that_made_the_angles(pressed):
    C, gap, angle, torque = pressed
    np.testing.assert_allclose(press(C, gap, angle), torque, atol=1e-4)


def test_inside_its_gap_a_joint_carries_nothing(plant):
    C, gap = compliance_matrix(plant.drive), plant.drive.gap
    angle = 0.4 * np.random.default_rng(1).uniform(-1, 1, (50, 6)) * gap
    assert not press(C, gap, angle).any()


def test_pressing_takes_the_least_energy(pressed):
    C, gap, angle, _ = pressed
    angle = angle * 0.05  # some joints inside their gaps
    tau = press(C, gap, angle)

    def energy(t):
        return 0.5 * np.einsum("ni,ij,nj->n", t, C, t) + 0.5 * np.abs(t) @ gap - np.sum(angle * t, axis=1)

    other = tau + np.random.default_rng(2).standard_normal(tau.shape) * 5
    assert np.all(energy(tau) <= energy(other))


def test_a_yielding_block_takes_its_share(plant, bodies, q):
    soft = replace(plant, fixture=replace(plant.fixture, compliance=np.array([3e-7] * 3 + [5e-6] * 3)))
    arm, load = arm_at_rest(soft, bodies, q[:1], np.ones((1, 6)))
    output = arm + load @ compliance_matrix(soft.drive) + 1e-3 * np.linspace(-1, 1, 41)[:, None]
    tau, moved = clamped_torques(soft, bodies, output, arm[0], load[0])
    J = bodies.jacobian(arm[0])
    wrench = np.linalg.solve(J.T, (tau - load).T).T
    np.testing.assert_allclose(moved, wrench * soft.fixture.compliance, atol=1e-12)
    # Virtual work: the joints turn with the block, q = J⁻¹·x.
    turned = np.linalg.solve(J, moved.T).T
    free = np.abs(tau) > 1e-9
    left = output - arm - turned - tau @ compliance_matrix(soft.drive) - 0.5 * soft.drive.gap * np.sign(tau)
    np.testing.assert_allclose(left[free], 0.0, atol=1e-10)
    block, _ = block_compliance(soft, J)
    assert np.linalg.eigvalsh(block).min() > 0


def test_hardening_springs_settle(plant, bodies, q):
    own = np.diag(compliance_matrix(plant.drive))
    hard = replace(plant, drive=replace(plant.drive, hardening=0.25 * own / (3 * (0.45 * plant.drive.rated) ** 2)))
    arm, load = arm_at_rest(hard, bodies, q[:1], np.ones((1, 6)))
    output = arm + 0.4 * np.linspace(-1, 1, 41)[:, None] * hard.drive.rated * own
    tau, _ = clamped_torques(hard, Bodies(hard.geometry, hard.masses), output, arm[0], load[0])
    left = output - arm - tau @ compliance_matrix(hard.drive) - nonlinear_yield(hard.drive, tau)
    left -= 0.5 * hard.drive.gap * np.sign(tau)
    np.testing.assert_allclose(left[np.abs(tau) > 1e-9], 0.0, atol=1e-8)


def test_torques_stay_within_half_of_the_rated_ones(clean, plant):
    table = clean.tables["clamped"]
    for i in range(6):
        half = 0.5 * plant.drive.rated[i] * abs(plant.drive.nominal[i, i])
        friction = plant.friction.coulomb[i] + 5 * plant.instrument.torque_sigma[i]
        rows = table["joint"] == i + 1
        tau = table.loc[rows, f"tau{i + 1}_Nm"]
        assert 0.3 * half < tau.abs().max() < 1.25 * half + friction
