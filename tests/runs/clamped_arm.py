"""A clamped arm in this process: sweeps over the virtual robot's springs, friction and noise, without sockets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from experiments.plans import Cell, Plan
from experiments.runs.slips import SweepRows
from experiments.virtual_controller.arm import SAMPLE_S, Arm

DWELL = 1.2  # s at each step, of which the last 70 % are read
SHARE = 0.02


def sweeps_of(
    cell: Cell,
    plan: Plan,
    seed: int,
    *,
    stiffer: float = 1.0,
    rocks: Sequence[float] | None = None,
    since: int = 1,
    block: Sequence[float] = (0.0,) * 6,
) -> list[SweepRows]:
    """Readings of a plan's sweeps, in one clamping.

    Parameters
    ----------
    seed
        Which individual, noise and preload.
    stiffer
        By how much its springs are stiffer than drawn.
    rocks, since
        A tilt (3,), m, and the sweep, from 1, from which on the block rocks.
    block
        Its compliance (6,), m/N and rad/Nm.
    """
    arm = Arm(cell.robot, seed=seed, posture=plan.sweeps[0].posture)
    drive = replace(arm.plant.drive, spring=arm.plant.drive.spring * stiffer)
    arm.plant = replace(arm.plant, drive=drive, fixture=replace(arm.plant.fixture, compliance=np.array(block)))
    now, number, found = 1.0, 100, []
    arm.clamp(now)
    for k, sweep in enumerate(plan.sweeps, 1):
        if rocks is not None and k == since:
            arm.rock(now, rocks)
        torque, time = [], []
        for offset in sweep.offset:
            target = np.array(sweep.posture)
            target[sweep.joint] += offset
            now = arm.go(now, target, SHARE) + DWELL
            count = round(0.7 * DWELL / SAMPLE_S)
            number += count
            times = (now - SAMPLE_S * np.arange(count)[::-1]).tolist()
            torque.append(arm.read(times, list(range(number, number + count))).torque.mean(axis=0))
            time.append(now)
            number += round(0.3 * DWELL / SAMPLE_S)
        arm.tidy(now)
        turn = np.eye(6)[sweep.joint] @ np.linalg.inv(np.asarray(cell.robot.transmission))
        way = np.sign(np.diff(np.r_[0.0, sweep.offset]))
        found.append(SweepRows(k, np.array(time), np.array(sweep.offset), way, np.array(torque), np.abs(turn) > 1e-9))
    return found


def noisy_sweeps(plan: Plan, seed: int, memory: float = 0.5) -> list[SweepRows]:
    """Sweeps of one clamping in which torques are noise with a memory of so much from row to row, and a drift."""
    rng = np.random.default_rng(seed)
    found = []
    for number, sweep in enumerate(plan.sweeps, 1):
        offset = np.asarray(sweep.offset)
        white = rng.standard_normal((len(offset) + 50, 6))
        slow = np.zeros(6)
        rows = [slow := memory * slow + w for w in white][50:]
        size = np.array([0.1, 0.05, 0.05, 0.02, 0.02, 0.02])
        time = (number - 1) * 200.0 + 1.2 * np.arange(len(offset))
        torque = size * (np.array(rows) + 0.02 * (time[:, None] - time[0]) / 1.2)
        way = np.sign(np.diff(np.r_[0.0, offset]))
        turn = np.eye(6)[sweep.joint] @ np.linalg.inv(np.asarray(plan.cell.robot.transmission))
        found.append(SweepRows(number, time, offset, way, torque, np.abs(turn) > 1e-9))
    return found
