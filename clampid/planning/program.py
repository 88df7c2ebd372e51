"""Wishes for plans of torque logs, in free air or of the wrist, and the finished plan with its expected results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np

from clampid.planning.expected import expected_of
from clampid.planning.logs import LogBench
from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits
from experiments.plans.model import Plan, Run
from experiments.plans.validate import validate_plan

__all__ = ["LogWishes", "plan_of_runs"]

LONGEST_LOG = 86_400.0  # s, all runs of a plan together


@dataclass(frozen=True)
class LogWishes:
    """The wishes for a plan of torque logs.

    Attributes
    ----------
    time
        Time budget of all runs, s.
    speeds
        Shares of the top speeds; the whole program runs once at each.
    effects
        Effects to identify, ``effect`` or ``effect@joint3``; None: the standard set of the experiment.
    dwell
        Time at each stop, s.
    rate
        Rate of the log, Hz.
    seed
        Seed of the candidates.
    """

    time: float = 1200.0
    speeds: Sequence[float] = (0.15, 0.06)
    effects: Sequence[str] | None = None
    dwell: float = 1.0
    rate: float = 10.0
    seed: int = 0

    def check(self) -> None:
        """Check that all numbers are in range.

        Raises
        ------
        PlanError
            One is not; the message names the first.
        """
        if not 0 < self.time <= LONGEST_LOG:
            raise PlanError(f"time: expected seconds above 0, at most {LONGEST_LOG:g}, found {self.time:g}")
        if len(self.speeds) < 2 or len(set(self.speeds)) < len(self.speeds):
            raise PlanError(
                f"speeds: expected two or more different shares of the top speeds, found {list(self.speeds)}"
            )
        for share in self.speeds:
            if not 0.0 < share <= 1.0:
                raise PlanError(f"speeds: expected shares of the top speeds above 0 and at most 1, found {share:g}")
        if not self.dwell > 0:
            raise PlanError(f"dwell: expected seconds above 0, found {self.dwell:g}")
        if not self.rate > 0:
            raise PlanError(f"rate: expected Hz above 0, found {self.rate:g}")

    def record(self, effects: Sequence[str]) -> dict[str, float | int | str]:
        """The wishes as the plan records them, with the ``effects`` that they led to."""
        speeds = ", ".join(f"{s:g}" for s in self.speeds)
        return {"time_s": self.time, "speeds": speeds, "effects": ", ".join(effects), "seed": self.seed}


def plan_of_runs(
    kind: Literal["free_air", "wrist"],
    limits: Limits,
    bench: LogBench,
    runs: tuple[Run, ...],
    wished: Mapping[str, float | int | str],
    *,
    assumed: Sequence[str] = (),
    impossible: tuple[str, ...] = (),
) -> Plan:
    """The plan of these runs, with its expected results, checked against its own limits.

    Parameters
    ----------
    kind
        The experiment.
    limits
        Limits of the robot.
    bench
        What computes the information of the runs.
    runs
        The runs.
    wished
        The wishes, for the record.
    assumed
        Assumptions, in words.
    impossible
        Sentences on what no program of this kind could identify.

    Raises
    ------
    PlanError
        A move is beyond a limit.
    """
    informations = bench.evaluate([run.course for run in runs])
    information = np.sum([t.information.sum(axis=0) for t in informations], axis=0)
    rows = int(sum(t.rows.sum() for t in informations))
    plan = Plan(
        kind=kind,
        cell=bench.cell,
        limits=limits,
        duration=sum(run.course.length for run in runs),
        runs=runs,
        rate=bench.rate,
        expected=expected_of(bench.problem, information, rows, bench.noise.words, impossible),
        assumed=tuple(assumed),
        wished=MappingProxyType(dict(wished)),
    )
    validate_plan(plan)
    return plan
