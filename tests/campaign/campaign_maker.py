"""A small campaign on the KR20 that follows the contract in all five tables, and ways to spoil it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from experiments.campaign import write_campaign
from kinematics.description import load_robot
from kinematics.poe import forward

ROBOT = load_robot("kuka_kr20_r1810")
N = ROBOT.n
TARGETS = {"T1": [0.10, 0.0, 0.12], "T2": [-0.05, 0.0866, 0.12], "T3": [-0.02, -0.0866, 0.20]}
BASE = Rotation.from_euler("zyx", [0.4, 0.05, -0.02])
ORIGIN = np.array([2.5, -1.0, 0.3])
HEADER: dict[str, Any] = {
    "robot": "kuka_kr20_r1810",
    "gravity_m_s2": [0.0, 0.0, -9.81],
    "tool": {"mass_kg": 12.0, "com_m": [0.0, 0.0, 0.08]},
    "targets_m": TARGETS,
    "instrument": {"name": "laser tracker", "position_std_m": 2e-5, "orientation_std_rad": 5e-5},
}
CENTRE = np.array([0.2, -1.2, 1.1, 0.4, 0.7, -0.3])
Tables = dict[str, pd.DataFrame]


def make_tables() -> Tables:
    return {name: table.copy() for name, table in _tables().items()}


@cache
def _tables() -> Tables:
    rng = np.random.default_rng(7)
    return {
        "free_air": _log(rng, moving=range(N)),
        "wrist": _log(rng, moving=range(3, N)),
        "clamped": _clamped(rng),
        "poses": _poses(rng, poses=12, start=0.0),
        "verification": _poses(rng, poses=5, start=1000.0),
    }


def write(folder: Path, tables: Tables, header: dict[str, Any] | None = None, file_format: str = "csv") -> Path:
    return write_campaign(folder, header or HEADER, tables, file_format)  # type: ignore[arg-type]


def change(table: str, edit: Callable[[pd.DataFrame], pd.DataFrame]) -> Tables:
    """Give a campaign of one table, changed."""
    return {table: edit(make_tables()[table])}


def columns(pattern: str) -> list[str]:
    return [pattern.format(i) for i in range(1, N + 1)]


def _log(rng: np.random.Generator, moving: range) -> pd.DataFrame:
    parts = []
    for run in (1, 2):
        time = 0.1 * np.arange(12)
        rate = np.array([rng.uniform(1.0, 2.0) for _ in range(N)])
        phase = rng.uniform(0.0, 6.0, N)
        swing = np.where(np.isin(np.arange(N), moving), 0.5, 0.0)
        q = CENTRE + swing * np.sin(rate * time[:, None] + phase)
        qd = swing * rate * np.cos(rate * time[:, None] + phase)
        tau = rng.normal(0.0, 0.5, (12, N))
        part = {"run": run, "time_s": time + 100.0 * run}
        part |= dict(zip(columns("q{}_rad"), q.T, strict=True)) | dict(zip(columns("qd{}_rad_s"), qd.T, strict=True))
        part |= dict(zip(columns("tau{}_Nm"), tau.T, strict=True)) | {"temp_motor1_C": 25.0 + 0.1 * time}
        parts.append(pd.DataFrame(part))
    return pd.concat(parts, ignore_index=True)


def _clamped(rng: np.random.Generator) -> pd.DataFrame:
    rest = np.linalg.solve(ROBOT.transmission.T, CENTRE)
    parts = []
    for sweep in range(1, N + 1):
        motor = np.tile(rest, (4, 1))
        motor[:, sweep - 1] += [0.0, 0.1, 0.2, 0.1]
        part: dict[str, Any] = {"sweep": sweep, "joint": sweep, "time_s": np.arange(4.0) + 10.0 * sweep}
        part |= dict(zip(columns("motor{}_rad"), motor.T, strict=True))
        part |= dict(zip(columns("tau{}_Nm"), rng.normal(0.0, 0.5, (4, N)).T, strict=True))
        part |= {name: rng.normal(0.0, 1e-5, 4) for name in ("fixture_x_m", "fixture_y_m", "fixture_z_m")}
        parts.append(pd.DataFrame(part).assign(temp_ambient_C=21.0))
    return pd.concat(parts, ignore_index=True)


def _poses(rng: np.random.Generator, poses: int, start: float) -> pd.DataFrame:
    angles = CENTRE + rng.uniform(-0.6, 0.6, (poses, N))
    stops = [(pose, 1) for pose in range(1, poses + 1)] + [(1, 2)]
    rows = []
    for index, (pose, visit) in enumerate(stops):
        q = angles[pose - 1]
        direction = np.where((np.arange(N) + pose) % 2, 1, -1)
        flange = forward(ROBOT.screws, ROBOT.flange, q)
        x, y, z, w = (BASE * Rotation.from_matrix(flange[:3, :3])).as_quat()
        for offset, (target, point) in enumerate(TARGETS.items()):
            at = BASE.apply(flange[:3, :3] @ point + flange[:3, 3]) + ORIGIN + rng.normal(0.0, 2e-5, 3)
            row: dict[str, Any] = {"pose": pose, "visit": visit, "time_s": start + 10.0 * index + offset}
            row |= dict(zip(columns("q{}_rad"), q, strict=True)) | dict(zip(columns("dir{}"), direction, strict=True))
            row |= {"target": target, "x_m": at[0], "y_m": at[1], "z_m": at[2], "qw": w, "qx": x, "qy": y, "qz": z}
            rows.append(row | {"temp_link1_C": 24.0 + 0.01 * index, "operator": "AB"})
    return pd.DataFrame(rows)
