"""Files of obstacles around a robot, in TOML."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np

from experiments.plans.errors import PlanError
from kinematics.collision.obstacles import FARTHEST_OBSTACLE, Obstacle, ObstacleShape
from kinematics.reading import read_text, toml_of
from kinematics.screws import exp_so3
from kinematics.section import Section

__all__ = ["read_obstacles"]

LARGEST_TURN = 4.0 * np.pi  # rad: a larger angle was probably meant in degrees
KINDS: tuple[ObstacleShape, ...] = ("box", "sphere", "cylinder")


def read_obstacles(path: Path) -> tuple[Obstacle, ...]:
    """Read obstacles from TOML: tables ``[[box]]``, ``[[sphere]]``, ``[[cylinder]]``, base frame, m and rad.

    Each obstacle has ``centre_m``. A box has ``size_m`` (three edges), a sphere ``radius_m``, a cylinder ``radius_m``
    and ``length_m``. ``name`` and ``turn_rad``, a rotation vector, are optional.

    Raises
    ------
    PlanError
        The file is missing or not TOML, or a key is missing, unknown or wrong.
    """
    if not path.is_file():
        raise PlanError(f"{path}: expected a file of obstacles, found no such file")
    try:
        root = Section(toml_of(read_text(path)), str(path), error=PlanError)
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise PlanError(f"{path}: expected TOML, found {error}") from error
    found = []
    for kind in KINDS:
        for number, one in enumerate(root.sections(kind, optional=True), 1):
            if kind == "box":
                size = tuple(one.vector("size_m", 3, 0.0, FARTHEST_OBSTACLE, "m").tolist())
            else:
                size = (one.number("radius_m", 0.0, FARTHEST_OBSTACLE, "m", above=True),)
            if kind == "cylinder":
                size = (*size, one.number("length_m", 0.0, FARTHEST_OBSTACLE, "m", above=True))
            pose = np.eye(4)
            pose[:3, :3] = exp_so3(one.vector("turn_rad", 3, -LARGEST_TURN, LARGEST_TURN, "rad", np.zeros(3)))
            pose[:3, 3] = one.vector("centre_m", 3, -FARTHEST_OBSTACLE, FARTHEST_OBSTACLE, "m")
            found.append(Obstacle(one.text("name", default=f"{kind} {number}"), kind, size, pose))
            one.done()
    root.done()
    return tuple(found)
