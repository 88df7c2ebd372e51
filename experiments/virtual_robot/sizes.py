"""How large an effect must be to be seen: levers and loads of one robot over its workspace."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.description import Array
from experiments.virtual_robot.plant import Plant
from experiments.virtual_robot.sampling import Site

VISIBLE = 1.5  # times the instrument's noise, of what is left after a standard model took its share


@dataclass(frozen=True)
class Sizes:
    """Sizes over random configurations of one robot.

    Attributes
    ----------
    visible
        Displacement, m, that counts as clearly visible (norm of three axes).
    lever
        Distance of the tracked points from each joint's axis, m, (n,), rms.
    load
        Spread of each joint's static torque, Nm, (n,).
    tilting
        Displacement per tilt compliance of each joint's bearing, m per rad/Nm, (n,), rms.
    """

    visible: float
    lever: Array
    load: Array
    tilting: Array

    def angle(self, joint: int, absorbed: float = 1.0) -> float:
        """Return the rms angle, rad, that makes a joint visibly wrong; ``absorbed``: how much larger for absorption."""
        return absorbed * self.visible / max(float(self.lever[joint]), 0.05)


def sizes(site: Site, plant: Plant) -> Sizes:
    """Return the sizes of a baseline plant, always over the same configurations."""
    q = site.configurations(80, 0.85, 2 * np.pi, np.random.default_rng(1))
    bodies = Bodies(plant.geometry, plant.masses)
    n = plant.n
    pose, lever, tilting = np.tile(np.eye(4), (len(q), 1, 1)), np.zeros((len(q), n)), np.zeros((len(q), n))
    steps, frames = bodies.steps(q), []
    for k in range(n):
        pose = pose @ steps[:, k]
        frames.append(pose)
    points = np.mean(list(plant.geometry.targets.values()), axis=0)
    flange = frames[-1] @ bodies.flange
    point = flange[:, :3, :3] @ points + flange[:, :3, 3]
    spread = 0.1  # m, of the targets about their mean: a lever that even the last axis has
    load = bodies.wrenches(q)
    for k, frame in enumerate(frames):
        arm = point - frame[:, :3, 3]
        axis = frame[:, :3, :3] @ plant.geometry.axes[k]
        if plant.geometry.kinds[k] == "prismatic":
            lever[:, k] = 1.0
        else:
            lever[:, k] = np.sqrt(np.sum(np.cross(axis, arm) ** 2, axis=1) + spread**2)
        moment = np.linalg.norm(
            load.moment[:, k] - (load.moment[:, k] @ plant.geometry.axes[k])[:, None] * plant.geometry.axes[k], axis=1
        )
        tilting[:, k] = moment * np.linalg.norm(arm, axis=1)
    return Sizes(
        visible=VISIBLE * np.sqrt(3) * plant.instrument.sigma,
        lever=np.sqrt(np.mean(lever**2, axis=0)),
        load=np.std(bodies.gravity(q), axis=0),
        tilting=np.sqrt(np.mean(tilting**2, axis=0)),
    )
