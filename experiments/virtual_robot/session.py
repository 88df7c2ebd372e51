"""One individual robot that executes a plan move by move from switch-on, for the plan's runner."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.description import Array, RobotDescription
from experiments.virtual_robot.draw import draw_plant
from experiments.virtual_robot.heat import History, session
from experiments.virtual_robot.hidden import Hidden, hide
from experiments.virtual_robot.measure import declared
from experiments.virtual_robot.pose_tables import measure_poses
from experiments.virtual_robot.programs import ClampProgram, Course, PoseProgram, Run
from experiments.virtual_robot.sampling import Site
from experiments.virtual_robot.torque_tables import log_runs, log_sweeps

WORK_AVERAGED = 10.0  # s, in which the work of a motor is averaged
BRISK = 0.05  # of the top speed, on average, warms a motor to its full rise in the end
HARDEST = 1.5


class Session:
    """A robot with a memory: its clock, its temperatures, and the direction in which each joint moved last.

    Parameters
    ----------
    robot
        The nominal robot.
    hidden
        Effects that this individual has.
    seed
        Which individual and noise; the individual is the one that `measure` draws with the same seed.
    """

    def __init__(self, robot: RobotDescription, hidden: Sequence[Hidden] = (), *, seed: int = 0) -> None:
        self.site = Site(robot)
        plant_seed, _, _, own_seed, hidden_seed = np.random.SeedSequence(seed).spawn(5)
        baseline = draw_plant(robot, np.random.default_rng(plant_seed))
        self.plant, self.hidden = hide(self.site, baseline, hidden, hidden_seed)
        self.bodies = Bodies(self.plant.geometry, self.plant.masses)
        self.clock = 0.0
        self._rng = np.random.default_rng(own_seed)
        self._direction = self._rng.choice([-1.0, 1.0], self.plant.n)
        self._preload = np.zeros(self.plant.n)
        self._posture: Array | None = None
        self._ends: list[float] = []
        self._work: list[Array] = []

    def header(self) -> dict[str, object]:
        """Return what the cell declares: gravity, tool, targets and instrument, as ``campaign.toml`` has them."""
        return declared(self.plant)

    def wait(self, seconds: float) -> None:
        """Let time pass at rest."""
        self._spend(seconds, np.zeros(self.plant.n))

    def log(self, course: Course) -> pd.DataFrame:
        """Follow a course and log it; ``time_s`` is the session's clock."""
        start = self.clock
        for edge in np.arange(0.0, course.length, WORK_AVERAGED):
            end = min(edge + WORK_AVERAGED, course.length)
            _, speed, _ = course.at(np.linspace(edge, end, 20))
            self._spend(end - edge, np.abs(speed).mean(axis=0))
        history = self._history()
        logged = log_runs(self.plant, self.bodies, [Run(course, start)], history=history, since=0.0, rng=self._rng)
        self._remember(np.diff(course.knots, axis=0))
        return logged.table.drop(columns="run")

    def clamp(self, posture: Array) -> None:
        """Clamp the flange in a posture, rad, (n,); its preload is drawn anew."""
        self._posture = np.array(posture)
        self._direction = self._rng.choice([-1.0, 1.0], self.plant.n)
        self._preload = self._rng.standard_normal(self.plant.n)

    def sweep(self, joint: int, offset: Array, dwell: float) -> pd.DataFrame:
        """Drive one joint (from 0) of the clamped arm by ``offset``, rad, (m,), ``dwell`` s at each, and read it."""
        if self._posture is None:
            raise RuntimeError("the flange is not clamped: expected clamp(posture) before sweep")
        rows = len(offset)
        time = np.asarray(self.clock + dwell * np.arange(1, rows + 1), dtype=float)
        self._spend(dwell * rows, 0.1 * BRISK * self.site.speed)
        program = ClampProgram(
            posture=self._posture[None],
            direction=self._direction[None],
            preload=self._preload[None],
            event=np.zeros(rows, dtype=np.int64),
            sweep=np.ones(rows, dtype=np.int64),
            joint=np.full(rows, joint),
            level=np.array(offset),
            time=time,
        )
        logged = log_sweeps(
            self.plant, self.bodies, program, np.ones((1, self.plant.n)),
            history=self._history(), since=0.0, rng=self._rng,
        )  # fmt: skip
        return logged.table.drop(columns=["sweep", "joint"])

    def release(self) -> None:
        """Open the clamp."""
        self._posture = None

    def visit(self, course: Course, targets: Sequence[str], measure_time: float) -> pd.DataFrame:
        """Follow a course and measure points of the arm at its end; ``time_s`` is the session's clock."""
        self._spend(course.length, np.abs(np.diff(course.knots, axis=0)).sum(axis=0) / max(course.length, 1e-9))
        self._remember(np.diff(course.knots, axis=0))
        one = np.ones(1, dtype=np.int64)
        program = PoseProgram(
            pose=one,
            visit=one,
            time=np.array([self.clock]),
            q=course.knots[-1:],
            direction=self._direction[None],
            travel=np.abs(course.knots[-1:] - course.knots[-2:-1]),
        )
        self.wait(measure_time * len(self.plant.geometry.targets))
        table = measure_poses(self.plant, self.bodies, program, self._history(), self._rng).table
        return table[table["target"].isin(list(targets))].drop(columns=["pose", "visit"]).reset_index(drop=True)

    def _remember(self, moves: Array) -> None:
        for move in moves:
            self._direction = np.where(move == 0, self._direction, np.sign(move))

    def _spend(self, seconds: float, speed: Array) -> None:
        if seconds > 0:
            self.clock += seconds
            self._ends.append(self.clock)
            self._work.append(np.minimum(speed / (BRISK * self.site.speed), HARDEST))

    def _history(self) -> History:
        return session(self.plant.heat, np.array(self._ends), np.array(self._work))
