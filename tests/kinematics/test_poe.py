"""Forward kinematics against pinocchio, casadi and identities."""

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from kinematics import RobotDescription, forward, joint_transforms, load_robot, poe, robot_names, space_jacobian
from kinematics.robot import Joint
from kinematics.screws import adjoint, exp_se3, inverse, log_se3
from kinematics.symbolic import forward_sx


def mixed_chain() -> RobotDescription:
    """One joint of each kind, none along a coordinate axis."""
    unit = np.array([0.36, 0.48, 0.8])
    return RobotDescription(
        name="mixed",
        title="",
        joints=(
            Joint("a", "revolute", unit, np.array([0.1, 0.2, 0.3])),
            Joint("b", "prismatic", unit[[1, 0, 2]], np.array([0.3, 0.0, 0.5])),
            Joint("c", "helical", unit[[2, 1, 0]], np.array([0.5, -0.2, 0.6]), pitch=0.05),
            Joint("d", "revolute", -unit[[2, 0, 1]], np.array([0.7, 0.1, 0.2])),
        ),
        flange=exp_se3([0.3, -0.4, 0.9, 0.5, 0.6, 0.7]),
    )


@pytest.mark.parametrize("name", [*robot_names(), "mixed"])
def test_agrees_with_pinocchio(name, pin_model, rng):
    robot = mixed_chain() if name == "mixed" else load_robot(name)
    model = pin_model(robot)
    data = model.createData()
    q = rng.uniform(-3, 3, (50, robot.n))
    poses, jacobians = forward(robot.screws, robot.flange, q), space_jacobian(robot.screws, q)
    for row, pose, jacobian in zip(q, poses, jacobians, strict=True):
        J = pin.computeJointJacobians(model, data, row)
        pin.updateFramePlacements(model, data)
        np.testing.assert_allclose(pose, data.oMf[-1].homogeneous, atol=1e-12)
        np.testing.assert_allclose(jacobian, np.concatenate([J[3:], J[:3]]), atol=1e-12)


@pytest.mark.parametrize("name", [*robot_names(), "mixed"])
def test_casadi_agrees(name, rng):
    robot = mixed_chain() if name == "mixed" else load_robot(name)
    q = ca.SX.sym("q", robot.n)
    function = ca.Function("f", [q], [forward_sx(robot.screws, robot.flange, q)])
    for row in rng.uniform(-3, 3, (20, robot.n)):
        np.testing.assert_allclose(np.array(function(row)), forward(robot.screws, robot.flange, row), atol=1e-12)


def test_jacobian_is_the_derivative(rng):
    robot = mixed_chain()
    q, step = rng.uniform(-2, 2, robot.n), 1e-6
    J = space_jacobian(robot.screws, q)
    for i in range(robot.n):
        dq = step * np.eye(robot.n)[i]
        ahead, behind = (forward(robot.screws, robot.flange, q + sign * dq) for sign in (1, -1))
        np.testing.assert_allclose(log_se3(ahead @ inverse(behind)) / (2 * step), J[:, i], atol=1e-8)


def test_joint_transforms_are_cumulative_products(rng):
    robot = mixed_chain()
    q = rng.normal(size=(2, 3, robot.n))
    G = joint_transforms(robot.screws, q)
    assert G.shape == (2, 3, robot.n + 1, 4, 4)
    np.testing.assert_array_equal(G[..., 0, :, :], np.broadcast_to(np.eye(4), (2, 3, 4, 4)))
    expected = np.eye(4)
    for i in range(robot.n):
        expected = expected @ exp_se3(robot.screws[i] * q[1, 2, i])
        np.testing.assert_allclose(G[1, 2, i + 1], expected, atol=1e-14)


@pytest.mark.parametrize("length", [0.0, 1e-9, 1e-4, 1e-2, 0.5, 1.0, 2.0])
def test_screws_of_any_length(length, rng):
    S = np.concatenate([length * np.array([0.36, 0.48, 0.8]), [0.3, -0.2, 0.5]])
    for q in rng.uniform(-3, 3, 10):
        np.testing.assert_allclose(forward(S[None], np.eye(4), [q]), exp_se3(S * q), atol=1e-12)


def test_changing_the_base_frame_changes_screws_by_the_adjoint(rng):
    robot = load_robot("kuka_kr20_r1810")
    base, q = exp_se3(rng.normal(size=6)), rng.normal(size=6)
    moved = forward(robot.screws @ adjoint(base).T, base @ robot.flange, q)
    np.testing.assert_allclose(moved, base @ forward(robot.screws, robot.flange, q), atol=1e-13)


def test_wrong_shapes_are_named():
    robot = load_robot("ur10")
    with pytest.raises(ValueError, match=r"expected shape \(\.\.\., 6\).*found \(5,\)"):
        poe.forward(robot.screws, robot.flange, np.zeros(5))
    with pytest.raises(ValueError, match=r"screws: expected shape \(n, 6\)"):
        poe.forward(robot.screws[:, :5], robot.flange, np.zeros(6))
    with pytest.raises(ValueError, match="expected 6 expressions"):
        forward_sx(robot.screws, robot.flange, ca.SX.sym("q", 5))
