"""The expressions that are compiled give the matrices of the array functions, and pinocchio's inverse dynamics."""

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from test_gravity import mixed_chain

from kinematics import gravity_parameters, gravity_regressor, load_robot
from kinematics.dynamics import inertial_parameters, inertial_regressor
from kinematics.robot import RobotDescription
from kinematics.symbolic_dynamics import symbolic_torques

GRAVITY = (0.3, -0.5, -9.7)


@pytest.fixture(params=["kuka_kr20_r1810", "ur10", "mixed"])
def robot(request: pytest.FixtureRequest) -> RobotDescription:
    return mixed_chain() if request.param == "mixed" else load_robot(request.param)


def compiled(robot: RobotDescription, points: np.ndarray) -> ca.Function:
    row = [ca.SX.sym(name, robot.n) for name in ("q", "qd", "qdd")]
    torques = symbolic_torques(robot.screws, points, GRAVITY, *row)
    return ca.Function("torques", row, [ca.densify(torques.weight), ca.densify(torques.motion)])


def test_the_matrices_are_those_of_the_array_functions(robot, rng):
    q, qd, qdd = rng.uniform(-2, 2, (3, 30, robot.n))
    points = rng.uniform(-1, 1, (robot.n, 3))
    function = compiled(robot, points)
    weight, motion = gravity_regressor(robot.screws, q, GRAVITY), inertial_regressor(robot.screws, points, q, qd, qdd)
    for k in range(len(q)):
        found = [np.array(m) for m in function(q[k], qd[k], qdd[k])]
        np.testing.assert_allclose(found[0], weight[k], atol=1e-12 * np.abs(weight).max())
        np.testing.assert_allclose(found[1], motion[k], atol=1e-12 * np.abs(motion).max())


def test_together_they_are_pinocchios_inverse_dynamics(robot, pin_model, rng):
    model = pin_model(robot)
    model.gravity.linear = np.array(GRAVITY)
    data = model.createData()
    points = rng.uniform(-1, 1, (robot.n, 3))
    bodies = [inertial_parameters(b.mass, b.com, b.inertia, at) for b, at in zip(robot.links, points, strict=True)]
    function, phi, light = compiled(robot, points), np.concatenate(bodies), gravity_parameters(robot.links)
    for q, qd, qdd in zip(*rng.uniform(-2, 2, (3, 20, robot.n)), strict=True):
        weight, motion = (np.array(m) for m in function(q, qd, qdd))
        expected = pin.rnea(model, data, q, qd, qdd)
        np.testing.assert_allclose(weight @ light + motion @ phi, expected, atol=1e-12 * np.abs(expected).max())


def test_a_wrong_number_of_joints_is_named(robot):
    row = [ca.SX.sym(name, robot.n + 1) for name in ("q", "qd", "qdd")]
    with pytest.raises(ValueError, match=f"q: expected {robot.n} expressions"):
        symbolic_torques(robot.screws, np.zeros((robot.n, 3)), GRAVITY, *row)
