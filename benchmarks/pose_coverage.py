"""Coverage of the standard errors of geometry, springs and clearances: seven kinds of arm, many robots of each.

    python benchmarks/pose_coverage.py [--seeds 200] [--arms kuka_kr16_2,scara] [--errors FILE.csv]

Every individual has its own geometry, masses, springs, clearances and friction, and is measured in free air, at the
wrist and at 250 poses of three targets; `identify` fits the standard set. Springs, clearances and friction are compared
with what they are. Geometry is compared in the fit's own gauge: since 6 numbers a link are more than can be told, the
true screws, flange and targets are first expressed in the parameters that the fit has kept, as those that reproduce the
noise-free points; what is left of these is printed. Only what `identify` calls identified is compared. Prints the share
of 95 % intervals that hold the truth, and the error on other poses, of which no noise is part.
"""

from __future__ import annotations

import argparse
import csv
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import numpy.typing as npt
from coverage_table import coverage
from virtual_arms import ARMS, arm

from clampid.catalogue import catalogue
from clampid.identification.identify import identify, stage_rows
from clampid.models.model import StageModel
from clampid.slots import Slot
from clampid.stages.fit_problem import fit_problem
from clampid.stages.rows import Rows
from experiments.simulate import measured_campaign
from experiments.virtual_robot import Measured, Plant, measure
from kinematics.robot import RobotDescription

Array = npt.NDArray[np.float64]
TABLES = ("free_air", "wrist", "poses", "verification")
BETWEEN_ARMS = 10_000  # seeds
GAUGE_STEPS = 8  # Newton's method: each step squares the error
COMMON = 0.5  # a parameter that fewer individuals identify is not in the table


@dataclass(frozen=True)
class Trial:
    """One individual.

    Attributes
    ----------
    errors
        By parameter: error over standard error.
    inexpressible
        Rms of the noise-free points that no geometry of the model reproduces, m.
    elsewhere, instrument
        Rms error of predicted points at other poses, and the instrument's standard deviation, m.
    """

    seed: int
    errors: dict[str, float]
    inexpressible: float
    elsewhere: float
    instrument: float
    seconds: float


def main() -> None:
    """Print a table for each arm, and one line of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--arms", default=",".join(ARMS))
    parser.add_argument("--errors", type=Path, help="write every error over its standard error as CSV")
    arguments = parser.parse_args()
    every: dict[str, list[Trial]] = {name: [] for name in arguments.arms.split(",")}
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        for name, trials in every.items():
            trials.append(trial(name, seed))
        if arguments.errors is not None:
            write_errors(arguments.errors, every)
    for name, trials in every.items():
        show(name, trials)
    print("all arms: " + coverage([together(every, k) for k in range(arguments.seeds)], COMMON).summary)


def trial(name: str, seed: int) -> Trial:
    """Measure and identify one individual, and compare."""
    start = process_time()
    robot = arm(name)
    # Of the same seed, two arms would have the same noise, and their errors would be the same.
    measured = measure(robot, seed=ARMS.index(name) * BETWEEN_ARMS + seed, tables=TABLES)
    campaign = measured_campaign(measured, robot)
    model = identify(campaign)
    base = {0: model.sessions[0].base_reference}
    rows = {t: stage_rows([campaign], model.layout, "poses", base, t) for t in ("poses", "verification")}
    rows = {t: replace(r, measured=measured.truth.noise_free[t]) for t, r in rows.items()}
    stage = model.stages["poses"]
    truth, left = true_parameters(rows["poses"], stage, measured, robot)
    told = [k for k, (ok, slot) in enumerate(zip(stage.identified, stage.slots, strict=True)) if ok and compared(slot)]
    return Trial(
        seed,
        {stage.slots[k].label: float((stage.theta[k] - truth[k]) / stage.std[k]) for k in told},
        left,
        rms(fit_problem(rows["verification"], catalogue(), stage.slots, stage.lean).residual(stage.theta)[0]),
        measured.truth.plant.instrument.sigma,
        process_time() - start,
    )


def compared(slot: Slot) -> bool:
    """Masses are the torque stage's, see torque_coverage.py."""
    return slot.effect != "gravity"


def true_parameters(rows: Rows, stage: StageModel, measured: Measured, robot: RobotDescription) -> tuple[Array, float]:
    """The truth in the parameters that a fit has, SI, and the rms of what geometry cannot reproduce, m.

    Parameters
    ----------
    rows
        Poses with the noise-free points as measured.
    stage
        The fit: its parameters ``(P,)`` and its lean.
    """
    known, slots = plant_values(measured.truth.plant, robot), stage.slots
    theta = np.array([known.get(slot, 0.0) for slot in slots])
    geometry = np.array([slot.effect == "geometry" for slot in slots])
    trial = fit_problem(rows, catalogue(), slots, stage.lean)
    for _ in range(GAUGE_STEPS):
        residual, jacobian = trial.residual(theta)
        columns = jacobian[:, :, geometry].reshape(-1, int(geometry.sum()))
        size = np.linalg.norm(columns, axis=0)
        theta[geometry] += np.linalg.lstsq(columns / size, residual.ravel(), rcond=None)[0] / size
    return theta, rms(trial.residual(theta)[0])


def plant_values(plant: Plant, robot: RobotDescription) -> Mapping[Slot, float]:
    """What springs, clearances, friction and masses of an individual are, as parameters of the effects."""
    values: dict[Slot, float] = {}
    for j in range(plant.n):
        at = f"joint{j + 1}"
        values[Slot("joint_compliance", "c", at)] = 1.0 / plant.drive.spring[j]
        values[Slot("backlash", "gap", at)] = plant.drive.gap[j]
        values[Slot("wrist_coupling_friction", "F", at)] = plant.friction.arm[j]
        true, link = plant.masses, robot.links[j]
        beyond = np.r_[true.link[j] - link.mass, true.link[j] * true.com[j] - link.mass * np.asarray(link.com)]
        for name, value in zip(("m", "mx", "my", "mz"), beyond, strict=True):
            values[Slot("gravity", name, f"link{j + 1}")] = value
    return values


def rms(residual: Array) -> float:
    """Root mean square of the rows' norms."""
    return float(np.sqrt(np.mean(np.sum(residual[:, :3] ** 2, axis=1))))


def show(name: str, trials: Sequence[Trial]) -> None:
    """Print one arm's table."""
    found = coverage([t.errors for t in trials], COMMON)
    print(f"{name}: {len(trials)} individuals, {np.median([t.seconds for t in trials]):.1f} s of the processor each")
    print(found.table())
    print(f"{name}: {found.summary}")
    print(f"{name}: inexpressible at most {1e6 * max(t.inexpressible for t in trials):.2f} µm", end="; ")
    ratio = [t.elsewhere / t.instrument for t in trials]
    print(f"error at other poses over the instrument's: median {np.median(ratio):.2f}, largest {max(ratio):.2f}\n")


def together(every: Mapping[str, Sequence[Trial]], k: int) -> dict[str, float]:
    """Errors of the k-th individual of every arm, under the arm's name."""
    return {f"{name} {label}": z for name, trials in every.items() for label, z in trials[k].errors.items()}


def write_errors(path: Path, every: Mapping[str, Sequence[Trial]]) -> None:
    """Every error over its standard error, one line each."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["arm", "seed", "parameter", "error_over_std"])
        for name, trials in every.items():
            writer.writerows([name, t.seed, label, f"{z:.4f}"] for t in trials for label, z in t.errors.items())


if __name__ == "__main__":
    main()
