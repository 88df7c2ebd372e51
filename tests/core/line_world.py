"""Campaigns on a straight line: an arm goes out and back along it, over and over, and one reflector is tracked.

The physics is this file's own: rotations about displaced axes, drives that give way, a clearance crossed at each turn,
a link that grows as it warms. No effect of the library and no part of the virtual robot takes part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from experiments.campaign import Campaign, Instrument, Tool
from kinematics.description import load_robot

__all__ = ["LineCampaign", "line_campaign"]

Array = np.ndarray

ROBOT = load_robot("abb_irb4600_40_255")
TARGET = np.array([0.05, 0.02, 0.10])  # m, nominal, in the flange frame
POSITIONS = 24
SIGMA = 3e-5  # m, of the tracker
REPEATABILITY = 1e-5  # rad, of each joint
RISE = np.array([4.0, 14.0, 5.0, 3.0, 3.0, 2.0])  # K, of the links in the end
WARMING_S = np.array([4000.0, 2500.0, 1500.0, 5000.0, 900.0, 3000.0])
GROWTH = 11.5e-6  # 1/K, of steel
MASSES = ((6, 1.0, 12.0),)  # carried by joint, share of the way on, kg


@dataclass(frozen=True)
class LineCampaign:
    """A campaign on a line and what nobody knows of it.

    Attributes
    ----------
    gap
        The clearance of joint 1, rad.
    base
        ``(4, 4)``: where the instrument sees the robot's base.
    """

    campaign: Campaign
    gap: float
    base: Array


@dataclass(frozen=True)
class _Arm:
    axes: Array
    points: Array
    zero: Array
    flange: Array
    soft: Array
    target: Array


def _individual(rng: np.random.Generator) -> _Arm:
    n = ROBOT.n
    axes = np.array([j.axis for j in ROBOT.joints]) + 3e-4 * rng.standard_normal((n, 3))
    return _Arm(
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        points=np.array([j.point for j in ROBOT.joints]) + 3e-4 * rng.standard_normal((n, 3)),
        zero=5e-4 * rng.standard_normal(n),
        flange=np.asarray(ROBOT.flange),
        soft=np.array([1.0, 0.8, 1.2, 6.0, 6.0, 8.0]) * 1e-6 * rng.uniform(0.7, 1.4, n) / 3.0,
        target=TARGET + 3e-4 * rng.standard_normal(3),
    )


def _nominal() -> _Arm:
    n = ROBOT.n
    return _Arm(
        np.array([j.axis for j in ROBOT.joints], dtype=float),
        np.array([j.point for j in ROBOT.joints], dtype=float),
        np.zeros(n), np.asarray(ROBOT.flange), np.zeros(n), TARGET,
    )  # fmt: skip


def _frames(arm: _Arm, q: Array, grown: float = 0.0) -> list[tuple[Array, Array]]:
    """Rotation and shift of every link, base axes: x -> R x + p for what stands there at the zero pose."""
    R, p = np.eye(3), np.zeros(3)
    out = [(R, p)]
    way = arm.points[2] - arm.points[1]
    for i in range(len(q)):
        turn = Rotation.from_rotvec(q[i] * arm.axes[i]).as_matrix()
        p = p + R @ (arm.points[i] - turn @ arm.points[i])
        R = R @ turn
        if i == 1:  # what follows stands farther along link 2
            p = p + R @ (grown * way)
        out.append((R, p))
    return out


def _load(arm: _Arm, frames: list[tuple[Array, Array]]) -> Array:
    """Torque of the weight about each joint, Nm."""
    ends = np.vstack([arm.points, arm.flange[:3, 3]])
    torque = np.zeros(len(arm.zero))
    for link, share, mass in MASSES:
        R, p = frames[link]
        at = R @ ((1 - share) * ends[link - 1] + share * ends[min(link, len(ends) - 1)]) + p
        for i in range(link):
            Ri, pi = frames[i]
            axis, point = Ri @ arm.axes[i], Ri @ arm.points[i] + pi
            torque[i] += axis @ np.cross(at - point, [0.0, 0.0, -9.81 * mass])
    return torque


def _reflector(arm: _Arm, q: Array, grown: float = 0.0) -> Array:
    turned = q + arm.zero
    turned = turned + arm.soft * _load(arm, _frames(arm, turned))
    R, p = _frames(arm, turned, grown)[-1]
    return R @ (arm.flange[:3, :3] @ arm.target + arm.flange[:3, 3]) + p


def _path(rng: np.random.Generator) -> Array:
    """Joint angles ``(24, 6)`` that put the nominal arm's reflector on a line, its flange not turning, rad."""
    arm = _nominal()
    middle = np.array([rng.uniform(-0.6, 0.6), 0.25, 0.1, 0.2, 0.6, 0.1]) + 0.1 * rng.standard_normal(6)
    R0, p0 = _frames(arm, middle)[-1]
    start = R0 @ (arm.flange[:3, :3] @ arm.target + arm.flange[:3, 3]) + p0
    way = Rotation.from_euler("z", rng.uniform(-0.15, 0.15) + middle[0]).apply([1.0, 0.1, 0.2])
    way /= np.linalg.norm(way)
    out, q = [], middle
    for s in np.linspace(-0.5, 0.5, POSITIONS):

        def off(a: Array, s: float = s) -> Array:
            R, p = _frames(arm, a)[-1]
            at = R @ (arm.flange[:3, :3] @ arm.target + arm.flange[:3, 3]) + p
            return np.r_[at - start - s * way, Rotation.from_matrix(R0.T @ R).as_rotvec()]

        q = least_squares(off, q, xtol=1e-14, ftol=1e-14, gtol=1e-14).x
        out.append(q)
    return np.array(out)


