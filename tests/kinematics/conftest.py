"""An independent model of the same robot, in pinocchio."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from kinematics import RobotDescription


def build_pin_model(robot: RobotDescription) -> Any:
    model = pin.Model()
    kinds = {
        "revolute": lambda joint: pin.JointModelRevoluteUnaligned(np.array(joint.axis)),
        "prismatic": lambda joint: pin.JointModelPrismaticUnaligned(np.array(joint.axis)),
        "helical": lambda joint: pin.JointModelHelicalUnaligned(np.array(joint.axis), joint.pitch),
    }
    parent, last = 0, np.zeros(3)
    for i, joint in enumerate(robot.joints):
        placement = pin.SE3(np.eye(3), joint.point - last)
        parent = model.addJoint(parent, kinds[joint.kind](joint), placement, joint.name)
        if robot.has_masses:
            link = robot.links[i]
            inertia = np.zeros((3, 3)) if link.inertia is None else np.array(link.inertia)
            body = pin.Inertia(link.mass, link.com - joint.point, inertia)
            model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        last = joint.point
    flange = pin.SE3(robot.flange[:3, :3], robot.flange[:3, 3] - last)
    model.addFrame(pin.Frame("flange", parent, 0, flange, pin.FrameType.OP_FRAME))
    return model


@pytest.fixture(scope="session")
def pin_model() -> Callable[[RobotDescription], Any]:
    return build_pin_model


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240607)
