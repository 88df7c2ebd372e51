"""The regressor of motion against pinocchio, and what must not depend on where inertias are counted about."""

import numpy as np
import pinocchio as pin
import pytest
from test_gravity import mixed_chain

from kinematics import gravity_torque, load_robot
from kinematics.dynamics import inertial_parameters, inertial_regressor
from kinematics.robot import RobotDescription


@pytest.fixture(params=["kuka_kr20_r1810", "ur10", "mixed"])
def robot(request: pytest.FixtureRequest) -> RobotDescription:
    return mixed_chain() if request.param == "mixed" else load_robot(request.param)


def parameters(robot: RobotDescription, points: np.ndarray) -> np.ndarray:
    bodies = [inertial_parameters(b.mass, b.com, b.inertia, at) for b, at in zip(robot.links, points, strict=True)]
    return np.concatenate(bodies)


def test_with_gravity_it_is_pinocchios_inverse_dynamics(robot, pin_model, rng):
    model = pin_model(robot)
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    data = model.createData()
    q, qd, qdd = rng.uniform(-2, 2, (3, 40, robot.n))
    points = rng.uniform(-1, 1, (robot.n, 3))
    torque = inertial_regressor(robot.screws, points, q, qd, qdd) @ parameters(robot, points)
    torque = torque + gravity_torque(robot, q, (0.0, 0.0, -9.81))
    expected = np.array([pin.rnea(model, data, *row) for row in zip(q, qd, qdd, strict=True)])
    np.testing.assert_allclose(torque, expected, atol=1e-12 * np.abs(expected).max())


def test_power_goes_into_kinetic_energy(robot, rng):
    points = np.zeros((robot.n, 3))
    phi = parameters(robot, points)
    q, qd, qdd = rng.uniform(-2, 2, (3, 1, robot.n))
    step = 1e-5

    def energy(t: float) -> float:
        rate = qd + t * qdd
        at = q + t * qd + 0.5 * t * t * qdd
        # Twice the kinetic energy is the torque that would bring the present speeds about as accelerations.
        return float(0.5 * (rate @ (inertial_regressor(robot.screws, points, at, 0 * rate, rate) @ phi)[0])[0])

    power = float((qd[0] * (inertial_regressor(robot.screws, points, q, qd, qdd) @ phi)[0]).sum())
    assert power == pytest.approx((energy(step) - energy(-step)) / (2 * step), rel=1e-6)


@pytest.mark.parametrize(("name", "shape"), [("points", (2, 3)), ("qd", (5, 2)), ("qdd", (4, 6))])
def test_wrong_shapes_are_named(name: str, shape: tuple[int, int]):
    robot = load_robot("ur10")
    given = {"points": np.zeros((6, 3)), "q": np.zeros((5, 6)), "qd": np.zeros((5, 6)), "qdd": np.zeros((5, 6))}
    given[name] = np.zeros(shape)
    with pytest.raises(ValueError, match=f"{name}: expected shape"):
        inertial_regressor(robot.screws, **given)
