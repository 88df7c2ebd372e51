"""A torque table as arrays for judging it: thinned, with speeds and accelerations, and its moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from experiments.campaign import Campaign
from experiments.columns import joint_columns
from experiments.signals import acceleration, accelerations, choose_window, low_pass, rest_threshold, speeds
from experiments.signals.typing_ import Array, Bools, Integers
from kinematics.gravity import gravity_regressor

__all__ = ["MovingLog", "clear_moves", "freed", "moving_logs", "read_log", "weight_regressor"]

# A table is judged on at most this many rows, smoothed and thinned: a check should not take longer than a fit.
ROWS = 12_000
MIN_ROWS = 120  # fewer rows than this hold no moves to judge by
# Singular value relative to the largest: below it a direction is rounding.
NEGLIGIBLE_SINGULAR_VALUE = 1e-8
# Rows at either end of a move in which friction builds up.
BUILD_UP = 2


@dataclass(frozen=True)
class MovingLog:
    """A torque table as arrays: step [s], time ``(N,)`` [s], run ``(N,)``; q, qd, qdd, tau ``(N, n)``."""

    step: float
    time: Array
    run: Integers
    q: Array
    qd: Array
    qdd: Array
    tau: Array


def moving_logs(campaign: Campaign) -> dict[str, MovingLog]:
    """The torque tables of a campaign that are long enough to be judged, by name."""
    tables = {table: campaign.tables[table] for table in ("free_air", "wrist") if table in campaign.tables}
    return {table: read_log(campaign, frame) for table, frame in tables.items() if len(frame) >= MIN_ROWS}


def read_log(campaign: Campaign, frame: pd.DataFrame) -> MovingLog:
    """Read a table ``free_air`` or ``wrist``."""
    n = campaign.robot.n

    def take(pattern: str) -> Array:
        return frame[list(joint_columns(pattern, n))].to_numpy(dtype=np.float64)

    time, run = frame["time_s"].to_numpy(dtype=np.float64), frame["run"].to_numpy(dtype=np.int64)
    q, tau = take("q{}_rad"), take("tau{}_Nm")
    steps = np.diff(time)[run[1:] == run[:-1]]
    step = float(np.median(steps)) if steps.size else 1.0
    if "qd1_rad_s" in frame:
        qd = take("qd{}_rad_s")
        qdd = acceleration(qd, time, run)
    else:
        window = choose_window(q, time, run, 2)
        qd, qdd = speeds(q, time, run, window), accelerations(q, time, run, window)
    every = -(-len(time) // ROWS)
    if every > 1:
        q, qd, qdd, tau = (low_pass(v, time, run, 2 * every * step)[::every] for v in (q, qd, qdd, tau))
        time, run = time[::every], run[::every]
    return MovingLog(step, time, run, q, qd, qdd, tau)


def weight_regressor(campaign: Campaign, q: Array) -> Array:
    """Joint torques of weight, linear in the links' masses and moments ``(N, n, 4n)``."""
    robot = campaign.robot
    linkage = np.asarray(robot.linkage)
    return np.asarray(linkage.T @ gravity_regressor(robot.screws, q @ linkage.T, campaign.gravity))


def clear_moves(speed: Array, run: Integers) -> tuple[Bools, Integers]:
    """Rows ``(N,)`` of clear motion of one motor of speed ``(N,)``, away from starts and stops, and their moves."""
    limit = max(float(rest_threshold(speed[:, None])[0]), 0.02 * float(np.abs(speed).max(initial=0.0)))
    sign = np.where(np.abs(speed) > limit, np.sign(speed), 0.0)
    new = np.r_[True, (sign[1:] != sign[:-1]) | (run[1:] != run[:-1])]
    move = np.cumsum(new)
    first = np.flatnonzero(new)
    last = np.r_[first[1:], len(speed)] - 1
    index = np.arange(len(speed))
    used = (sign != 0.0) & (index >= first[move - 1] + BUILD_UP) & (index <= last[move - 1] - BUILD_UP)
    return used, move


def freed(others: Array, columns: Array) -> Array:
    """Columns ``(N, p)`` with their projection on the other columns ``(N, h)`` removed."""
    scale = np.sqrt(np.mean(others**2, axis=0))
    basis = np.linalg.svd(others / np.where(scale > 0.0, scale, 1.0), full_matrices=False)
    kept = basis.U[:, NEGLIGIBLE_SINGULAR_VALUE * basis.S[0] < basis.S]
    return np.asarray(columns - kept @ (kept.T @ columns))
