"""The robot's own weight tells Nm at the motors from Nm at the gears and from per cent."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.links.weight import check_torque_unit
from kinematics.description import load_robot
from kinematics.gravity import gravity_torque

ROBOT = load_robot("kuka_kr20_r1810")


def at_rest(seed: int = 0, poses: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Postures, and torques of joints with friction of a tenth of the largest and masses 20 % off."""
    rng = np.random.default_rng(seed)
    q = np.radians(np.array([0.0, -90.0, 90.0, 0.0, 0.0, 0.0]) + rng.uniform(-60, 60, (poses, 6)))
    torque = 1.2 * gravity_torque(ROBOT, q)
    friction = 0.1 * np.abs(torque).max(axis=0) * rng.choice([-1, 1], q.shape)
    return q, torque + friction


def test_nm_at_the_motors() -> None:
    q, torque = at_rest()
    found = check_torque_unit(ROBOT, q, torque @ ROBOT.transmission.T)
    assert (found.unit, found.side) == ("Nm", "motor")
    assert found.motor_slope[1] == pytest.approx(1.2, abs=0.15)
    assert np.isnan(found.motor_slope[0])  # an upright axis bears no weight


def test_nm_at_the_gears() -> None:
    q, torque = at_rest()
    found = check_torque_unit(ROBOT, q, torque)
    assert (found.unit, found.side) == ("Nm", "gear")


@pytest.mark.parametrize("rated", [5.0, 10.0, 20.0])
def test_per_cent_of_the_rated_torque_is_not_nm(rated: float) -> None:
    q, torque = at_rest()
    found = check_torque_unit(ROBOT, q, 100.0 / rated * torque @ ROBOT.transmission.T)
    assert found.unit is None
    assert "one unit is" in found.words


def test_a_wrong_sign_is_not_nm() -> None:
    q, torque = at_rest()
    assert check_torque_unit(ROBOT, q, -torque).unit is None


def test_what_is_not_informative_is_said() -> None:
    q, torque = at_rest()
    with pytest.raises(ValueError, match="expected joints and torques"):
        check_torque_unit(ROBOT, q[:3], torque[:3])
    with pytest.raises(ValueError, match="none that do"):
        check_torque_unit(ROBOT, q, np.random.default_rng(1).normal(size=q.shape))
    with pytest.raises(ValueError, match="none that do"):
        check_torque_unit(ROBOT, np.tile(q[0], (6, 1)), torque[:6])
