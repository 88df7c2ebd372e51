"""What plans of logged programs, in free air and of the wrist, have in common: their numbers, and what they tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Literal

import numpy as np

from clampid.planning.expected import expected_of
from clampid.planning.logs import LogBench
from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits
from experiments.plans.model import Plan, Run
from experiments.plans.validate import validate_plan

__all__ = ["check_program", "finished_program", "wishes"]


def check_program(time: float, speeds: Sequence[float], dwell: float, rate: float) -> None:
    """Refuse numbers that no program can have.

    Raises
    ------
    PlanError
        The first of them.
    """
    if not time > 0 or not np.isfinite(time):
        raise PlanError(f"time: expected seconds above 0, found {time:g}")
    if len(speeds) < 2 or len(set(speeds)) < len(speeds):
        raise PlanError(f"speeds: expected two or more different shares of the top speeds, found {list(speeds)}")
    for share in speeds:
        if not 0.0 < share <= 1.0:
            raise PlanError(f"speeds: expected shares of the top speeds above 0 and at most 1, found {share:g}")
    if not dwell > 0:
        raise PlanError(f"dwell: expected seconds above 0, found {dwell:g}")
    if not rate > 0:
        raise PlanError(f"rate: expected Hz above 0, found {rate:g}")


def wishes(time: float, speeds: Sequence[float], effects: Sequence[str], seed: int) -> dict[str, float | int | str]:
    """What was asked for, as the plan records it."""
    return {"time_s": time, "speeds": ", ".join(f"{s:g}" for s in speeds), "effects": ", ".join(effects), "seed": seed}


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
    """The plan of these runs, with what they will tell, held against its own limits.

    Parameters
    ----------
    wished
        What was asked for, for the record.
    impossible
        Sentences on what no such program could tell.

    Raises
    ------
    PlanError
        A move is beyond a limit.
    """
    informations = bench.tell([run.course for run in runs])
    information = np.sum([t.information.sum(axis=0) for t in informations], axis=0)
    rows = int(sum(t.rows.sum() for t in informations))
    plan = Plan(
        kind=kind,
        cell=bench.cell,
        limits=limits,
        duration=sum(run.course.length for run in runs),
        runs=runs,
        rate=bench.rate,
        expected=expected_of(bench.experiment, information, rows, bench.noise.words, impossible),
        assumed=tuple(assumed),
        wished=MappingProxyType(dict(wished)),
    )
    validate_plan(plan)
    return plan
