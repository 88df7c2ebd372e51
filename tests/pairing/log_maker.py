"""Logs of an instrument and a robot as a generator of its own makes them: motions, clocks, noise, lost sight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Logs", "arm_point", "make_logs"]

LENGTHS = (0.4, 0.5, 0.6)  # m: column, upper arm, forearm


def arm_point(q):
    """A point on a plain arm of three joints ``(N, 3)``: turn, lift, bend. The wrist's joints add a small circle."""
    reach = LENGTHS[1] * np.cos(q[:, 1]) + LENGTHS[2] * np.cos(q[:, 1] + q[:, 2]) + 0.1 * np.cos(q[:, 3])
    height = LENGTHS[0] + LENGTHS[1] * np.sin(q[:, 1]) + LENGTHS[2] * np.sin(q[:, 1] + q[:, 2]) + 0.1 * np.sin(q[:, 4])
    return np.c_[reach * np.cos(q[:, 0]), reach * np.sin(q[:, 0]), height]


@dataclass
class Logs:
    time: np.ndarray
    points: np.ndarray
    robot_time: np.ndarray
    joints: np.ndarray
    offset: float  # robot minus instrument, at instrument time 0
    drift: float
    stops: np.ndarray  # (P, 2) true times, s
    postures: np.ndarray  # (P, n)
    true_points: np.ndarray
    seen: np.ndarray  # (P,): both logs have a second or more of it
    unseen: np.ndarray  # (P,): at least one log has nothing of it


def make_logs(seed, poses=400, rate=500.0, robot_rate=10.0, noise=20e-6, lost=0.05, robot_lost=0.02, dwell=(2.0, 4.0),
              drift=None, point=arm_point, joint_noise=2e-6):  # fmt: skip
    rng = np.random.default_rng(seed)
    basis = rng.uniform([-1.5, 0.2, -1.5, -2, -1, -2], [1.5, 1.2, -0.3, 2, 1, 2], size=(max(2, 3 * poses // 4), 6))
    postures = [basis[0]]
    while len(postures) < poses:
        kind = rng.uniform()
        if kind < 0.2:  # a small step: half a millimetre to some
            postures.append(postures[-1] + rng.choice([-1, 1]) * rng.uniform(1e-3, 4e-3) * np.eye(6)[rng.integers(3)])
        else:
            nxt = basis[rng.integers(len(basis))]
            if np.abs(nxt - postures[-1]).max() > 1e-3:
                postures.append(nxt)
    postures = np.array(postures)
    speed, now = 1.0, 3.0  # rad/s
    knots, values, stops = [0.0], [postures[0]], []
    for k, q in enumerate(postures):
        if k:
            step = np.abs(q - postures[k - 1]).max()
            took = max(0.4, 1.9 * step / speed)
            s = np.linspace(0, 1, 60)
            blend = s**3 * (10 - 15 * s + 6 * s**2)
            knots += list(now + took * s[1:])
            values += list(postures[k - 1] + blend[1:, None] * (q - postures[k - 1]))
            now += took
        begin = now
        now += rng.uniform(*dwell)
        stops.append((begin, now))
        knots.append(now)
        values.append(q)
    knots, values, stops = np.array(knots), np.array(values), np.array(stops)

    def motion(t):
        return np.column_stack([np.interp(t, knots, values[:, i]) for i in range(6)])

    drift = rng.uniform(-1e-4, 1e-4) if drift is None else drift
    shift = rng.uniform(-600, 600)
    # The instrument's clock is the true one from a begin of its own; the robot's runs fast or slow.
    began = rng.uniform(-20.0, 0.0) + 1000.0
    t = np.arange(0.0, now + 5.0, 1 / rate)
    tr = np.arange(rng.uniform(0, 0.1) - 30.0, now + 20.0, 1 / robot_rate)
    q = motion(t)
    p = point(q)
    for begin, _ in stops[1:]:  # the arm rings when it stops
        a, b = np.searchsorted(t, [begin, begin + 1.0])
        p[a:b, 2] += 2e-4 * (np.exp(-(t[a:b] - begin) / 0.05) * np.sin(60 * (t[a:b] - begin)))
    p = p + noise * rng.standard_normal(p.shape)
    joints = motion(tr) + joint_noise * rng.standard_normal((len(tr), 6))
    keep, keep_r = np.ones(len(t), bool), np.ones(len(tr), bool)
    for k in np.flatnonzero(rng.uniform(size=poses) < lost):
        a, b = stops[k]
        kind = rng.integers(4)
        if kind == 0:  # never seen
            keep[(t > a - 0.5) & (t < b + 0.5)] = False
        elif kind == 1:  # begins late
            keep[(t > a - 0.3) & (t < b - rng.uniform(0.2, 1.5))] = False
        elif kind == 2:  # ends early
            keep[(t > a + rng.uniform(0.2, 1.5)) & (t < b + 0.3)] = False
        else:  # interrupted
            keep[(t > a + 0.4 * (b - a)) & (t < a + 0.6 * (b - a))] = False
    for k in np.flatnonzero(rng.uniform(size=poses) < robot_lost):
        a, b = stops[k]
        keep_r[(tr > a - 1.0) & (tr < b + 1.0)] = False
    stops[0, 0], stops[-1, 1] = t[0], t[-1]  # it stands before the program and after it
    span = np.diff(stops, axis=1)[:, 0]
    have = np.array([[np.sum(keep & (t > a) & (t < b)) / rate, np.sum(keep_r & (tr > a) & (tr < b)) / robot_rate]
                     for a, b in stops])  # fmt: skip
    seen = (have[:, 0] > 1.6) & (have[:, 1] > 0.8 * span)
    unseen = (have[:, 0] == 0.0) | (have[:, 1] == 0.0)
    ti = t + began
    robot_clock = (tr + began) * (1 + drift) + shift
    return Logs(ti[keep], p[keep], robot_clock[keep_r], joints[keep_r], shift, drift, stops + began, postures,
                point(postures), seen, unseen)  # fmt: skip
