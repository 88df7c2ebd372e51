"""The tables of measured points: poses and verification."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.description import Array
from experiments.virtual_robot.drive import arm_at_rest
from experiments.virtual_robot.heat import History, read_sensors
from experiments.virtual_robot.instrument import to_instrument
from experiments.virtual_robot.outside import outside_shift
from experiments.virtual_robot.plant import Plant
from experiments.virtual_robot.programs import TARGET_TIME, PoseProgram
from experiments.virtual_robot.structure import deformation, flange_poses
from experiments.virtual_robot.torque_tables import Logged, columns


def tracked_points(
    plant: Plant, bodies: Bodies, arm: Array, link_temperature: Array, time: Array | None = None
) -> Array:
    """Return the tracked points in the instrument's frame, m, (N, targets, 3), at true joint angles, rad, (N, n).

    ``time`` as in :func:`deformation`.
    """
    points = base_points(plant, bodies, arm, link_temperature, time)
    return np.stack([to_instrument(plant.instrument, points[:, k]) for k in range(points.shape[1])], axis=1)


def base_points(plant: Plant, bodies: Bodies, arm: Array, link_temperature: Array, time: Array | None = None) -> Array:
    """Return the same points in the robot's base frame, m, (N, targets, 3)."""
    pose = flange_poses(bodies, arm, deformation(plant, bodies, arm, link_temperature, time))
    points = []
    for target in plant.geometry.targets.values():
        point = pose[:, :3, :3] @ target + pose[:, :3, 3]
        points.append(point + outside_shift(plant.outside, pose[:, :3, 3], point))
    return np.stack(points, axis=1)


def measure_poses(
    plant: Plant, bodies: Bodies, program: PoseProgram, history: History, rng: np.random.Generator
) -> Logged:
    """Measure every target at every visit; ``noise_free`` lacks instrument noise and the robot's repeatability."""
    visits, n = program.q.shape
    names = list(plant.geometry.targets)
    arm, _ = arm_at_rest(plant, bodies, program.q, program.direction)
    there = arm + plant.instrument.repeatability * rng.standard_normal((visits, n))
    warm = history.at(program.time).link
    truth = tracked_points(plant, bodies, arm, warm, program.time).reshape(-1, 3)
    read = tracked_points(plant, bodies, there, warm, program.time).reshape(-1, 3)
    read += plant.instrument.sigma * rng.standard_normal(read.shape)

    time, data = stops(program, len(names))
    table = pd.DataFrame(data | {"target": np.tile(names, visits)})
    table[["x_m", "y_m", "z_m"]] = read
    sensors = read_sensors(history.at(time), plant.instrument.temperature_sigma, rng)
    return Logged(pd.concat([table, pd.DataFrame(sensors)], axis=1), truth)


def stops(program: PoseProgram, count: int) -> tuple[Array, dict[str, Any]]:
    """Return the times of ``count`` measurements at every visit, s, and the columns that say where the robot stood."""
    visits, n = program.q.shape
    each = np.repeat(np.arange(visits), count)
    time = program.time[each] + TARGET_TIME * np.tile(np.arange(count), visits)
    data: dict[str, Any] = {"pose": program.pose[each], "visit": program.visit[each], "time_s": np.round(time, 3)}
    data |= columns("q", program.q[each], "rad")
    return time, data | {f"dir{i + 1}": program.direction[each, i].astype(int) for i in range(n)}
