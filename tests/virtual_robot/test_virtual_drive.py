"""Gears, springs, gaps and dry friction."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.virtual_robot.drive import (
    arm_at_rest,
    compliance_matrix,
    flank,
    gear_output,
    motor_angles,
    nonlinear_yield,
    static_load,
    transmitted,
)
from experiments.virtual_robot.friction import Motion, motor_friction, motor_torque
from experiments.virtual_robot.play import dry_friction, slipping


def test_reported_angle_is_transposed_t_times_motors(plant, q):
    motor = motor_angles(plant.drive, q)
    np.testing.assert_allclose(motor @ plant.drive.nominal, q, atol=1e-12)
    np.testing.assert_allclose(plant.drive.nominal.T @ motor[0], q[0], atol=1e-12)


def test_motors_five_and_six_turn_when_joint_four_turns_alone(plant):
    motor = motor_angles(plant.drive, np.eye(6)[[3]])[0]
    assert motor[4] == pytest.approx(-(7 / 387) / (98 / 7095))
    assert motor[5] == pytest.approx(1.0)  # its shaft goes through joint 4's
    # And the joints 5 and 6 turn when motors 5 and 6 stand still: θ5 = −(7/387)·θ4.
    joints = np.array([0, 0, 0, 2940 / 37, 0, 0]) @ plant.drive.nominal
    assert joints[3] == pytest.approx(1.0)
    assert joints[4] == pytest.approx(-7 / 387)


def test_power_is_the_same_on_both_sides_of_the_gears(plant, q):
    rng = np.random.default_rng(0)
    tau, w = rng.standard_normal((2, 5, 6)) * 100
    frictionless = replace(
        plant.friction, coulomb=0 * plant.friction.coulomb, viscous=0 * plant.friction.viscous, arm=np.zeros(6)
    )
    ideal = replace(plant, friction=frictionless)
    motion = Motion(motor_angles(plant.drive, q[:5]), motor_angles(plant.drive, w), np.zeros((5, 6)))
    zero, warm = np.zeros((5, 6)), np.full((5, 6), 25.0)
    shaft = motor_torque(ideal, tau, motion, state=zero, gear_state=zero, temperature=warm, arm=True)
    np.testing.assert_allclose(np.sum(shaft * motion.speed, axis=1), np.sum(tau * w, axis=1))


def test_friction_and_compliance_only_take_power(plant):
    rng = np.random.default_rng(1)
    w = rng.standard_normal((50, 6)) * 100
    assert np.all(motor_friction(plant.friction, w, np.sign(w), np.full_like(w, 25.0)) * w > 0)
    C = compliance_matrix(plant.drive)
    np.testing.assert_allclose(C, C.T)
    assert np.linalg.eigvalsh(C).min() > 0


def test_width_of_the_friction_loop_is_twice_coulomb(plant):
    there = np.linspace(0.0, 5.0, 500)
    path = np.concatenate([there, there[::-1]])[:, None] * np.ones(6)
    state = dry_friction(path, plant.friction.presliding, np.zeros(6))
    tau = motor_friction(plant.friction, np.zeros_like(path), state, np.full_like(path, 25.0))
    np.testing.assert_allclose(tau[250] - tau[750], 2 * plant.friction.coulomb, rtol=1e-12)


def test_dry_friction_holds_at_standstill_and_turns_over_twice_its_width():
    path = np.concatenate([np.linspace(0, 1, 101), np.full(20, 1.0), 1 - np.linspace(0, 0.1, 101)])[:, None]
    state = dry_friction(path, np.array([0.02]), np.array([-1.0]))[:, 0]
    np.testing.assert_array_equal(state[100:121], 1.0)
    np.testing.assert_allclose(state[121:], np.maximum(1 - (1 - path[121:, 0]) / 0.02, -1.0), atol=1e-9)


def test_the_arm_at_rest_is_in_equilibrium(plant, bodies, q):
    direction = np.random.default_rng(2).choice([-1.0, 1.0], q.shape)
    arm, tau = arm_at_rest(plant, bodies, q, direction)
    expected = transmitted(plant, static_load(plant, bodies, arm), direction)
    np.testing.assert_allclose(tau, expected, atol=2e-5)
    ideal = gear_output(plant.drive, motor_angles(plant.drive, q), plant.geometry.zero)
    lag = tau @ compliance_matrix(plant.drive) + 0.5 * plant.drive.gap * flank(plant.drive, tau, direction)
    np.testing.assert_allclose(ideal - arm, lag, atol=1e-9)


def test_a_loaded_joint_rests_on_the_same_flank_and_an_unloaded_one_does_not(plant, bodies, q):
    forward, backward = np.ones_like(q), -np.ones_like(q)
    (up, tau), (down, _) = arm_at_rest(plant, bodies, q, forward), arm_at_rest(plant, bodies, q, backward)
    loaded = np.abs(tau[:, 1]) > 10
    assert loaded.any()
    # Joint 2 differs by arm-side friction of the wrist's reaction on its posture only: far less than its gap.
    assert np.all(np.abs(up - down)[loaded, 1] < 0.1 * plant.drive.gap[1])
    np.testing.assert_allclose(down[:, 0] - up[:, 0], plant.drive.gap[0], rtol=1e-5)


def test_springs_stiffen_symmetrically_and_never_give_back(plant):
    own = compliance_matrix(plant.drive)[1, 1]
    rated = plant.drive.rated
    cubic = np.zeros(6)
    cubic[1] = 0.9 * own / (3 * (0.8 * rated[1]) ** 2)
    drive = replace(plant.drive, hardening=cubic)
    tau = np.linspace(-2, 2, 401)[:, None] * rated
    total = tau[:, 1] * own + nonlinear_yield(drive, tau)[:, 1]
    assert np.all(np.diff(total) > 0)
    np.testing.assert_allclose(total, -total[::-1], atol=1e-12)


def test_slipping_elements_lag_and_only_take_energy(plant):
    slip = np.zeros((6, 3))
    slip[1] = 1e-7
    limit = np.ones((6, 3)) * 50.0
    tau = 400 * np.sin(np.linspace(0, 4 * np.pi, 2000))[:, None] * np.ones(6)
    angle = -slipping(slip, limit, tau)[:, 1]  # their part of the deflection
    loop = np.sum((tau[1500:, 1][1:] + tau[1500:, 1][:-1]) / 2 * np.diff(angle[1500:]))
    assert angle[np.argmax(np.diff(tau[:, 1]))] <= 0
    whole = slice(1000, 2000)
    loop = np.sum((tau[whole, 1][1:] + tau[whole, 1][:-1]) / 2 * np.diff(angle[whole]))
    assert loop > 0  # the drive puts more in than it gets back
    assert np.ptp(angle) == pytest.approx(2 * 3 * 1e-7 * 50.0)
