"""Power goes through an ideal gearbox unchanged, and everything has an inverse."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kinematics import Transmission, load_robot

few = settings(derandomize=True, max_examples=40, deadline=None)
six = arrays(np.float64, 6, elements=st.floats(-100, 100, allow_subnormal=False))
gears = Transmission(load_robot("kuka_kr20_r1810").transmission)


@few
@given(six, six)
def test_power_is_conserved(torque, motor_speed):
    at_joint = torque @ gears.joint_from_motor(motor_speed)
    assert at_joint == pytest.approx(gears.motor_torque(torque) @ motor_speed, abs=1e-9)


@few
@given(six)
def test_inverses(x):
    np.testing.assert_allclose(gears.motor_from_joint(gears.joint_from_motor(x)), x, atol=1e-11)
    np.testing.assert_allclose(gears.joint_torque(gears.motor_torque(x)), x, atol=1e-11)


def test_the_formulas_themselves(rng):
    x = rng.normal(size=6)
    np.testing.assert_allclose(gears.joint_from_motor(x), gears.T.T @ x)
    np.testing.assert_allclose(gears.motor_torque(x), gears.T @ x)


def test_last_axis_is_the_joint(rng):
    x = rng.normal(size=(3, 4, 6))
    for method in (gears.joint_from_motor, gears.motor_from_joint, gears.motor_torque, gears.joint_torque):
        assert method(x).shape == (3, 4, 6)
        np.testing.assert_allclose(method(x)[1, 2], method(x[1, 2]), rtol=1e-12)


def test_compliance_is_what_springs_at_the_motors_do(rng):
    k, torque = rng.uniform(0.5, 20, 6), rng.normal(size=6)
    wind_up = gears.motor_torque(torque) / k
    np.testing.assert_allclose(gears.joint_compliance(k) @ torque, gears.joint_from_motor(wind_up), rtol=1e-12)
    C = gears.joint_compliance(k)
    np.testing.assert_allclose(C, C.T, rtol=1e-12)
    assert np.linalg.eigvalsh(C).min() > 0
    assert abs(C[4, 5]) > 0  # not diagonal in the wrist


def test_tx40_motor_6_is_also_turned_by_joint_5():
    robot = load_robot("staubli_tx40")
    q = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    motor = Transmission(robot.transmission).motor_from_joint(q)
    np.testing.assert_allclose(
        motor, [32 * q[0], 32 * q[1], 45 * q[2], -48 * q[3], 45 * q[4], 32 * (q[4] + q[5])], rtol=1e-12
    )


def test_refusals_say_why():
    with pytest.raises(ValueError, match="expected a square matrix"):
        Transmission(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="expected an invertible matrix"):
        Transmission(np.ones((2, 2)))
    with pytest.raises(ValueError, match="expected 6 positive constants"):
        gears.joint_compliance([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    with pytest.raises(ValueError, match="read-only"):
        gears.T[0, 0] = 1.0
