"""The measuring programs: the commanded motions and their times, for the nominal robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from experiments.virtual_robot.description import Array
from experiments.virtual_robot.sampling import Site

Integers = npt.NDArray[np.int64]
LOG_RATE = 10.0  # Hz, of the torque logs
DWELL = 2.0  # s, at each configuration of free-air programs
TARGET_TIME = 3.0  # s, for each tracked point
SWEEP_ROWS = 160


@dataclass(frozen=True)
class Path:
    """Moves through ``knots`` (m+1, n) in ``duration`` (m,) s with quintic speed, at rest ``dwell`` s at each knot."""

    knots: Array
    duration: Array
    dwell: float

    @property
    def length(self) -> float:
        """Time from start to end, s."""
        return float(np.sum(self.duration) + self.dwell * len(self.knots))

    def at(self, time: Array) -> tuple[Array, Array, Array]:
        """Return joint angles, speeds and accelerations, rad and s, (N, n), at times, s, (N,)."""
        start = self.dwell + np.concatenate([[0.0], np.cumsum(self.duration + self.dwell)[:-1]])
        k = np.clip(np.searchsorted(start, time, side="right") - 1, 0, len(start) - 1)
        T = self.duration[k]
        u = np.clip((time - start[k]) / T, 0.0, 1.0)
        moving = (u > 0) & (u < 1)
        s = u**3 * (10 - 15 * u + 6 * u**2)
        ds = np.where(moving, 30 * u**2 * (1 - u) ** 2, 0.0) / T
        dds = np.where(moving, 60 * u * (1 - u) * (1 - 2 * u), 0.0) / T**2
        step = self.knots[k + 1] - self.knots[k]
        return self.knots[k] + s[:, None] * step, ds[:, None] * step, dds[:, None] * step


class Course(Protocol):
    """Any motion that a run can follow: one of ours, or one that a plan from outside gives."""

    @property
    def knots(self) -> Array:
        """Where it stops, rad, (m+1, n)."""

    @property
    def length(self) -> float:
        """Time from start to end, s."""

    def at(self, time: Array) -> tuple[Array, Array, Array]:
        """Return joint angles, speeds and accelerations, rad and s, (N, n), at times, s, (N,)."""


@dataclass(frozen=True)
class Run:
    """One logged program: its path, and when it starts on the clock of its table, s."""

    path: Course
    start: float


def _path(knots: Array, speed: Array, dwell: float) -> Path:
    """Return the path whose leading joint just reaches its ``speed``, rad/s, (n,), in every move."""
    travel = np.abs(np.diff(knots, axis=0))
    return Path(knots, np.maximum(np.max(1.875 * travel / speed, axis=1), 0.5), dwell)


def _follow(paths: list[Path], pause: float) -> tuple[Run, ...]:
    runs, clock = [], 0.0
    for path in paths:
        runs.append(Run(path, round(clock, 3)))
        clock += np.ceil(path.length * LOG_RATE) / LOG_RATE + pause
    return tuple(runs)


def free_air_program(site: Site, rng: np.random.Generator) -> tuple[Run, ...]:
    """Return two runs through the same configurations, at full and at 80 % of the program's speed."""
    knots = site.configurations(int(rng.integers(44, 53)), 0.7, 2.5, rng)
    # A slow program: gravity and friction are wanted, not inertia.
    speed = np.maximum(0.13 * site.speed, np.minimum(0.35, 0.5 * site.speed))
    return _follow([_path(knots, speed, DWELL), _path(knots, 0.8 * speed, DWELL)], pause=600.0)


def wrist_program(site: Site, rng: np.random.Generator) -> tuple[Run, ...]:
    """Return runs in which one wrist joint turns alone, and runs in which one wrist motor does, at two speeds each."""
    T = np.array(site.robot.transmission, dtype=float)
    n = len(T)
    centre = site.postures(1, rng)[0]
    paths = []
    for i in range(max(n - 3, 1), n):
        swing = min(1.5, 0.8 * float(site.half[i] - abs(centre[i] - site.middle[i])))
        alone = np.eye(n)[i]
        shaft = T.T @ alone / T[i, i]  # joints move like this when only motor i turns
        for direction in (alone, shaft):
            for share in (0.15, 0.07):
                knots = centre + swing * np.array([0.0, 1.0, -1.0, 0.0])[:, None] * direction
                paths.append(_path(knots, share * site.speed, 1.0))
    return _follow(paths, pause=5.0)


