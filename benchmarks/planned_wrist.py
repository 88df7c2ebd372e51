"""Arm-side friction of a coupled wrist: its standard error from a planned program and from a usual one.

    python benchmarks/planned_wrist.py [--seeds 40]

`clampid plan wrist` makes one program of ten minutes for the nominal robot, and says which standard errors to expect of
it. Individual robots run it; they also run free air and a wrist program that is not planned, of a few swings. Friction
of joints 5 and 6 at the motor's and at the arm's side is printed for both: what the plan expected, what the fit states,
how far off it is, and how often the 95 % interval holds the truth. Joint 4 and its motor only turn together, so that
its two sides cannot be distinguished by any program; it is counted how often that is said.
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import numpy.typing as npt
from coverage_table import TWO_SIDED_95

from clampid.identification.identify import identify
from clampid.models.model import StageModel
from clampid.planning.logs import torque_noise_of
from clampid.planning.program import LogWishes
from clampid.planning.wrist import plan_wrist
from experiments.campaign import read_campaign
from experiments.plans import Plan, cell_of, limits_of, read_plan, write_plan
from experiments.plans.virtual import VirtualRobot, run_virtually
from experiments.simulate import measured_campaign
from experiments.virtual_robot import measure
from kinematics.description import load_robot

ROBOT = "kuka_kr20_r1810"
ASKED = {
    "Fc joint 5": ("coulomb_friction", "Fc", "joint5"),
    "F joint 5": ("wrist_coupling_friction", "F", "joint5"),
    "Fc joint 6": ("coulomb_friction", "Fc", "joint6"),
    "F joint 6": ("wrist_coupling_friction", "F", "joint6"),
}
TOGETHER = ("wrist_coupling_friction", "F", "joint4")


@dataclass(frozen=True)
class Told:
    """What one fit says of `ASKED`: error and standard error ``(4,)``, Nm; whether it claims to know joint 4's F."""

    error: npt.NDArray[np.float64]
    std: npt.NDArray[np.float64]
    claimed: bool


def main() -> None:
    """Print a table for either program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    plan = planned()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    with TemporaryDirectory() as folder, ProcessPoolExecutor(arguments.processes) as pool:
        path = Path(folder) / "wrist.toml"
        write_plan(plan, path)
        both = list(pool.map(partial(trial, path), seeds))
    print(f"{len(both)} robots; Nm at the motor (Fc) and at the joint (F)")
    for name, told, expected in (
        ("planned", [b[0] for b in both], promised(plan)),
        ("not planned", [b[1] for b in both], None),
    ):
        print(f"{name}:\n{table(told, expected)}")


def planned(time: float = 600.0) -> Plan:
    """The plan, with the noise and the speeds that `clampid plan wrist` takes by itself."""
    cell = cell_of(ROBOT)[0]
    return plan_wrist(cell, limits_of(cell.robot)[0], torque_noise_of(cell, None, None)[0], LogWishes(time=time))


def promised(plan: Plan) -> npt.NDArray[np.float64]:
    """Standard errors of `ASKED` that the plan expects ``(4,)``."""
    assert plan.expected is not None
    std = {p.name: p.std for p in plan.expected.parameters}
    return np.array([std[f"{effect}.{parameter}@{place}"] for effect, parameter, place in ASKED.values()])


def trial(path: Path, seed: int) -> tuple[Told, Told]:
    """One robot, identified from the planned program and from one that is not."""
    plan, robot = read_plan(path), load_robot(ROBOT)
    friction = VirtualRobot(robot, seed=seed).session.plant.friction
    frictions = {"Fc": friction.coulomb, "F": friction.arm}
    truth = np.array([frictions[parameter][int(place[-1]) - 1] for _, parameter, place in ASKED.values()])
    with TemporaryDirectory() as folder:
        by_plan = identify(read_campaign(run_virtually(plan, Path(folder) / "campaign", seed=seed)))
    usual = identify(measured_campaign(measure(robot, seed=seed, tables=("free_air", "wrist")), robot))
    return told(by_plan.stages["free_air"], truth), told(usual.stages["free_air"], truth)


def told(stage: StageModel, truth: npt.NDArray[np.float64]) -> Told:
    """What a fit says; a parameter that it has not is unknown."""
    index = {(s.effect, s.parameter, s.place): k for k, s in enumerate(stage.slots)}
    std = np.sqrt(np.diag(stage.covariance))
    at = [index[asked] for asked in ASKED.values()]
    return Told(stage.theta[at] - truth, std[at], bool(stage.identified[index[TOGETHER]]))


def table(told: list[Told], expected: npt.NDArray[np.float64] | None) -> str:
    """One line a parameter."""
    error, std = (np.array([getattr(t, name) for t in told]) for name in ("error", "std"))
    lines = [f"{'':12}{'expected':>10}{'stated (median)':>17}{'rms error':>11}{'covered':>10}"]
    for k, name in enumerate(ASKED):
        plan = "" if expected is None else f"{expected[k]:.3f}"
        held = 100 * np.mean(np.abs(error[:, k]) < TWO_SIDED_95 * std[:, k])
        rms = np.sqrt(np.mean(error[:, k] ** 2))
        lines.append(f"{name:12}{plan:>10}{np.median(std[:, k]):17.3f}{rms:11.3f}{held:8.1f} %")
    lines.append(f"joint 4's sides said to be told together only: {sum(not t.claimed for t in told)} of {len(told)}")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
