"""All tables in one fit against stage by stage, on rows that neither saw.

    python benchmarks/joint.py [--seeds 10] [--first 0] [--poses 100]

For every seed a robot is measured, a fifth of whole poses, runs and sweeps is held out, and both models are fitted. For
each stage: mean squared errors of the held-out units (poses, blocks of a log, blocks of a sweep) under both, their
paired difference, and its standard error; then springs and clearances of both against the truth. `identify --joint`
must not be worse by more than one standard error.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from coverage_table import TWO_SIDED_95

from clampid.effect import Stage
from clampid.fitting.accuracy import noise_floor, predicted, size_of
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.models.model import Model
from clampid.stages.fit_problem import fit_problem
from experiments.campaign import Campaign
from experiments.simulate import measured_campaign
from experiments.virtual_robot import measure
from kinematics.description import load_robot

STAGES: tuple[Stage, ...] = ("free_air", "clamped", "poses")


@dataclass(frozen=True)
class Paired:
    """Squared errors of held-out units ``(k,)`` under both models, in units of the noise."""

    apart: np.ndarray
    joint: np.ndarray

    @property
    def difference(self) -> float:
        """Joint less stage by stage, mean."""
        return float(np.mean(self.joint - self.apart))

    @property
    def error(self) -> float:
        """Standard error of it."""
        return float(np.std(self.joint - self.apart, ddof=1) / np.sqrt(len(self.apart)))

    @property
    def worse(self) -> float:
        """How much worse the joint model is, in standard errors; negative: better."""
        return self.difference / self.error if self.error > 0 else 0.0


def unit_errors(model: Model, campaign: Campaign, stage: Stage) -> tuple[np.ndarray, np.ndarray]:
    """Mean squared error ``(k,)`` of each held-out unit, in units of the noise, and the units' numbers."""
    opened = on_campaign(model, campaign)
    rows = opened.rows(stage)
    part = opened.stages[stage]
    held = np.flatnonzero(rows.in_folds(opened.held_out(stage)))
    floor = noise_floor(rows, predicted(fit_problem(rows, opened.effects, part.slots), part.theta))
    test = rows.take(held)
    residual = predicted(fit_problem(test, opened.effects, part.slots), part.theta)
    size, counts = size_of(test, residual, floor)
    if size.ndim == 1:
        size, counts = size[:, None] / floor.norm, counts[:, None]
    squares = np.where(counts, size**2, 0.0).sum(axis=1)
    units = np.unique(test.unit[counts.any(axis=1)])
    total = np.array([squares[test.unit == u].sum() / max(counts[test.unit == u].sum(), 1) for u in units])
    return total, units


def paired(apart: Model, joint: Model, campaign: Campaign) -> dict[Stage, Paired]:
    """Both models on the held-out rows of every stage."""
    out: dict[Stage, Paired] = {}
    for stage in STAGES:
        (a, units), (b, same) = (unit_errors(m, campaign, stage) for m in (apart, joint))
        both = np.isin(units, same)
        out[stage] = Paired(a[both], b[np.isin(same, units)])
    return out


def measured(seed: int, poses: int) -> tuple[Campaign, np.ndarray]:
    """A campaign without a folder and without a verification table, and its true springs and clearances ``(12,)``."""
    robot = load_robot("kuka_kr20_r1810")
    found = measure(robot, seed=seed, poses=poses, tables=("free_air", "wrist", "clamped", "poses"))
    drive = found.truth.plant.drive
    return measured_campaign(found, robot), np.r_[1.0 / drive.spring, drive.gap]


def drives(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Springs' compliances and clearances of the clamped stage ``(12,)`` and their standard errors."""
    stage = model.stages["clamped"]
    index = [k for e in ("joint_compliance", "backlash") for k, s in enumerate(stage.slots) if s.effect == e]
    return stage.theta[index], stage.std[index]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--poses", type=int, default=100)
    args = parser.parse_args()
    pooled: dict[Stage, list[Paired]] = {stage: [] for stage in STAGES}
    off: list[np.ndarray] = []
    gain: list[np.ndarray] = []
    for seed in range(args.first, args.first + args.seeds):
        campaign, true = measured(seed, args.poses)
        apart, joint = (
            identify(campaign, holdout=0.2, seed=seed),
            identify(campaign, holdout=0.2, seed=seed, joint=True),
        )
        (a, sa), (b, sb) = drives(apart), drives(joint)
        off.append(np.array([(a - true) / sa, (b - true) / sb]))
        gain.append(sb / sa)
        told = []
        for stage, pair in paired(apart, joint, campaign).items():
            if not len(pair.apart):  # a short log, of which chance held no run out
                continue
            pooled[stage].append(pair)
            told.append(f"{stage} {np.mean(pair.apart):.4f} {pair.difference:+.5f} ± {pair.error:.5f}")
        print(f"seed {seed}: {'; '.join(told)}", flush=True)
    for stage, pairs in pooled.items():
        whole = Paired(np.concatenate([p.apart for p in pairs]), np.concatenate([p.joint for p in pairs]))
        print(
            f"{stage}: squared error in units of noise {np.mean(whole.apart):.4f}, joint {np.mean(whole.joint):.4f}, "
            f"difference {whole.difference:+.5f} ± {whole.error:.5f}: {whole.worse:+.2f} standard errors"
        )
    inside = np.mean(np.abs(np.array(off)) < TWO_SIDED_95, axis=(0, 2))
    print(
        f"springs and clearances of the sweeps, 95 % intervals: stage by stage {inside[0]:.1%}, joint {inside[1]:.1%}"
    )
    names = [f"{what} {j + 1}" for what in ("spring", "clearance") for j in range(6)]
    shares = np.median(np.array(gain), axis=0)
    print(
        "standard errors, joint over stage by stage:",
        ", ".join(f"{n} {g:.2f}" for n, g in zip(names, shares, strict=True)),
    )


if __name__ == "__main__":
    main()
