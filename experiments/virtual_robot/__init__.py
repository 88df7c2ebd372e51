"""A simulated robot that measures campaigns and can hide physical effects in them, with physics of its own."""

from experiments.virtual_robot.description import RobotDescription
from experiments.virtual_robot.hidden import HIDEABLE, OUTSIDE, Hidden
from experiments.virtual_robot.measure import Measured, MeasurementChoice, Truth, measure
from experiments.virtual_robot.plant import Plant
from experiments.virtual_robot.session import Session

__all__ = [
    "HIDEABLE",
    "OUTSIDE",
    "Hidden",
    "Measured",
    "MeasurementChoice",
    "Plant",
    "RobotDescription",
    "Session",
    "Truth",
    "measure",
]
