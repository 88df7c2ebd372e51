"""The arms of the pose studies: six bundled robots and a SCARA with a sliding joint, all of them with weight.

Of these makers' arms, masses and torques are known of the KR20 only. Where a description has none, those of the KR20
stand in: masses with the square of the reach, halfway along each link, and rated torques with its cube. They are
guesses, but guesses from which the virtual individual then deviates, as a real one does from its data sheet.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from kinematics.description import load_robot
from kinematics.robot import Link, RobotDescription

__all__ = ["ARMS", "arm"]

WEIGHED = "kuka_kr20_r1810"
SCARA = Path(__file__).with_name("scara.toml")
ARMS = (
    "kuka_kr16_2",
    "kuka_kr30_3",
    WEIGHED,
    "abb_irb4600_40_255",
    "abb_irb2400_12_155",
    "abb_irb1200_5_09",
    "scara",
)


def arm(name: str) -> RobotDescription:
    """One of `ARMS`, its masses and rated torques guessed where its description has none."""
    robot = load_robot(SCARA if name == "scara" else name)
    return robot if robot.has_masses else weighed(robot)


def weighed(robot: RobotDescription) -> RobotDescription:
    """The same arm with the KR20's masses and rated torques, scaled by its reach."""
    model = load_robot(WEIGHED)
    ratio = robot.reach / model.reach
    points = np.array([*(joint.point for joint in robot.joints), robot.flange[:3, 3]])
    middle = (points[:-1] + points[1:]) / 2
    links = tuple(Link(ratio**2 * link.mass, at) for link, at in zip(model.links, middle, strict=True))
    torques = [ratio**3 * joint.rated_torque for joint in model.joints]
    joints = tuple(replace(j, rated_torque=torque) for j, torque in zip(robot.joints, torques, strict=True))
    return replace(robot, links=links, joints=joints)
