"""Gravity torques against pinocchio, against the potential energy, and their linearity."""

import time
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from kinematics import (
    DescriptionError,
    Link,
    RobotDescription,
    add_tool,
    gravity_parameters,
    gravity_regressor,
    gravity_stiffness,
    gravity_torque,
    joint_transforms,
    load_robot,
)
from kinematics.robot import Joint

TILTED = np.array([1.5, -2.0, -9.3])


def mixed_chain() -> RobotDescription:
    unit = np.array([0.36, 0.48, 0.8])
    links = tuple(Link(m, np.array([0.3 * m, 0.1, -0.2 * m]), 0.01 * np.eye(3)) for m in (3.0, 2.0, 1.0, 0.5))
    joints = (
        Joint("a", "revolute", unit, np.array([0.1, 0.2, 0.3])),
        Joint("b", "prismatic", unit[[1, 0, 2]], np.array([0.3, 0.0, 0.5])),
        Joint("c", "helical", unit[[2, 1, 0]], np.array([0.5, -0.2, 0.6]), pitch=0.05),
        Joint("d", "revolute", -unit[[2, 0, 1]], np.array([0.7, 0.1, 0.2])),
    )
    return RobotDescription(name="mixed", title="", joints=joints, flange=np.eye(4), links=links)


@pytest.fixture(params=["kuka_kr20_r1810", "ur10", "mixed"])
def robot(request):
    return mixed_chain() if request.param == "mixed" else load_robot(request.param)


def test_agrees_with_pinocchio(robot, pin_model, rng):
    model = pin_model(robot)
    model.gravity.linear = TILTED
    data = model.createData()
    q = rng.uniform(-3, 3, (50, robot.n))
    torque = gravity_torque(robot, q, TILTED)
    scale = np.abs(torque).max()
    for row, found in zip(q, torque, strict=True):
        expected = pin.computeGeneralizedGravity(model, data, row)
        np.testing.assert_allclose(found, expected, atol=1e-12 * max(scale, 1.0))


def test_is_the_derivative_of_the_potential_energy(robot, rng):
    phi = gravity_parameters(robot.links).reshape(-1, 4)

    def energy(q):
        G = joint_transforms(robot.screws, q)[1:]
        return -sum(TILTED @ (m * T[:3, 3] + T[:3, :3] @ first) for (m, *first), T in zip(phi, G, strict=True))

    q, step = rng.uniform(-2, 2, robot.n), 1e-5
    for i, found in enumerate(gravity_torque(robot, q, TILTED)):
        dq = step * np.eye(robot.n)[i]
        assert found == pytest.approx((energy(q + dq) - energy(q - dq)) / (2 * step), abs=1e-5)


def test_stiffness_is_the_derivative_of_the_torque(robot, rng):
    q, phi = rng.uniform(-1.5, 1.5, (20, robot.n)), gravity_parameters(robot.links)
    K = gravity_stiffness(robot.screws, q, phi, TILTED)
    step = 1e-6
    for j in range(robot.n):
        up, down = (gravity_regressor(robot.screws, q + s * step * np.eye(robot.n)[j], TILTED) @ phi for s in (1, -1))
        np.testing.assert_allclose(K[:, :, j], (up - down) / (2 * step), atol=1e-7 * np.abs(K).max())
    np.testing.assert_array_equal(K, np.swapaxes(K, 1, 2))


def test_static_sign():
    robot = load_robot("kuka_kr20_r1810")
    torque = gravity_torque(robot, np.zeros(6))
    # Stretched forward, the arm falls about +y; the drive of joint 2 (axis +y) holds it with a negative torque.
    assert torque[1] < -100
    assert torque[0] == pytest.approx(0.0, abs=1e-12)


def test_tool_is_a_mass_on_the_last_link(robot, pin_model, rng):
    mass, com = 12.0, np.array([0.01, -0.02, 0.08])
    q = rng.uniform(-3, 3, (10, robot.n))
    model = pin_model(robot)
    flange = model.frames[len(model.frames) - 1].placement
    model.appendBodyToJoint(robot.n, pin.Inertia(mass, com, np.zeros((3, 3))), flange)
    model.gravity.linear = TILTED
    data = model.createData()
    for row, found in zip(q, gravity_torque(robot, q, TILTED, mass, com), strict=True):
        np.testing.assert_allclose(found, pin.computeGeneralizedGravity(model, data, row), atol=1e-11)


def test_add_tool_leaves_the_rest_alone():
    robot = load_robot("ur10")
    phi = gravity_parameters(robot.links)
    more = add_tool(phi, robot.flange, 2.0, [0.0, 0.0, 0.1])
    np.testing.assert_array_equal(more[:-4], phi[:-4])
    np.testing.assert_allclose((more - phi)[-4:], [2.0, *(2.0 * (robot.flange @ [0, 0, 0.1, 1])[:3])])


def test_upside_down_is_minus(robot, rng):
    q = rng.normal(size=robot.n)
    np.testing.assert_allclose(gravity_torque(robot, q, TILTED), -gravity_torque(robot, q, -TILTED))


def test_batches_and_speed(rng):
    robot = load_robot("kuka_kr20_r1810")
    q = rng.uniform(-3, 3, (15_000, 6))
    best = np.inf
    for _ in range(5):
        start = time.perf_counter()
        Y = gravity_regressor(robot.screws, q)
        best = min(best, time.perf_counter() - start)
    assert Y.shape == (15_000, 6, 24)
    np.testing.assert_allclose(Y.reshape(3, 5000, 6, 24)[1, 7], gravity_regressor(robot.screws, q[5007]), atol=1e-13)
    assert best < 0.3  # about 0.03 s on an idle core; the margin is for machines under load


def test_refusals_say_why():
    with pytest.raises(DescriptionError, match="gravity needs the masses"):
        gravity_torque(load_robot("kuka_kr16_2"), np.zeros(6))
    with pytest.raises(ValueError, match="gravity: expected shape"):
        gravity_regressor(load_robot("ur10").screws, np.zeros(6), [0.0, -9.81])
    assert gravity_parameters(replace(load_robot("ur10"), links=()).links).shape == (0,)