def line_campaign(seed: int, gap: float, *, heat: bool = True, passes: int = 1) -> LineCampaign:
    """Out and back along a line, ``passes`` times, with a clearance in joint 1."""
    rng = np.random.default_rng([23, seed])
    arm, path = _individual(rng), _path(rng)
    base = np.eye(4)
    base[:3, :3] = Rotation.from_euler("ZYX", [rng.uniform(-3, 3), *(0.02 * rng.standard_normal(2))]).as_matrix()
    base[:3, 3] = rng.uniform(-3.0, 3.0, 3)
    order = np.r_[np.arange(POSITIONS), np.arange(POSITIONS)[::-1]]
    back = np.r_[np.zeros(POSITIONS), np.ones(POSITIONS)].astype(bool)
    along = np.sign(path[-1] - path[0])
    rows = []
    for k in range(passes):
        for at, returning in zip(order, back, strict=True):
            direction = -along if returning else along
            time = 15.0 * len(rows)
            temperature = 22.0 + RISE * (1.0 - np.exp(-time / WARMING_S))
            there = path[at] + REPEATABILITY * rng.standard_normal(6)
            there[0] -= 0.5 * gap * direction[0]
            point = _reflector(arm, there, GROWTH * (temperature[1] - 20.0) if heat else 0.0)
            read = base[:3, :3] @ point + base[:3, 3] + SIGMA * rng.standard_normal(3)
            row = {"pose": at + 1, "visit": 2 * k + 1 + int(returning), "time_s": time}
            row |= {f"q{i + 1}_rad": path[at, i] for i in range(6)}
            row |= {f"dir{i + 1}": int(direction[i]) for i in range(6)}
            row |= dict(zip(("x_m", "y_m", "z_m"), read, strict=True))
            temperature = temperature + 0.05 * rng.standard_normal(6)
            row |= {f"temp_link{i + 1}_C": temperature[i] for i in range(6)}
            rows.append(row | {"target": "R1"})
    campaign = Campaign(
        "line", None, ROBOT, np.array([0.0, 0.0, -9.81]), Tool(20.0, np.array([0.0, 0.0, 0.08])), {"R1": TARGET},
        Instrument("tracker", SIGMA, None), {"poses": pd.DataFrame(rows)}, f"{seed:064d}",
    )  # fmt: skip
    return LineCampaign(campaign, gap, base)
