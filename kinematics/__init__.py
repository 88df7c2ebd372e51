"""The ideal robot: screws, transmission matrix, gravity loads, DH conversions, URDF."""

from kinematics.description import load_robot, robot_names
from kinematics.dh import DHRow, DHTable
from kinematics.dh_conversion import DHError, hayati_from_poe, poe_from_dh, standard_from_poe
from kinematics.gravity import add_tool, gravity_parameters, gravity_regressor, gravity_stiffness, gravity_torque
from kinematics.poe import forward, joint_transforms, space_jacobian
from kinematics.robot import DescriptionError, Joint, Link, RobotDescription
from kinematics.sources import load_sources
from kinematics.transmission import Transmission

__all__ = [
    "DHError",
    "DHRow",
    "DHTable",
    "DescriptionError",
    "Joint",
    "Link",
    "RobotDescription",
    "Transmission",
    "add_tool",
    "forward",
    "gravity_parameters",
    "gravity_regressor",
    "gravity_stiffness",
    "gravity_torque",
    "hayati_from_poe",
    "joint_transforms",
    "load_robot",
    "load_sources",
    "poe_from_dh",
    "robot_names",
    "space_jacobian",
    "standard_from_poe",
]
