"""Measurement plans: the format, its reader and writer, and the runner that lets a robot execute one."""

from experiments.plans.cell import cell_of
from experiments.plans.errors import PlanError, PlanStopped
from experiments.plans.limits import Limits, limits_of
from experiments.plans.model import Cell, Expected, ExpectedParameter, Plan, Run, Sweep, Visit
from experiments.plans.motion import Course
from experiments.plans.read import read_plan
from experiments.plans.write import write_plan

__all__ = [
    "Cell",
    "Course",
    "Expected",
    "ExpectedParameter",
    "Limits",
    "Plan",
    "PlanError",
    "PlanStopped",
    "Run",
    "Sweep",
    "Visit",
    "cell_of",
    "limits_of",
    "read_plan",
    "write_plan",
]
