"""Programmes of free-air logs: trapezoids of speed between postures, and Fourier excitation, at several speeds."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from experiments.second_world.arms import Arm
from experiments.second_world.arrays import Array, stream
from experiments.second_world.individual import Robot

__all__ = ["LOG_PROGRAMS", "Log", "LogProgram", "run_log"]


@dataclass(frozen=True)
class LogProgram:
    """A programme of runs in free air."""

    kind: str  # "trapezoids" or "fourier"
    rate_Hz: float
    speeds: tuple[float, ...]  # of each run, as a share of full speed
    worked_before_s: tuple[float, ...]  # how long the robot has worked since it was cold, at the start of each run
    size: float  # number of motions (trapezoids), or seconds (fourier)
    speeds_recorded: bool  # whether the table has qd columns


LOG_PROGRAMS: dict[str, LogProgram] = {
    "trapezoids_10hz": LogProgram("trapezoids", 10.0, (1.0, 0.8), (1200.0, 1500.0), 70, False),
    "trapezoids_250hz": LogProgram("trapezoids", 250.0, (0.7, 0.35), (900.0, 1000.0), 12, True),
    "five_speeds": LogProgram(
        "trapezoids", 20.0, (1.0, 0.4, 0.16, 0.06, 0.025), (0.0, 90.0, 200.0, 400.0, 800.0), 14, True
    ),
    "fourier_100hz": LogProgram("fourier", 100.0, (0.8, 0.5, 0.3), (300.0, 400.0, 500.0), 30.0, True),
    "fourier_1khz": LogProgram("fourier", 1000.0, (0.7, 0.45), (600.0, 640.0), 12.0, True),
    "warm_up": LogProgram(
        "trapezoids", 10.0, (0.8, 0.8, 0.8, 0.8, 0.8, 0.8), (0.0, 400.0, 900.0, 1600.0, 2600.0, 4000.0), 20, False
    ),
    "two_warmths": LogProgram("trapezoids", 10.0, (0.9, 0.5, 0.9, 0.5), (0.0, 90.0, 3600.0, 3700.0), 30, False),
}


@dataclass(frozen=True)
class Log:
    """All runs of a log, one after the other; S samples."""

    run: Array  # (S,)
    time_s: Array  # (S,)
    work_s: Array  # (S,)
    q: Array  # (S, n) rad
    qd: Array  # (S, n) rad/s
    qdd: Array  # (S, n) rad/s²


Motion = tuple[Array, Array, Array]


def _trapezoid(a: Array, b: Array, speed: Array, dt: float, offset: float) -> tuple[Motion, float]:
    """
    Move from a to b (n,) with all joints in step, wait, and sample at multiples of dt from offset.

    Returns the motion (S, n) and how far the next sample is beyond the end, s.
    """
    way = np.abs(b - a)
    ramp = 0.25  # s to full speed
    v = float(np.min(speed / np.maximum(way, 1e-9)))  # 1/s: share of the way per second
    ramp = min(ramp, 1.0 / v)
    cruise = 1.0 / v - ramp
    end = 2 * ramp + cruise
    t = np.arange(offset, end + 0.4, dt)
    acc = v / ramp
    u = np.clip(t, 0.0, end)
    up, down = u < ramp, u > end - ramp
    s = np.where(up, acc * u**2 / 2, np.where(down, 1 - acc * (end - u) ** 2 / 2, v * (u - ramp / 2)))
    sd = np.where(up, acc * u, np.where(down, acc * (end - u), v))
    sdd = np.where(t >= end, 0.0, np.where(up, acc, np.where(down, -acc, 0.0)))
    go = (b - a)[None]
    return (a + s[:, None] * go, sd[:, None] * go, sdd[:, None] * go), float(t[-1] + dt - end - 0.4)


def _trapezoids(arm: Arm, stops: Array, share: float, rate: float) -> Motion:
    parts, offset = [], 0.0
    for a, b in pairwise(stops):
        motion, offset = _trapezoid(a, b, share * 0.9 * arm.max_speeds(), 1.0 / rate, offset)
        parts.append(motion)
    q, qd, qdd = (np.concatenate(p) for p in zip(*parts, strict=True))
    return q, qd, qdd


def _fourier(arm: Arm, rng: np.random.Generator, share: float, rate: float, seconds: float) -> Motion:
    """Sum of five harmonics of a period of ten seconds over the share of speed; the acceleration is continuous."""
    low, high = np.clip(arm.limits(), -2.6, 2.6)
    t = np.arange(0.0, seconds, 1.0 / rate)
    w = 2 * np.pi * share / 10.0 * np.arange(1, 6)  # (5,)
    a, b = rng.standard_normal((2, 5, arm.n)) / np.sqrt(np.arange(1, 6))[None, :, None]
    sine, cosine = np.sin(t[:, None] * w), np.cos(t[:, None] * w)  # (S, 5)
    q = sine @ a + cosine @ b
    qd = (cosine * w) @ a - (sine * w) @ b
    qdd = -(sine * w**2) @ a - (cosine * w**2) @ b
    middle = (q.max(0) + q.min(0)) / 2
    room = 0.8 * (high - low) / (q.max(0) - q.min(0))
    fast = 0.9 * arm.max_speeds() / np.abs(qd).max(0)
    gain = np.minimum(room, fast)
    return (low + high) / 2 + gain * (q - middle), gain * qd, gain * qdd


def run_log(robot: Robot, program: LogProgram, seed: int) -> Log:
    """
    Run a programme in free air.

    Parameters
    ----------
    robot, program
        Who does what.
    seed
        Where the random choices come from.

    Returns
    -------
    Log
        On one clock; between runs it goes on with the work that is not logged.
    """
    arm = robot.nominal
    rng = stream(seed, "log programme")
    low, high = np.clip(arm.limits(), -2.6, 2.6)
    stops = (low + high) / 2 + 0.42 * (high - low) * rng.uniform(-1, 1, (int(program.size) + 1, arm.n))
    runs: list[tuple[Array, ...]] = []
    worked = 0.0
    for k, (share, before) in enumerate(zip(program.speeds, program.worked_before_s, strict=True), start=1):
        if program.kind == "trapezoids":
            motion = _trapezoids(arm, stops, share, program.rate_Hz)
        else:
            motion = _fourier(arm, rng, share, program.rate_Hz, program.size)
        worked = max(worked + 5.0, before)
        time = worked + np.arange(len(motion[0])) / program.rate_Hz
        runs.append((np.full(len(time), float(k)), time - program.worked_before_s[0], time, *motion))
        worked = float(time[-1])
    return Log(*(np.concatenate(part) for part in zip(*runs, strict=True)))
