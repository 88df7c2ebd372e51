"""Campaigns of circles: a virtual robot turns joint 1, then joint 2, and one to three targets are measured.

Where its points stand is the virtual robot's own physics; no effect of the library takes part.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from clampid.effect import Stage
from clampid.models.model import Model, Session, StageModel
from clampid.slots import Layout, Slot, Term
from experiments.campaign import Campaign
from experiments.simulate import measured_campaign
from experiments.virtual_robot import Plant, measure
from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.heat import session
from experiments.virtual_robot.pose_tables import measure_poses
from experiments.virtual_robot.programs import PoseProgram
from kinematics.description import load_robot
from kinematics.gravity import gravity_parameters

__all__ = ["ROBOT", "SWEEPS", "circle_campaign", "known_drives", "stiff"]

ROBOT = "kuka_kr20_r1810"
SWEEPS: Mapping[int, Sequence[Sequence[float]]] = {
    0: ([0.0, -1.0, 1.2, 0.0, 0.3, 0.0], [0.0, -0.4, 0.5, 0.4, -0.6, 0.3]),
    1: ([0.0, -1.0, 0.2, 0.0, 0.5, 0.0], [0.7, -1.0, 1.0, 0.3, 0.5, 0.0]),
}
"""Joint (from 0) → postures from which it turns, rad."""
RANGES = ((-2.4, 2.4), (-2.4, 0.6))
STEPS = 14


def stiff(plant: Plant) -> Plant:
    """The same robot with drives that neither give way nor have clearances."""
    drive = plant.drive
    return replace(plant, drive=replace(drive, spring=1e9 * drive.spring, gap=0.0 * drive.gap))


def known_drives(plant: Plant, seed: int, relative: float = 0.02) -> Model:
    """What torques could have told of this robot: its springs, clearances and masses, drawn with their covariance."""
    robot, rng = load_robot(ROBOT), np.random.default_rng(seed)
    joints = [f"joint{i + 1}" for i in range(robot.n)]
    springs = {Slot("joint_compliance", "c", j): 1.0 / k for j, k in zip(joints, plant.drive.spring, strict=True)}
    gaps = {Slot("backlash", "gap", j): b for j, b in zip(joints, plant.drive.gap, strict=True)}
    described = gravity_parameters(robot.links).reshape(-1, 4)
    true = np.c_[plant.masses.link, plant.masses.link[:, None] * plant.masses.com]
    loads = {
        Slot("gravity", name, f"link{i + 1}"): (true - described)[i, k]
        for i in range(robot.n)
        for k, name in enumerate(("m", "mx", "my", "mz"))
    }
    dry = {Slot("wrist_coupling_friction", "F", j): f for j, f in zip(joints, plant.friction.arm, strict=True)}
    stages: dict[Stage, StageModel] = {}
    for stage, values, std in (
        ("clamped", springs | gaps, np.r_[[relative * c for c in springs.values()], [2e-6] * robot.n]),
        ("free_air", loads | dry, np.r_[[0.05] * len(loads), 0.05 * plant.friction.arm]),
    ):
        theta = np.array(list(values.values())) + std * rng.standard_normal(len(values))
        terms = tuple(Term(name) for name in dict.fromkeys(s.effect for s in values))
        known: Stage = "clamped" if stage == "clamped" else "free_air"
        stages[known] = StageModel(known, terms, tuple(values), theta, np.diag(std**2), (True,) * len(values))
    return Model(ROBOT, Layout(robot.n), stages, (Session("made", "", None, (), plant.masses.tool),))


def circle_campaign(
    seed: int, alter: Callable[[Plant], Plant] = lambda plant: plant, noise: int = 0
) -> tuple[Campaign, Plant]:
    """A campaign whose table poses holds circles, and the robot it was measured on."""
    robot = load_robot(ROBOT)
    found = measure(robot, seed=seed, poses=1, tables=("poses",), alter=alter)
    plant = found.truth.plant
    q = []
    for joint, postures in SWEEPS.items():
        for posture in postures:
            for angle in np.linspace(*RANGES[joint], STEPS):
                q.append([*posture])
                q[-1][joint] = angle
    path = np.array(q)
    number = np.arange(1, len(path) + 1)
    direction = np.ones_like(path)
    time = 60.0 * number
    program = PoseProgram(number, np.ones_like(number), time, path, direction, np.zeros_like(path))
    history = session(plant.heat, time, np.zeros_like(path))
    bodies = Bodies(plant.geometry, plant.masses)
    logged = measure_poses(plant, bodies, program, history, np.random.default_rng([seed, noise]))
    return measured_campaign(replace(found, tables={"poses": logged.table}), robot), plant
