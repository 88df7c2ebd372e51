"""Touches of a virtual robot: where it must stand for its tip to touch planes, spheres and points of a cell.

Where the tip stands is the virtual robot's own physics, links of its own among them; no effect of the library takes
part. The cell's frame is that of the virtual robot's instrument.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from experiments.campaign import Campaign, Instrument, Tool
from experiments.touched import Feature, Touched
from experiments.virtual_robot import Plant, measure
from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.draw import TARGETS, nominal_geometry
from experiments.virtual_robot.drive import arm_at_rest
from experiments.virtual_robot.pose_tables import tracked_points
from kinematics.description import load_robot

__all__ = ["BALL", "ROBOT", "SIGMA", "TIP", "base_of", "nominal_links", "plant_of", "tip_places", "touched_by"]

ROBOT = "kuka_kr20_r1810"
TIP, BALL = np.array([0.03, -0.02, 0.24]), 0.003
SIGMA = 2e-5
WARM = 20.0  # °C: links are as long as they are drawn


def plant_of(seed: int, tip: str = "tip") -> Plant:
    """A virtual robot with drawn springs, clearances, masses and links, and a tip where it was declared or a target."""
    plant = measure(load_robot(ROBOT), seed=seed, poses=1, tables=("poses",)).truth.plant
    return replace(plant, geometry=replace(plant.geometry, targets={tip: plant.geometry.targets.get(tip, TIP)}))


def nominal_links(plant: Plant) -> Plant:
    """The same with the links that the description promises."""
    return replace(plant, geometry=replace(nominal_geometry(load_robot(ROBOT)), targets={"tip": TIP}))


def base_of(plant: Plant) -> np.ndarray:
    """The base in the cell's frame ``(4, 4)``."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = plant.instrument.rotation, plant.instrument.origin
    return out


def tip_places(plant: Plant, q: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Where the tip is ``(N, 3)`` m, cell frame, without any noise."""
    bodies = Bodies(plant.geometry, plant.masses)
    arm, _ = arm_at_rest(plant, bodies, q, direction)
    return tracked_points(plant, bodies, arm, np.full(q.shape, WARM))[:, 0]


def touched_by(
    plant: Plant, seed: int, kinds: tuple[str, ...] = ("plane",) * 3 + ("sphere",) * 3, each: int = 8, **more: float
) -> Touched:
    """Touches of planes and spheres, from both sides of each joint's clearance, with noise; and points of a cell."""
    robot, rng, base = load_robot(ROBOT), np.random.default_rng(seed), base_of(plant)
    features, q, names = [], [], []
    for k, kind in enumerate(kinds):
        # A posture somewhere over the table; the feature is where the tip then is.
        here = np.array([-1.2 + 2.4 * k / len(kinds), -0.9, 1.3, 0.0, 0.4, 0.0]) + rng.uniform(-0.2, 0.2, 6)
        point = tip_places(plant, here[None], np.ones((1, 6)))[0]
        normal = base[:3, :3] @ np.eye(3)[k % 3]
        std = float(more.get("feature_std", 0.0))
        stated = point + std * rng.standard_normal(3)
        features.append(Feature(f"{kind}{k}", kind, stated, normal if kind == "plane" else np.zeros(3),
                                0.02 if kind == "sphere" else 0.0, std))  # fmt: skip
        for _ in range(each):
            posture = here + rng.uniform(-0.5, 0.5, 6) * [0.1, 0.1, 0.1, 1.0, 1.0, 2.0]
            direction = rng.choice([-1.0, 1.0], 6)
            if kind == "plane":
                along = rng.uniform(-0.15, 0.15, 3)
                aim = point + along - (along @ normal) * normal + BALL * normal
            elif kind == "sphere":
                out = rng.standard_normal(3)
                aim = point + (0.02 + BALL) * out / np.linalg.norm(out)
            else:
                aim = point
            q.append((_reached(plant, posture, direction, aim + SIGMA * rng.standard_normal(3)), direction))
            names.append(k)
    angles, directions = (np.array(part) for part in zip(*q, strict=True))
    frame = pd.DataFrame({f"q{i + 1}_rad": angles[:, i] for i in range(6)})
    frame[[f"dir{i + 1}" for i in range(6)]] = directions.astype(int)
    frame["pose"], frame["visit"], frame["time_s"] = np.arange(1, len(frame) + 1), 1, np.arange(float(len(frame)))
    frame[["x_m", "y_m", "z_m"]], frame["target"] = 0.0, next(iter(plant.geometry.targets))
    frame["feature"] = [features[k].name for k in names]
    tool = Tool(plant.masses.tool, plant.masses.tool_com)
    (tip,) = plant.geometry.targets
    campaign = Campaign(
        "touched", None, robot, plant.masses.gravity, tool, {tip: np.array(TARGETS.get(tip, TIP))},
        Instrument("touch", SIGMA, None), {"poses": frame}, "",
    )  # fmt: skip
    return Touched(campaign, tuple(features), np.array(names), BALL)


def _reached(plant: Plant, q: np.ndarray, direction: np.ndarray, aim: np.ndarray) -> np.ndarray:
    """Joint angles near some at which the tip is where it should be, by Newton's steps of least motion."""
    h = 1e-4
    for _ in range(6):
        around = tip_places(plant, np.vstack([q, q + h * np.eye(6)]), np.tile(direction, (7, 1)))
        step = np.linalg.pinv((around[1:] - around[0]).T / h) @ (aim - around[0])
        q = q + step
        if np.abs(step).max() < 1e-8:
            break
    return q
