"""The nominal robot of a model: a bundled one by its name, or the file that the campaign named."""

from __future__ import annotations

from clampid.models.model import Model, ModelError
from experiments.targets import protect
from kinematics.description import load_robot, robot_names
from kinematics.robot import DescriptionError, RobotDescription

__all__ = ["robot_of"]


def robot_of(model: Model, robot: RobotDescription | None = None) -> RobotDescription:
    """The nominal robot of a model.

    Parameters
    ----------
    robot
        The description, where it is at hand; else that of the model's file for it, or the bundled one of its name.

    Raises
    ------
    ModelError
        The description is of another robot, or there is none where the model says; the message says how to give one.
    """
    if robot is None:
        protect(model.robot_file)
        if model.robot_file is None and model.robot not in robot_names():
            raise ModelError(
                f"the model is of the robot {model.robot!r}, which is not a bundled one, and does not say in which "
                "file it is described: give that file, .toml or .urdf, with --robot FILE (in Python: "
                "robot=load_robot(FILE))"
            )
        try:
            robot = load_robot(model.robot if model.robot_file is None else model.robot_file)
        except DescriptionError as error:
            raise ModelError(
                f"the model is of the robot {model.robot!r}, described in a file: {error}; put it there or beside the "
                "model, or give it with --robot FILE (in Python: robot=load_robot(FILE))"
            ) from error
    if robot.name != model.robot:
        raise ModelError(f"the model is of the robot {model.robot}, the description of {robot.name}")
    return robot
