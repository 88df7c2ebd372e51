"""Campaigns of a virtual robot whose controller compensates deflections: rightly, or with one of the thesis' mistakes.

The poses are measured at the joint values that were asked for, while the robot was sent to others. Where it then stands
is the virtual robot's own physics; no effect of the library takes part.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from experiments.campaign import Campaign, read_campaign, write_campaign
from experiments.virtual_robot import Plant, measure
from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.drive import arm_at_rest, compliance_matrix, static_load
from experiments.virtual_robot.pose_tables import tracked_points
from kinematics.description import load_robot

__all__ = ["MISTAKES", "compensated"]

Command = Callable[[Plant, np.ndarray], np.ndarray]
ROBOT = "kuka_kr20_r1810"


def _deflection(plant: Plant, q: np.ndarray, own: bool = True) -> np.ndarray:
    """What the springs give way under gravity ``(N, n)``, rad; without the arm's own weight on demand."""
    load = static_load(plant, Bodies(plant.geometry, plant.masses), q)
    if not own:
        empty = replace(plant.masses, tool=0.0)
        load = load - static_load(replace(plant, masses=empty), Bodies(plant.geometry, empty), q)
    return load @ compliance_matrix(plant.drive)


MISTAKES: dict[str, Command] = {
    "none": lambda plant, q: np.zeros_like(q),
    "right": _deflection,
    "degrees": lambda plant, q: math.degrees(1.0) * _deflection(plant, q),
    "own weight": lambda plant, q: _deflection(plant, q, own=False),
    "sign": lambda plant, q: -_deflection(plant, q),
}
"""What is added to the joint values that were asked for."""


def compensated(folder: Path, mistake: str, seed: int, poses: int) -> Campaign:
    """A campaign of poses that were measured with a compensation switched on."""
    found = measure(load_robot(ROBOT), seed=seed, poses=poses, tables=("poses",))
    plant, table = found.truth.plant, found.tables["poses"].copy()
    n = plant.n
    bodies = Bodies(plant.geometry, plant.masses)
    q = table[[f"q{i + 1}_rad" for i in range(n)]].to_numpy(float)
    direction = table[[f"dir{i + 1}" for i in range(n)]].to_numpy(float)
    warm = table[[f"temp_link{i + 1}_C" for i in range(n)]].to_numpy(float)
    names = list(plant.geometry.targets)
    target = np.array([names.index(t) for t in table["target"]])

    def points(sent: np.ndarray) -> np.ndarray:
        arm, _ = arm_at_rest(plant, bodies, sent, direction)
        return tracked_points(plant, bodies, arm, warm)[np.arange(len(table)), target]

    moved = points(q + MISTAKES[mistake](plant, q)) - points(q)
    table[["x_m", "y_m", "z_m"]] += moved
    return read_campaign(write_campaign(folder, dict(found.header), {"poses": table}))
