"""A measurement plan as frozen values: the motions, their limits, and what they will identify."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

import numpy as np

from experiments.plans.limits import Limits
from experiments.plans.motion import Array, Course
from kinematics.description import RobotDescription

__all__ = [
    "KINDS",
    "Cell",
    "Expected",
    "ExpectedParameter",
    "Kind",
    "LeastTorque",
    "Plan",
    "Run",
    "Steady",
    "Sweep",
    "Visit",
    "table_of",
]

Kind = Literal["free_air", "wrist", "clamping", "poses"]
KINDS: tuple[Kind, ...] = ("free_air", "wrist", "clamping", "poses")


@dataclass(frozen=True)
class Cell:
    """The robot and its surroundings, as the campaign's header will state them.

    Attributes
    ----------
    robot
        The nominal robot.
    reference
        What the campaign calls it: a bundled name or a path.
    gravity
        ``(3,)`` m/s², robot base frame.
    tool_mass, tool_com
        kg, and ``(3,)`` m in the flange frame: as the controller was told.
    targets
        Tracked points ``(3,)`` in the flange frame, m.
    instrument
        Its name.
    position_std
        One sigma per axis, m.
    """

    robot: RobotDescription
    reference: str
    gravity: Array
    tool_mass: float
    tool_com: Array
    targets: Mapping[str, Array]
    instrument: str
    position_std: float


@dataclass(frozen=True)
class Run:
    """One logged program in free air."""

    course: Course
    speed_share: float


@dataclass(frozen=True)
class Sweep:
    """One joint driven back and forth in steps, the flange clamped.

    Attributes
    ----------
    clamping
        From 1; the flange is clamped anew where it changes.
    joint
        From 0.
    posture
        ``(n,)`` rad, in which the flange was clamped.
    offset
        ``(m,)`` rad: by how much the joint is commanded beyond the posture, step by step.
    dwell
        s, at each step before it is read.
    force, moment
        ``(m,)`` N and Nm: what the clamp is expected to carry at each step, at most.
    """

    clamping: int
    joint: int
    posture: Array
    offset: Array
    dwell: float
    force: Array
    moment: Array


@dataclass(frozen=True)
class Visit:
    """One arrival at a pose, and what is measured there.

    Attributes
    ----------
    table
        ``poses`` or ``verification``.
    pose, visit
        From 1.
    via
        ``(n,)`` rad: from where the pose is approached, so that the last direction of every joint is known.
    q
        ``(n,)`` rad.
    duration, ramp
        ``(2,)`` s: of the moves to ``via`` and to ``q``.
    targets
        Which points are measured; none of a visit that only moves.
    times
        How often the move from ``via`` to ``q`` is made, each time back to ``via`` in between.
    wait
        s that the robot stands at ``q`` before it is measured.
    """

    table: Literal["poses", "verification"]
    pose: int
    visit: int
    via: Array
    q: Array
    duration: Array
    ramp: Array
    targets: tuple[str, ...]
    times: int = 1
    wait: float = 0.0

    def length(self, measure_time: float) -> float:
        """Time that it takes, s, with ``measure_time`` for each target; both ways of a swing take the same."""
        moves = float(self.duration[0]) + (2 * self.times - 1) * float(self.duration[1])
        return moves + self.wait + measure_time * len(self.targets)

    @property
    def direction(self) -> Array:
        """Last direction ``(n,)`` of each joint, ±1; 0 where it does not move."""
        return np.sign(self.q - self.via)


@dataclass(frozen=True)
class ExpectedParameter:
    """What the plan will know of one parameter; SI."""

    name: str
    unit: str
    size: float
    std: float
    identified: bool


@dataclass(frozen=True)
class Expected:
    """What the plan will identify, for the assumed noise.

    Attributes
    ----------
    indices
        Observability indices O1 … O5 and the number of ``parameters`` that they are of.
    parameters
        Standard errors.
    not_identified
        Sentences on what stays open.
    noise
        The noise that was assumed, in words.
    """

    indices: Mapping[str, float]
    parameters: tuple[ExpectedParameter, ...]
    not_identified: tuple[str, ...]
    noise: str


@dataclass(frozen=True)
class Steady:
    """When a robot is warm.

    Attributes
    ----------
    rate
        K/h: steady is a sensor that changes more slowly, against the air where that is measured.
    beyond
        s for which all of them have to stay so.
    """

    rate: float
    beyond: float


@dataclass(frozen=True, eq=False)
class LeastTorque:
    """The search for the posture of least torque, after a clamp is closed and before its first sweep.

    Attributes
    ----------
    step, within
        ``(n,)`` rad: of one step of each joint, and how far from the clamped posture it may go.
    """

    step: Array
    within: Array


@dataclass(frozen=True)
class Plan:
    """A plan: the cell, the limits, the steps in their order, and what they will identify.

    Attributes
    ----------
    rate
        Hz, of the logs in free air.
    measure_time
        s for each tracked point.
    steady
        Warming up ends when temperatures have been steady for long enough; None: only with the last step.
    least_torque
        How the posture of least torque is searched for in each clamping; None: it is not.
    assumed
        Assumptions where nothing was stated, in words.
    wished
        The request that it was made from (time budget, seed, …), for the record.
    """

    kind: Kind
    cell: Cell
    limits: Limits
    duration: float
    runs: tuple[Run, ...] = ()
    sweeps: tuple[Sweep, ...] = ()
    visits: tuple[Visit, ...] = ()
    start: Array | None = None
    rate: float = 10.0
    measure_time: float = 3.0
    stiffness: Array | None = None
    expected: Expected | None = None
    steady: Steady | None = None
    least_torque: LeastTorque | None = None
    assumed: tuple[str, ...] = ()
    wished: Mapping[str, float | int | str] = field(default_factory=lambda: MappingProxyType({}))


def table_of(kind: Kind) -> tuple[str, ...]:
    """The campaign's tables that a kind of plan fills."""
    return {
        "free_air": ("free_air",),
        "wrist": ("wrist",),
        "clamping": ("clamped",),
        "poses": ("poses", "verification"),
    }[kind]