@dataclass(frozen=True)
class ClampProgram:
    """Sweeps of a clamped robot; rows as logged, one per second."""

    posture: Array  # (e, n) rad, of each clamping
    direction: Array  # (e, n) ±1, from where each joint came there
    preload: Array  # (e, n) 1, random part of what clamping forces on the joints
    event: Integers  # (N,) which clamping
    sweep: Integers  # (N,) from 1
    joint: Integers  # (N,) from 0
    level: Array  # (N,) −1 … 1, share of the joint's amplitude
    time: Array  # (N,) s


def clamp_program(site: Site, rng: np.random.Generator) -> ClampProgram:
    """Return sweeps of every joint in two postures, and of the inner joints again after clamping anew."""
    n = len(site.half)
    two = site.postures(2, rng)
    plan = [(0, range(n)), (1, range(n)), (2, range(1, n - 1))]
    quarter = SWEEP_ROWS // 8
    up = np.arange(1, quarter + 1) / quarter
    once = np.concatenate([up, 1 - up, -up, up - 1])
    level = np.concatenate([once, once])
    event, sweep, joint, time = [], [], [], []
    clock, number = 0.0, 0
    for e, joints in plan:
        for j in joints:
            number += 1
            rows = len(level)
            event += [e] * rows
            sweep += [number] * rows
            joint += [j] * rows
            time += list(clock + np.arange(rows))
            clock += rows + 20.0
        clock += 600.0
    count = len(plan)
    return ClampProgram(
        posture=two[[0, 1, 0]],
        direction=rng.choice([-1.0, 1.0], (count, n)),
        preload=rng.standard_normal((count, n)),
        event=np.array(event),
        sweep=np.array(sweep),
        joint=np.array(joint),
        level=np.tile(level, number),
        time=np.array(time),
    )


@dataclass(frozen=True)
class PoseProgram:
    """Visits in the order of time."""

    pose: Integers  # (v,) from 1
    visit: Integers  # (v,) from 1
    time: Array  # (v,) s, of the first target's measurement
    q: Array  # (v, n) rad, reported
    direction: Array  # (v, n) ±1
    travel: Array  # (v, n) rad, of the move to the pose


def pose_program(site: Site, count: int, start: float, revisits: bool, rng: np.random.Generator) -> PoseProgram:
    """Return visits to ``count`` poses from clock time ``start``, s, on; with ``revisits``, one pose in ten again.

    Half of the revisits follow within minutes from the same directions (so that they are replicates); the others come
    at the end, from random ones.
    """
    q = site.configurations(count, 0.85, 2 * np.pi, rng)
    direction = rng.choice([-1.0, 1.0], q.shape)
    order = [(float(i), i, direction[i]) for i in range(count)]
    if revisits:
        again = rng.choice(count, max(count // 10, 1), replace=False)
        for number, i in enumerate(again):
            soon = number % 2 == 0
            order.append(
                (
                    i + 3.5 if soon else 2.0 * count + number,
                    i,
                    direction[i] if soon else rng.choice([-1.0, 1.0], q.shape[1]),
                )
            )
    order.sort(key=lambda entry: entry[0])
    seen = [entry[1] for entry in order]
    there = q[seen]
    return PoseProgram(
        pose=np.array(seen) + 1,
        visit=np.array([seen[: k + 1].count(i) for k, i in enumerate(seen)]),
        time=start + np.cumsum(rng.uniform(22.0, 28.0, len(seen))),
        q=there,
        direction=np.array([entry[2] for entry in order]),
        travel=np.abs(np.diff(there, axis=0, prepend=site.middle[None])),
    )
