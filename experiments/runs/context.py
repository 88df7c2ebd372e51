"""The context that the parts of a run share: plan, robot, instrument, person, journal."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from experiments.instruments import Instrument
from experiments.plans.model import Plan
from experiments.plans.motion import Array
from experiments.runs.journal import Journal
from experiments.runs.people import Person
from experiments.runs.robot import ARRIVED, LinkedRobot

__all__ = ["SLOW", "Block", "Context", "place_on", "straight_to"]

SLOW = 0.1  # share of the top speeds for motions that no plan has checked
ON_PATH = 2e-3  # rad: farther from a planned line, somebody else has moved the robot

Say = Callable[[str], None]


@dataclass(frozen=True)
class Block:
    """What was finished: its name, its table, and the share of the plan that is done then, 0 to 1."""

    name: str
    table: str
    done: float


@dataclass
class Context:
    """One session of one run.

    Attributes
    ----------
    plan, robot, instrument, person, journal
        What is run, by whom, and where it is written.
    say
        For lines that a person reads while it runs.
    progress
        Gets the share that is done, 0 to 1, and what begins.
    finished
        Called after every block with what is finished; a text that it returns ends the run: enough is known.
    begun
        Whether this session has moved the robot yet.
    """

    plan: Plan
    robot: LinkedRobot
    instrument: Instrument | None
    person: Person
    journal: Journal
    say: Say
    progress: Callable[[float, str], None]
    finished: Callable[[Block], str | None]
    begun: bool = False


def place_on(path: Sequence[Array] | Array, here: Array) -> int | None:
    """On which piece of a path of straight lines the robot stands, from 0; None: on none.

    Piece i leads from ``path[i]`` to ``path[i + 1]``; where two fit, the earlier one is meant.
    """
    for i, (one, other) in enumerate(pairwise(path)):
        step = other - one
        share = float(np.clip((here - one) @ step / max(float(step @ step), 1e-18), 0.0, 1.0))
        if np.max(np.abs(here - one - share * step)) < ON_PATH:
            return i
    return None


def straight_to(context: Context, to: Array, step: str, path: Sequence[Array] | Array = ()) -> None:
    """Go slowly to a posture ``(n,)``; if that leaves a planned path, a person is asked first.

    Raises
    ------
    RunStopped
        The person said no.
    """
    here = context.robot.rest().joints
    off = np.abs(to - here)
    if np.max(off) < ARRIVED:
        return
    if len(path) == 0 or place_on(path, here) is None:
        j = int(np.argmax(off))
        facts = (
            f"The robot stands at {degrees(here)} deg.\n"
            f"It will go straight to {degrees(to)} deg: joint {j + 1} turns by {math.degrees(off[j]):.1f} deg, at "
            f"{SLOW:.0%} speed. No plan has checked this motion."
        )
        context.person.confirm(facts, "Is the way free?")
    context.robot.go(to, SLOW, step)


def degrees(q: Array) -> str:
    """Joint angles for a person."""
    return ", ".join(f"{math.degrees(v):.2f}" for v in q)
