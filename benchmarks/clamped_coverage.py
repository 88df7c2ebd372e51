"""Coverage of the standard errors of clearances and springs from clamped sweeps, over many virtual robots.

    python benchmarks/clamped_coverage.py [--seeds 200] [--first 0] [--jobs 1]

For every seed an individual robot is drawn and its sixteen sweeps are measured and fitted, twice: as it is, and with
clearances set to known multiples of the detection limit that the first fit printed. Prints, joint by joint, how often
the 95 % intervals hold the truth, for springs, clearances, friction and the wrist's cross terms; how often a clearance
is told from zero; and how the printed limit compares with the scatter of the estimates. `--naive` reads T the other way
round (θ_motor = T·θ_joint), which must fail.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from multiprocessing import get_context
from time import perf_counter

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from coverage_table import TWO_SIDED_95, coverage

from clampid.catalogue import catalogue
from clampid.identification.fitted_stage import fit_stage
from clampid.identification.identify import stage_rows
from clampid.models.drives import DETECTION, Drives, drives_of
from clampid.slots import Term
from clampid.stages.layout import layout_of
from experiments.simulate import measured_campaign
from experiments.virtual_robot import Plant, measure
from kinematics.description import load_robot
from kinematics.robot import RobotDescription

WRIST = ((3, 4), (3, 5), (4, 5))  # the cross terms of the compliance matrix
SMALL, LARGE = 0.5, 3.0  # detection limits: up to the first nothing must be told from zero, beyond the second all


@dataclass(frozen=True)
class Trial:
    """What one fit said, and the truth: rows of `found`, `std`, `true` are c, gap, Fc, and the wrist's cross terms."""

    seed: int
    drives: Drives
    found: np.ndarray  # (21,)
    std: np.ndarray
    true: np.ndarray
    seconds: float

    @property
    def off(self) -> np.ndarray:
        """Errors in standard errors."""
        return (self.found - self.true) / self.std


def naive_robot(robot: RobotDescription) -> RobotDescription:
    """The same robot with T read as θ_motor = T·θ_joint, that is, with T⁻ᵀ where T belongs."""
    return replace(robot, transmission=np.linalg.inv(np.asarray(robot.transmission)).T)


def trial(seed: int, alter: Callable[[Plant], Plant] = lambda plant: plant, naive: bool = False) -> Trial:
    """Measure and fit the sweeps of one seed."""
    robot = load_robot("kuka_kr20_r1810")
    measured = measure(robot, seed=seed, tables=("clamped",), alter=alter)
    campaign = measured_campaign(measured, naive_robot(robot) if naive else robot)
    rows = stage_rows([campaign], layout_of([campaign]), "clamped")
    start = perf_counter()
    terms = [Term(name) for name in ("joint_compliance", "backlash", "coulomb_friction")]
    drives = drives_of(fit_stage(rows, catalogue(), terms, {}).model, campaign.robot)
    seconds = perf_counter() - start
    plant = measured.truth.plant
    T, c = plant.drive.transmission, 1.0 / plant.drive.spring
    C = T.T @ np.diag(c) @ T
    a, b = np.array(WRIST).T
    return Trial(
        seed,
        drives,
        np.r_[1.0 / drives.stiffness, drives.gap, drives.friction, drives.compliance[a, b]],
        np.r_[
            drives.stiffness_std / drives.stiffness**2, drives.gap_std, drives.friction_std, drives.compliance_std[a, b]
        ],
        np.r_[c, plant.drive.gap, plant.friction.coulomb, C[a, b]],
        seconds,
    )


def with_gaps(gap: np.ndarray) -> Callable[[Plant], Plant]:
    """Give every joint the clearance ``gap`` ``(6,)``, rad."""
    return lambda plant: replace(plant, drive=replace(plant.drive, gap=gap))


def multiples(seed: int) -> np.ndarray:
    """Clearances in detection limits ``(6,)``: half of the joints below `SMALL`, half at `LARGE`."""
    rng = np.random.default_rng([seed, 4])
    return np.where(rng.permutation(6) < 3, rng.uniform(0.0, SMALL, 6), LARGE)


