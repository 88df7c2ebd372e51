"""What plans of logged programs have in common, in free air and of the wrist: counts and expected results."""

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

__all__ = ["LogWishes", "finished_program"]

LONGEST_LOG = 86_400.0  # s, of one program


@dataclass(frozen=True)
class LogWishes:
    """What logs of moves in free air are wanted.

    Attributes
    ----------
    time
        Budget, s, for all runs.
    speeds
        Shares of the top speeds at which the whole program runs, once each.
    effects
        What is asked, ``effect`` or ``effect@joint3``; None: the experiment's standard set.
    dwell
        s at each stop.
    rate
        Hz of the log.
    seed
        Of the candidates.
    """

    time: float = 1200.0
    speeds: Sequence[float] = (0.15, 0.06)
    effects: Sequence[str] | None = None
    dwell: float = 1.0
    rate: float = 10.0
    seed: int = 0

    def check(self) -> None:
        """Refuse numbers that no program can have.

        Raises
        ------
        PlanError
            The first of them.
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
        """What was asked for, as the plan records it, and of which effects."""
        speeds = ", ".join(f"{s:g}" for s in self.speeds)
        return {"time_s": self.time, "speeds": speeds, "effects": ", ".join(effects), "seed": self.seed}


def finished_program(
    kind: Literal["free_air", "wrist"],
    limits: Limits,
    bench: LogBench,
    runs: tuple[Run, ...],
    wished: Mapping[str, float | int | str],
    *,
    assumed: Sequence[str] = (),
    impossible: tuple[str, ...] = (),
) -> Plan:
    """The plan of these runs, with the parameters they will identify, checked against its own limits.

    Parameters
    ----------
    wished
        What was asked for, for the record.
    impossible
        Sentences on what no such program could identify.

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
