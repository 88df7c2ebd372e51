"""Measures a robot of this world: tables with noise in a campaign folder, and the truth beside it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Unpack

import numpy as np
import pandas as pd

from experiments.second_world.arrays import Array, stream
from experiments.second_world.campaign_out import base_section, hidden_file, write_campaign, write_truth
from experiments.second_world.hidden import HIDDEN, Active
from experiments.second_world.individual import Robot
from experiments.second_world.noise import draw_noise, rounded
from experiments.second_world.session import (
    Hidden,
    Session,
    SessionChoice,
    activate,
    open_session,
    points_seen,
    row_times,
    torques,
)

__all__ = ["TABLES", "Truth", "measure"]

TABLES = ("free_air", "poses", "verification")


@dataclass(frozen=True)
class Truth:
    """The true values of a measurement, and the hidden effects."""

    folder: Path
    hidden_file: Path
    hidden: tuple[dict[str, object], ...]  # as in the file
    robot: Robot
    noise: str
    position_std_m: Array  # (3,) along the instrument's axes
    torque_std_Nm: Array  # (n,)


def _angles(session: Session, q: Array) -> dict[str, Array]:
    reported = rounded(q, session.noise.count_rad)
    return {f"q{j + 1}_rad": reported[:, j] for j in range(q.shape[1])}


def _sensor(values: Array, rng: np.random.Generator) -> Array:
    """Temperatures as a sensor gives them: 0.05 K of noise in steps of 0.01 K."""
    return np.round(values + 0.05 * rng.standard_normal(values.shape), 2)


def _pose_table(session: Session, table: str, actives: Sequence[Active], temperatures: bool) -> pd.DataFrame:
    visits = session.visits if table == "poses" else session.verification_visits
    rng = stream(session.seed, f"noise {table}")
    jitter = session.robot.repeatability_rad * rng.standard_normal(visits.q.shape)
    points = points_seen(session, visits, actives, jitter)
    N, K, _ = points.shape
    group = np.repeat(np.arange(N), K).astype(float)
    noisy = points.reshape(-1, 3) + draw_noise(session.noise, session.instrument.std_m, group, rng)
    noisy = rounded(noisy, session.noise.position_step_m)
    each = {"pose": visits.pose.astype(int), "visit": visits.visit.astype(int)}
    columns: dict[str, object] = {k: np.repeat(v, K) for k, v in each.items()}
    columns["time_s"] = np.round(row_times(session, visits), 3).ravel()
    columns |= {k: np.repeat(v, K) for k, v in _angles(session, visits.q).items()}
    columns |= {f"dir{j + 1}": np.repeat(visits.dirs[:, j].astype(int), K) for j in range(visits.q.shape[1])}
    columns["target"] = [f"T{k + 1}" for k in range(K)] * N
    columns |= {f"{c}_m": noisy[:, i] for i, c in enumerate("xyz")}
    if temperatures:
        links = _sensor(visits.link_temps_C, rng)
        columns["temp_ambient_C"] = np.repeat(_sensor(visits.ambient_C, rng), K)
        columns |= {f"temp_link{i}_C": np.repeat(links[:, i - 1], K) for i in _sensor_links(session.robot.n)}
    top = session.robot.nominal.joints[0].max_speed_rad_s
    columns["approach_qd1_rad_s"] = np.repeat(visits.speed * visits.dirs[:, 0] * top, K)
    return pd.DataFrame(columns)


def _sensor_links(n: int) -> tuple[int, ...]:
    return (2, 3, 5) if n == 7 else (2, 3, 4)


def _log_table(session: Session, actives: Sequence[Active], temperatures: bool) -> pd.DataFrame:
    robot, log = session.robot, session.motion
    rng = stream(session.seed, "noise free_air")
    tau = torques(session, log, actives)
    tau = tau + draw_noise(session.noise, robot.torque_std_Nm, np.arange(len(tau), dtype=float), rng)
    tau = rounded(tau, session.noise.torque_step * robot.torque_std_Nm)
    columns: dict[str, object] = {"run": log.run.astype(int), "time_s": np.round(log.time_s, 4)}
    columns |= _angles(session, log.q)
    columns |= {f"tau{j + 1}_Nm": tau[:, j] for j in range(robot.n)}
    if session.log.speeds_recorded:
        qd = log.qd + 2e-4 * robot.nominal.max_speeds() * rng.standard_normal(log.qd.shape)
        columns |= {f"qd{j + 1}_rad_s": qd[:, j] for j in range(robot.n)}
    if temperatures:
        motors = _sensor(robot.climate.motors(log.time_s, log.work_s), rng)
        columns["temp_ambient_C"] = _sensor(robot.climate.ambient(log.time_s), rng)
        columns |= {f"temp_motor{j + 1}_C": motors[:, j] for j in range(robot.n)}
    return pd.DataFrame(columns)


def _record(name: str, where: str, magnitude: float, active: Active) -> dict[str, object]:
    effect = HIDDEN[name]
    record: dict[str, object] = {
        "effect": effect.family or name,
        "where": where.split("+"),
        "parameters": [vars(p) for p in active.parameters],
        "name": name,
        "magnitude": magnitude,
        "tables": list(effect.tables),
        "in_a_library": effect.family is not None,
        "depends_on": list(effect.depends_on(where)),
    }
    return record


def measure(
    robot: Robot,
    out_folder: str | Path,
    *,
    hidden: Sequence[Hidden] = (),
    tables: Sequence[str] = TABLES,
    temperatures: bool = True,
    base_known: bool = False,
    **chosen: Unpack[SessionChoice],
) -> Truth:
    """
    Measure a robot and write a campaign folder. The same call writes the same bytes.

    Parameters
    ----------
    robot
        Of `draw_robot`.
    out_folder
        The campaign folder. What was hidden goes beside it, to `<out_folder>.hidden.json`.
    hidden
        Hidden effects: name, where (None for the default place), magnitude (factor on the default size).
    tables
        Which of `free_air`, `poses`, `verification` are measured.
    temperatures
        Whether temperature sensors are recorded.
    base_known
        Whether the campaign says where the base stands, to 0.2 mm and 0.1 mrad.
    chosen
        Programme, log, noise and seed of the session; see `open_session`.

    Returns
    -------
    Truth
        Where everything is, and what was hidden.
    """
    if wrong := [t for t in tables if t not in TABLES]:
        raise ValueError(f"table {wrong[0]!r}: expected some of {', '.join(TABLES)}")
    session = open_session(robot, **chosen)
    active = activate(session, hidden)
    laws = [a for _, _, a in active]
    made = {
        t: _log_table(session, laws, temperatures) if t == "free_air" else _pose_table(session, t, laws, temperatures)
        for t in TABLES
        if t in tables
    }
    folder = Path(out_folder)
    base = base_section(session, stream(session.seed, "base")) if base_known else ""
    write_campaign(folder, robot, session, made, base)
    records = [_record(n, w, h[2], a) for h, (n, w, a) in zip(hidden, active, strict=True)]
    write_truth(hidden_file(folder), records)
    return Truth(
        folder=folder,
        hidden_file=hidden_file(folder),
        hidden=tuple(records),
        robot=robot,
        noise=session.noise_name,
        position_std_m=session.instrument.std_m,
        torque_std_Nm=robot.torque_std_Nm,
    )
