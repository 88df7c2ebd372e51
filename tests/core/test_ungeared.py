"""Robots whose description has no gears: their motors' friction is what it is at the joints."""

from __future__ import annotations

import numpy as np
import pytest
from virtual_arms import arm

from clampid.catalogue import catalogue
from clampid.identification.identify import identify
from clampid.slots import Slot
from clampid.stages.fit_problem import parameter_of
from experiments.simulate import measured_campaign
from experiments.virtual_robot import measure
from kinematics.description import load_robot


@pytest.mark.parametrize(
    "name", ["coulomb_friction.Fc", "viscous_friction.Fv", "torque_offset.b", "stribeck_friction.ws"]
)
def test_sizes_at_the_motor_are_those_at_the_joint_behind_its_gear(name: str):
    """Power is the same on both sides: torque times speed of what is usual."""
    slot = Slot(*name.split("."), "joint2")
    geared, ungeared = load_robot("kuka_kr20_r1810"), arm("abb_irb4600_40_255")
    ratio = 1.0 / abs(float(np.asarray(geared.transmission)[1, 1]))
    own, joint = (parameter_of(slot, catalogue(), robot) for robot in (geared, ungeared))
    power = {"Fc": -1, "Fv": -2, "b": -1, "ws": 1}[slot.parameter]
    assert own.size == pytest.approx(joint.size * ratio**power)
    np.testing.assert_allclose(own.grid, np.array(joint.grid) * ratio**power)


def test_friction_of_motors_at_the_joints_is_found():
    """Its prior was a motor's: viscous friction of 250 Nm s/rad came out as none, joint 2's weight 3 % too small."""
    robot = arm("abb_irb4600_40_255")
    measured = measure(robot, seed=30_000, tables=("free_air", "wrist"))
    stage = identify(measured_campaign(measured, robot)).stages["free_air"]
    friction = measured.truth.plant.friction
    for j in range(robot.n):
        for name, parameter, true in (
            ("viscous_friction", "Fv", friction.viscous[j]),
            ("coulomb_friction", "Fc", friction.coulomb[j] + friction.arm[j]),
        ):
            k = stage.slots.index(Slot(name, parameter, f"joint{j + 1}"))
            assert stage.identified[k]
            assert abs(stage.theta[k] - true) < 4.0 * stage.std[k]