def pair(seed: int) -> tuple[Trial, Trial]:
    """The robot as it is, and with clearances set to multiples of the detection limits that were printed for it."""
    first = trial(seed)
    return first, trial(seed, with_gaps(multiples(seed) * first.drives.gap_limit))


def covered(trials: Sequence[Trial]) -> np.ndarray:
    """Share of seeds ``(21,)`` whose 95 % interval holds the truth."""
    return np.mean([np.abs(t.off) < TWO_SIDED_95 for t in trials], axis=0)


def told(trials: Sequence[Trial]) -> tuple[np.ndarray, np.ndarray]:
    """Whether clearances below `SMALL` and at `LARGE` times the limit were told from zero, one entry each."""
    seen = np.array([t.drives.gap_identified for t in trials])
    size = np.array([multiples(t.seed) for t in trials])
    return seen[size <= SMALL], seen[size >= LARGE]


def limit_ratio(trials: Sequence[Trial]) -> np.ndarray:
    """Printed detection limit over the empirical one ``(6,)``.

    Empirical is the scatter of estimates about clearances too large for the bound at zero to cut them off.
    """
    size = np.array([multiples(t.seed) for t in trials])
    error = np.array([t.found[6:12] - t.true[6:12] for t in trials])
    limit = np.array([t.drives.gap_limit for t in trials])
    out = []
    for j in range(6):
        large = size[:, j] >= LARGE
        out.append(np.sqrt(np.mean(limit[large, j] ** 2)) / (DETECTION * np.sqrt(np.mean(error[large, j] ** 2))))
    return np.array(out)


def names() -> list[str]:
    """What the entries of `Trial.found` are."""
    per_joint = [f"{what} {j + 1}" for what in ("spring", "clearance", "friction") for j in range(6)]
    return per_joint + [f"compliance {a + 1}-{b + 1}" for a, b in WRIST]


def show(pairs: Sequence[tuple[Trial, Trial]]) -> None:
    first, second = [p[0] for p in pairs], [p[1] for p in pairs]
    share = covered(first)
    relative = np.median([t.std / np.abs(t.true) for t in first], axis=0)
    print(f"{len(first)} seeds; fit {np.median([t.seconds for t in first]):.2f} s (median)")
    print(coverage([dict(zip(names(), t.off, strict=True)) for t in first]).table())
    print("standard error over value, median: " + ", ".join(f"{x:.2%}" for x in relative[:12]))
    print(
        f"pooled: springs and clearances {share[:12].mean():.1%}, springs {share[:6].mean():.1%}, clearances "
        f"{share[6:12].mean():.1%}, friction {share[12:18].mean():.1%}, cross terms {share[18:].mean():.1%}"
    )
    signs = np.array([np.sign(t.found[18:]) == np.sign(t.true[18:]) for t in first])
    print(f"cross terms of the right sign: {signs.mean():.1%}")
    small, large = told(second)
    print(f"told from zero below {SMALL} limits: {small.mean():.1%} of {small.size}")
    print(f"told from zero at {LARGE} limits: {large.mean():.1%} of {large.size}")
    limits = np.degrees(np.median([t.drives.gap_limit for t in first], axis=0))
    print(f"detection limits, median: {', '.join(f'{x:.4f}' for x in limits)} deg")
    print(f"printed over empirical limit: {', '.join(f'{r:.2f}' for r in limit_ratio(second))}")


def show_naive(seeds: Sequence[int]) -> None:
    trials = [trial(seed, naive=True) for seed in seeds]
    signs = np.array([np.sign(t.found[18:]) == np.sign(t.true[18:]) for t in trials])
    print(f"T read as θ_motor = T·θ_joint, {len(trials)} seeds:")
    print(f"cross terms covered: {covered(trials)[18:].mean():.1%}, of the right sign: {signs.mean():.1%}")
    print(f"clearances told from zero: {np.mean([t.drives.gap_identified for t in trials]):.1%}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--naive", action="store_true")
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.seeds)
    if args.naive:
        show_naive(seeds)
    elif args.jobs > 1:
        with get_context("spawn").Pool(args.jobs) as pool:
            show(pool.map(pair, seeds, chunksize=4))
    else:
        show([pair(seed) for seed in seeds])


if __name__ == "__main__":
    main()
