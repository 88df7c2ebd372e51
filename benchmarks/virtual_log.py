"""Long free-air logs of one virtual robot, for the benchmarks: program after program, runs numbered on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.draw import draw_plant
from experiments.virtual_robot.heat import session
from experiments.virtual_robot.measure import _work, declared
from experiments.virtual_robot.programs import free_air_program
from experiments.virtual_robot.sampling import Site
from experiments.virtual_robot.torque_tables import log_runs
from kinematics.robot import RobotDescription


def virtual_log(robot: RobotDescription, seed: int = 1) -> tuple[dict[str, Any], Iterator[pd.DataFrame]]:
    """What the cell declares, and tables free_air (SI) that follow on each other without end."""
    site, plant = Site(robot), draw_plant(robot, np.random.default_rng(seed))
    return {"format": "clampid-campaign/1", "robot": robot.name, **declared(plant)}, _tables(site, plant, seed)


def _tables(site: Site, plant: Any, seed: int) -> Iterator[pd.DataFrame]:
    bodies = Bodies(plant.geometry, plant.masses)
    rng = np.random.default_rng(seed + 1)
    runs, since = 0, 0.0
    while True:
        program = free_air_program(site, rng)
        time, work = _work(program, 0.0)
        history = session(plant.heat, time, work / work.mean())
        table = log_runs(plant, bodies, program, history=history, since=0.0, rng=rng).table
        table["run"] += runs
        table["time_s"] = (table["time_s"] + since).round(3)
        runs, since = int(table["run"].max()), float(table["time_s"].iloc[-1]) + 10.0
        yield table


def rows_of(tables: Iterator[pd.DataFrame], rows: int) -> pd.DataFrame:
    """The next tables together, cut to so many rows."""
    found: list[pd.DataFrame] = []
    while sum(map(len, found)) < rows:
        found.append(next(tables))
    return pd.concat(found, ignore_index=True)[:rows]
