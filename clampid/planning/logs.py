"""Information of the moves of a planned torque log on the parameters.

Only rows that a fit would use count: motors that clearly move at steady speed, with inertia torques small against the
noise. Part of the noise variance is white, the rest is correlated over a correlation time. Each move is whitened with
this covariance; different moves are treated as independent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import linalg

from clampid.effect import Effect
from clampid.planning.bench import imagined
from clampid.slots import Slot, parse_term, slots_of_terms
from clampid.stages.counting import counting, negligible
from clampid.stages.fit_problem import FitProblem, fit_problem
from clampid.stages.layout import coupled_joints, layout_of
from clampid.stages.log_facts import CLEAR_MOTION
from clampid.stages.rows import Array, Bools, Integers
from clampid.stages.stage_kind import acts_with, stages_with
from clampid.stages.torques import torque_rows
from experiments.plans.errors import PlanError
from experiments.plans.model import Cell
from experiments.plans.motion import Course
from experiments.plans.press import rated_motor_torque

__all__ = ["LogBench", "MoveInformation", "TorqueNoise", "planned_log", "planned_rows", "torque_noise_of"]

NOISE_SHARE = 0.01  # of the rated torque: usual standard deviation of the torque noise
REST_SPEED = 1e-9  # rad/s: threshold of rest, since planned motion has no noise
SETTLING_TIME = 0.25  # s after a change of speed in which a differentiated log still shows it


@dataclass(frozen=True)
class TorqueNoise:
    """Noise of the torque logs.

    Attributes
    ----------
    sigma
        Standard deviation at the motors ``(n,)``, Nm.
    correlated_share
        Share of the variance that is correlated in time.
    correlation_time
        Correlation time of this share, s.
    """

    sigma: Array
    correlated_share: float = 0.5
    correlation_time: float = 2.0

    def white(self, time: Array, columns: Array) -> Array:
        """Whiten columns ``(N, k)`` of readings at ``time`` ``(N,)``, s, in units of the standard deviation."""
        covariance = self.correlated_share * np.exp(-np.abs(time[:, None] - time[None, :]) / self.correlation_time)
        covariance[np.diag_indices(len(time))] = 1.0
        return np.asarray(linalg.solve_triangular(linalg.cholesky(covariance, lower=True), columns, lower=True))

    @property
    def words(self) -> str:
        """The noise in words, for the plan."""
        each = ", ".join(f"{s:.3g}" for s in self.sigma)
        share, time = self.correlated_share, self.correlation_time
        return f"motor torques: {each} Nm, {share:.0%} of the variance correlated over {time:g} s"


@dataclass(frozen=True)
class _PlannedThresholds:
    """The thresholds that a fit would find in the planned log; see `clampid.stages.counting.Thresholds`.

    ``noise`` is that of the difference between neighbouring rows.
    """

    rest: Array
    rest_motor: Array
    clear: Array
    clear_motor: Array
    steady: Array
    noise: Array
    moved: Bools


@dataclass(frozen=True)
class MoveInformation:
    """Information of m moves ``(m, P, P)``, SI, and the number of measured values in each that count ``(m,)``."""

    information: Array
    rows: Array


def torque_noise_of(
    cell: Cell, share: float | None, rated: Sequence[float] | None
) -> tuple[TorqueNoise, tuple[str, ...]]:
    """Noise of the motor torques as a share of the rated torques, and assumptions in words.

    Parameters
    ----------
    cell
        The robot's cell.
    share
        Standard deviation as a share of the rated torque; None: the usual one, :data:`NOISE_SHARE`.
    rated
        Rated motor torques ``(n,)``, Nm; None: as described.

    Raises
    ------
    PlanError
        The share is not above 0, or no rated torques are known.
    """
    if share is not None and not share > 0:
        raise PlanError(f"torque noise: expected a share of the rated torque above 0, found {share:g}")
    motor = rated_motor_torque(cell.robot, None if rated is None else np.asarray(rated, dtype=float))
    used = NOISE_SHARE if share is None else share
    words = () if share is not None else (f"torque noise of {used:.0%} of the rated motor torques",)
    return TorqueNoise(used * motor), words


class LogBench:
    """Computes the information of courses on a set of parameters.

    Parameters
    ----------
    cell
        Robot, gravity and tool.
    effects
        The catalogue: name → effect.
    wanted
        Effects to identify, ``effect`` or ``effect@joint3``.
    noise
        Noise of the torques.
    rate
        Rate of the log, Hz.
    fastest
        The largest share of the top speeds in the whole log. Joints that move far slower than this creep, and do not
        count.

    Raises
    ------
    PlanError
        An effect does not act in free air, or none has a parameter at this robot.
    EffectError
        An effect is unknown.
    """

    def __init__(
        self,
        cell: Cell,
        effects: Mapping[str, Effect],
        wanted: Sequence[str],
        noise: TorqueNoise,
        rate: float,
        fastest: float = 0.0,
    ) -> None:
        self.cell, self.noise, self.rate, self.fastest = cell, noise, rate, fastest
        n = cell.robot.n
        self._blank = imagined(cell, free_air=planned_log([_still(n)], rate))
        self.layout = layout_of([self._blank])
        terms = [parse_term(name, effects, self.layout) for name in wanted]
        for term in terms:
            if not acts_with(effects[term.effect], "moving"):
                acts = ", ".join(stages_with(effects[term.effect]))
                raise PlanError(f"effect {term.effect} does not act in free_air; it does in: {acts}")
        self.slots: tuple[Slot, ...] = slots_of_terms(terms, effects, self.layout, "free_air")
        if not self.slots:
            raise PlanError(f"{', '.join(wanted)}: no parameter can be identified in free air at {cell.robot.name}")
        self.problem: FitProblem = fit_problem(torque_rows([self._blank], self.layout), effects, self.slots)
        self.size: Array = self.problem.sizes()[: len(self.slots)]

    def evaluate(self, courses: Sequence[Course]) -> list[MoveInformation]:
        """Information of the moves of each course; each course is one run."""
        joined = planned_log(courses, self.rate)
        rows = torque_rows([imagined(self.cell, free_air=joined)], self.layout)
        run = rows.series.run
        used = planned_rows(self.cell, self.noise, self.rate, rows.signals, courses, run, self.fastest)
        here = self.problem.with_rows(rows)
        _, jacobian = here.residual(np.zeros(len(self.slots) + rows.offsets))
        time, run = joined["time_s"].to_numpy(), joined["run"].to_numpy()
        out = []
        for number, course in enumerate(courses):
            inside = np.flatnonzero(run == number)
            move, _ = course.phase(time[inside])
            out.append(self._course(jacobian[inside], used[inside], time[inside], move, len(course.duration)))
        return out

    def _course(self, jacobian: Array, used: Bools, time: Array, move: Integers, moves: int) -> MoveInformation:
        """Information of each move of one run, with the run's unknown constants eliminated.

        Parameters
        ----------
        jacobian
            ``(N, n, P + K)``, Nm per SI unit.
        used
            Torques that count ``(N, n)``.
        time
            ``(N,)``, s.
        move
            Number of each row's move ``(N,)``, from 0.
        moves
            Number of moves.
        """
        count = len(self.slots)
        width = jacobian.shape[2]
        information, rows = np.zeros((moves, width, width)), np.zeros(moves)
        for m in range(moves):
            for channel in range(jacobian.shape[1]):
                at = np.flatnonzero(used[:, channel] & (move == m))
                if not len(at):
                    continue
                touched = np.flatnonzero(np.any(jacobian[at, channel], axis=0))
                white = self.noise.white(time[at], jacobian[at, channel][:, touched]) / self.noise.sigma[channel]
                information[m][np.ix_(touched, touched)] += white.T @ white
                rows[m] += len(at)
        if width > count:  # what the run's constants can absorb is not information on the slots
            whole = information.sum(axis=0)
            C = whole[count:, count:]
            B = information[:, :count, count:]
            inverse = linalg.pinvh(C, rtol=1e-10)
            projected = whole[:count, :count] - whole[:count, count:] @ inverse @ whole[count:, :count]
            own = information[:, :count, :count] - np.einsum("mpk,kl,mql->mpq", B, inverse, B)
            own[-1] += projected - own.sum(axis=0)  # cross terms of the moves: only the sum over moves is exact
            information = own
        return MoveInformation(information[:, :count, :count], rows)


def planned_log(courses: Sequence[Course], rate: float) -> pd.DataFrame:
    """The log of some courses at ``rate``, Hz, as a table of a campaign: one run each, with torques of zero."""
    times = [np.arange(0.0, course.length, 1 / rate) for course in courses]
    parts = [course.at(time)[:2] for course, time in zip(courses, times, strict=True)]
    q, qd = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    run = np.repeat(np.arange(len(courses)), [len(t) for t in times])
    data = {"run": run, "time_s": np.concatenate(times)}
    for name, values, unit in (("q", q, "rad"), ("qd", qd, "rad_s"), ("tau", 0 * q, "Nm")):
        data |= {f"{name}{i + 1}_{unit}": values[:, i] for i in range(q.shape[1])}
    return pd.DataFrame(data)


def planned_rows(
    cell: Cell,
    noise: TorqueNoise,
    rate: float,
    signals: Mapping[str, Array],
    courses: Sequence[Course],
    run: Integers,
    fastest: float = 0.0,
) -> Bools:
    """Which motor torques ``(N, n)`` of planned logs a fit would use.

    Parameters
    ----------
    cell, noise, rate, fastest
        As in :class:`LogBench`.
    signals
        Signals of the planned rows.
    courses
        The courses, one for each run.
    run
        Number of each row's course ``(N,)``.
    """
    robot = cell.robot
    T = np.asarray(robot.transmission)
    gear = np.abs(np.diag(T))
    top = np.array([j.max_speed or 1.0 for j in robot.joints]) / gear
    motor_speed, speed = (np.abs(signals[f"{which}_speed"]) for which in ("motor", "joint"))
    moving = signals["joint_motion"] != 0
    between = 1 - noise.correlated_share * np.exp(-1 / rate / noise.correlation_time)
    planned = _PlannedThresholds(
        rest=np.full(robot.n, REST_SPEED),
        rest_motor=np.full(robot.n, REST_SPEED),
        clear=CLEAR_MOTION * np.maximum(speed.max(axis=0), fastest * top * gear),
        clear_motor=CLEAR_MOTION * np.maximum(motor_speed.max(axis=0), max(fastest, 1e-3) * top),
        steady=np.full(robot.n, np.inf),
        noise=noise.sigma * np.sqrt(between),
        moved=np.array([moving[run == r].any(axis=0) for r in range(len(courses))]),
    )
    # Steady motion is taken from the course, not from thresholds.
    steady = np.concatenate([_steady(course, rate) for course in courses])
    counts = counting(signals, T, planned, run, coupled_joints(robot), accelerating=True)
    return np.asarray(counts & steady[:, None] & negligible(signals["inertia_torque"] @ T.T, planned))


def _still(n: int) -> Course:
    """A course of n joints that stays at zero."""
    return Course(np.zeros((2, n)), np.ones(1), np.full(1, 0.25), 0.5)


def _steady(course: Course, rate: float) -> Bools:
    """Whether the speed is constant around each row of a course's log ``(N,)``."""
    time = np.arange(0.0, course.length, 1 / rate)
    move, since = course.phase(time)
    T, r = course.duration[move], course.ramp[move]
    return np.asarray((since > r + SETTLING_TIME) & (since < T - r - SETTLING_TIME))
