"""
A second virtual world, written independently: other robots, noise, programmes and laws of every effect.

It exists to find out whether a diagnosis works on the first virtual robot only. It shares no code with that one, nor
with the estimator: numpy, scipy, pandas and pinocchio are all it imports.

A robot that hides nothing has geometry, gravity, rigid-body and rotor inertia, Coulomb and viscous friction, springs
and clearances; its motors turn as its joints do. Everything else is hidden on purpose::

    robot = draw_robot("seven7", seed=4)
    session = {"program": "two_sided", "noise": "stereo", "seed": 1}
    magnitude = magnitude_for(robot, "gear_eccentricity", "joint5", 0.8, **session)
    measure(robot, "out/c1", hidden=[("gear_eccentricity", "joint5", magnitude)], **session)
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
