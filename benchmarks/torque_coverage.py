"""Coverage of the standard errors of gravity and friction: free air and wrist of many virtual robots.

    python benchmarks/torque_coverage.py [--seeds 200]

Every robot is another individual with another program and other noise. Gravity is compared in the directions of the
links' (m, m c) that torques determine; their truth is what predicts the true static torque best, since an individual's
screws and springs are not those of the description. Prints the share of 95 % intervals that hold the truth, all
together and parameter by parameter, and the error of torques in another program, over the noise.
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import numpy.typing as npt
from coverage_table import coverage

from clampid.comparison.compare import compare
from clampid.identification.identify import identify
from clampid.models.model import StageModel
from experiments.simulate import measured_campaign
from experiments.virtual_robot import Measured, measure
from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.drive import compliance_matrix, gear_output, motor_angles, static_load
from experiments.virtual_robot.plant import Plant
from kinematics.description import load_robot
from kinematics.gravity import gravity_parameters, gravity_regressor
from kinematics.robot import RobotDescription

Array = npt.NDArray[np.float64]
ROBOT = "kuka_kr20_r1810"
POSTURES = 400
TABLES = ("free_air", "wrist")
MOST = 0.5  # of the robots: of some joints the friction on the arm's side is told only together with the motor's
OTHER_PROGRAM = 100_000  # added to the seed: programs and noise of its own


@dataclass(frozen=True)
class Trial:
    """One robot: errors over standard errors, and per motor the error in another program over the noise."""

    errors: dict[str, float]
    unseen: list[float]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    with ProcessPoolExecutor(arguments.processes) as pool:
        trials = list(pool.map(trial, seeds))
    held = coverage([t.errors for t in trials], stated_by=MOST)
    print(f"{len(trials)} robots; 95 % intervals that hold the truth: {held.summary}")
    print(held.table())
    unseen = np.array([t.unseen for t in trials])
    print(f"torques of another program, rms error over noise, motor by motor: {np.round(unseen.mean(axis=0), 3)}")
    print(f"largest of all: {unseen.max():.3f}")


def trial(seed: int) -> Trial:
    """Identify one robot, and predict another program of it."""
    robot = load_robot(ROBOT)
    measured = measure(robot, seed=seed, tables=TABLES)
    plant = measured.truth.plant
    model = identify(measured_campaign(measured, robot))
    other = measure(robot, seed=OTHER_PROGRAM + seed, tables=("free_air",), alter=lambda _: plant)
    motors = compare(model, measured_campaign(other, robot)).tables["free_air"]["per_motor"]
    noise = plant.instrument.torque_sigma
    unseen = [float(m["heldout"]["rms_Nm"] / sigma) for m, sigma in zip(motors, noise, strict=True)]
    stage = model.stages["free_air"]
    return Trial(friction_errors(stage, plant, robot) | gravity_errors(stage, measured, robot, seed), unseen)


def friction_errors(stage: StageModel, plant: Plant, robot: RobotDescription) -> dict[str, float]:
    """Errors of friction over standard errors; where only the sum of both sides shows, of the sum."""
    index = {(s.parameter, s.place): k for k, s in enumerate(stage.slots) if s.effect.endswith("_friction")}
    T = np.asarray(robot.transmission)
    out = {}
    for j in range(robot.n):
        at = f"joint{j + 1}"
        motor, viscous, arm = index["Fc", at], index["Fv", at], index.get(("F", at))
        weights = {"Fv": ({viscous: 1.0}, plant.friction.viscous[j]), "Fc": ({motor: 1.0}, plant.friction.coulomb[j])}
        if arm is not None and stage.identified[arm] and stage.identified[motor]:
            weights["F"] = ({arm: 1.0}, plant.friction.arm[j])
        elif arm is not None:
            share = abs(T[j, j])
            both = plant.friction.coulomb[j] + share * plant.friction.arm[j]
            weights["Fc"] = ({motor: 1.0, arm: share}, both)
        for name, (parts, truth) in weights.items():
            w = np.zeros(len(stage.slots))
            w[list(parts)] = list(parts.values())
            out[f"{name} joint {j + 1}"] = float((w @ stage.theta - truth) / np.sqrt(w @ stage.covariance @ w))
    return out


def gravity_errors(stage: StageModel, measured: Measured, robot: RobotDescription, seed: int) -> dict[str, float]:
    """Errors of gravity over standard errors, in orthonormal directions of (m, m c) that torques determine."""
    rng = np.random.default_rng(seed)
    lower, upper = np.array([j.lower for j in robot.joints]), np.array([j.upper for j in robot.joints])
    q = lower + (upper - lower) * rng.uniform(0.15, 0.85, (POSTURES, robot.n))
    Y = gravity_regressor(robot.screws, q, measured.header["gravity_m_s2"])
    flat = Y.reshape(-1, Y.shape[2])
    declared = measured.header["tool"]
    tool = robot.flange[:3, :3] @ np.array(declared["com_m"]) + robot.flange[:3, 3]
    known = np.array(gravity_parameters(robot.links))
    known[-4:] += declared["mass_kg"] * np.r_[1.0, tool]
    _, size, Vt = np.linalg.svd(flat, full_matrices=False)
    V = Vt[size > 1e-9 * size[0]].T
    beyond = np.linalg.lstsq(flat @ V, (static_torque(measured.truth.plant, q) - Y @ known).ravel(), rcond=None)[0]
    index = {(s.parameter, s.place): k for k, s in enumerate(stage.slots) if s.effect == "gravity"}
    at = [index[name, f"link{i + 1}"] for i in range(robot.n) for name in ("m", "mx", "my", "mz")]
    error = V.T @ stage.theta[at] - beyond
    std = np.sqrt(np.diag(V.T @ stage.covariance[np.ix_(at, at)] @ V))
    return {f"gravity {i + 1}": float(e / s) for i, (e, s) in enumerate(zip(error, std, strict=True))}


def static_torque(plant: Plant, q: Array) -> Array:
    """True joint torques that hold the arm, Nm, (N, n), at reported angles, rad, (N, n)."""
    bodies = Bodies(plant.geometry, plant.masses)
    ideal = gear_output(plant.drive, motor_angles(plant.drive, q), plant.geometry.zero)
    return bodies.gravity(ideal - static_load(plant, bodies, ideal) @ compliance_matrix(plant.drive))


if __name__ == "__main__":
    main()
