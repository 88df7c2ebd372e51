"""The table of distances: at every visit from each of a few anchors to one of the targets, as a ballbar has them."""

from __future__ import annotations

import numpy as np
import pandas as pd

from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.description import Array
from experiments.virtual_robot.drive import arm_at_rest
from experiments.virtual_robot.heat import History, read_sensors
from experiments.virtual_robot.plant import Geometry, Plant
from experiments.virtual_robot.pose_tables import base_points, stops
from experiments.virtual_robot.programs import PoseProgram
from experiments.virtual_robot.torque_tables import Logged

ANCHORS = ("A1", "A2", "A3")
DISTANCE_SIGMA = 1e-5  # m, of an interferometer or a long ballbar in a workshop's air


def draw_anchors(geometry: Geometry, rng: np.random.Generator) -> Array:
    """Return where the anchors stand, m, (3, 3), base frame: around the robot, within its reach or a little beyond."""
    reach = float(np.sum(np.linalg.norm(geometry.link_vectors, axis=1)))
    azimuth = 2 * np.pi * (np.arange(len(ANCHORS)) + rng.uniform(-0.2, 0.2, len(ANCHORS))) / len(ANCHORS)
    away = reach * rng.uniform(0.7, 1.1, len(ANCHORS))
    height = reach * rng.uniform(-0.3, 0.5, len(ANCHORS))
    return np.stack([away * np.cos(azimuth), away * np.sin(azimuth), height], axis=1)


def measure_distances(
    plant: Plant, bodies: Bodies, program: PoseProgram, history: History, anchors: Array, rng: np.random.Generator
) -> Logged:
    """Measure from every anchor at every visit, the target changing from one to the next.

    ``noise_free`` lacks the noise of the distances and the robot's repeatability.
    """
    visits, n = program.q.shape
    names = np.array(list(plant.geometry.targets))
    arm, _ = arm_at_rest(plant, bodies, program.q, program.direction)
    there = arm + plant.instrument.repeatability * rng.standard_normal((visits, n))
    warm = history.at(program.time).link
    # A pose that is visited again is measured to the same targets again.
    target = (program.pose[:, None] + np.arange(len(anchors))) % len(names)

    def distances(q: Array) -> Array:
        points = base_points(plant, bodies, q, warm, program.time)[np.arange(visits)[:, None], target]
        return np.asarray(np.linalg.norm(points - anchors, axis=2).ravel(), dtype=float)

    truth = distances(arm)
    time, data = stops(program, len(anchors))
    table = pd.DataFrame(data | {"target": names[target.ravel()], "anchor": np.tile(ANCHORS, visits)})
    table["distance_m"] = distances(there) + DISTANCE_SIGMA * rng.standard_normal(truth.shape)
    sensors = read_sensors(history.at(time), plant.instrument.temperature_sigma, rng)
    return Logged(pd.concat([table, pd.DataFrame(sensors)], axis=1), truth[:, None])
