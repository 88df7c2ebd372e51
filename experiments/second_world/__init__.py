"""
A second virtual world, by another hand: other robots, other noise, other programmes, other forms of every effect.

It exists to find out whether a diagnosis works on the first virtual robot only. It shares no code with that one, nor
with the estimator: numpy, scipy, pandas and pinocchio are all it imports.
"""

from experiments.second_world.hidden import HIDDEN
from experiments.second_world.individual import ROBOTS, Robot, draw_robot
from experiments.second_world.log_programs import LOG_PROGRAMS
from experiments.second_world.measurement import TABLES, Truth, measure
from experiments.second_world.noise import NOISES
from experiments.second_world.pose_programs import POSE_PROGRAMS
from experiments.second_world.sizing import magnitude_for, size_in_sigma

__all__ = [
    "HIDDEN",
    "LOG_PROGRAMS",
    "NOISES",
    "POSE_PROGRAMS",
    "ROBOTS",
    "TABLES",
    "Robot",
    "Truth",
    "draw_robot",
    "magnitude_for",
    "measure",
    "size_in_sigma",
]
