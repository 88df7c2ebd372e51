"""Capabilities and states of links, as frozen values; in SI units and radians, whatever the protocol uses."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from experiments.links.errors import RefusedError

__all__ = ["UNKNOWN_UNIT", "Capabilities", "Program", "Recording", "Signal", "Status"]

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]
Side = Literal["motor", "gear", "joint", "controller"]
Source = Literal["measured", "set point", "said"]
UNKNOWN_UNIT = "unit unknown"


@dataclass(frozen=True)
class Signal:
    """What one number of a link is.

    Attributes
    ----------
    name
        As in a campaign: joint, torque, current, temperature.
    unit
        Of what the link gives, or ``unit unknown`` where its settings do not say.
    side
        Where it acts: a motor torque and a gear torque are different quantities.
    kind
        Measured, a set point, or what the controller says without either.
    clock
        Which clock its time is of.
    period
        Least time between two values, s; None: as often as it is asked for.
    """

    name: str
    unit: str
    side: Side
    kind: Source
    clock: str
    period: float | None = None

    def to_json(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "name": self.name,
            "unit": self.unit,
            "side": self.side,
            "kind": self.kind,
            "clock": self.clock,
            "period_s": self.period,
        }


@dataclass(frozen=True)
class Capabilities:
    """What a link can do.

    Attributes
    ----------
    scheme
        Of its address.
    executes, stops, releases, records
        Whether it has those calls.
    stops_at_once
        Whether `stop` waits for nothing, neither for the controller nor for a network that is full.
    begins_at_once
        Whether `execute` waits for nothing either.
    longest_program
        Points of one program; 0 if it executes none.
    signals
        What it reads.
    cannot
        Sentences for a person: what is missing, and why.
    """

    scheme: str
    executes: bool = False
    stops: bool = False
    releases: bool = False
    records: bool = False
    stops_at_once: bool = False
    begins_at_once: bool = False
    longest_program: int = 0
    signals: tuple[Signal, ...] = ()
    cannot: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "scheme": self.scheme,
            "executes": self.executes,
            "stops": self.stops,
            "releases": self.releases,
            "records": self.records,
            "stops_at_once": self.stops_at_once,
            "begins_at_once": self.begins_at_once,
            "longest_program": self.longest_program,
            "signals": [signal.to_json() for signal in self.signals],
            "cannot": list(self.cannot),
        }


@dataclass(frozen=True, eq=False)
class Program:
    """Moves that are executed one after another, each to a stop.

    Attributes
    ----------
    postures
        ``(m, n)``, rad.
    speed
        Share of each axis's greatest speed, above 0, at most 1.
    """

    postures: Array
    speed: float

    def __post_init__(self) -> None:
        postures = np.atleast_2d(np.array(self.postures, dtype=np.float64))
        if postures.ndim != 2 or not len(postures) or not np.isfinite(postures).all():
            raise RefusedError("program: expected postures (m, n) of finite numbers, found others")
        if not 0.0 < self.speed <= 1.0:
            raise RefusedError(f"program: expected a speed above 0 and at most 1, found {self.speed:g}")
        postures.setflags(write=False)
        object.__setattr__(self, "postures", postures)


@dataclass(frozen=True, eq=False)
class Status:
    """The controller's last status, and when it came.

    Attributes
    ----------
    joints
        Measured ``(n,)``, rad.
    boot, accepted, running, finished, aborted, point, reason
        Of programs; None where the link has none. ``reason``: of the last refusal or abort, in words.
    stopped, drives, brakes_open, estop
        Whether the stop latch is set, the drives are on, the brakes are open, an emergency stop is pending.
    mode
        T1, T2, AUT or EXT.
    clock
        The controller's, s.
    torque, current
        ``(n,)`` in the units of the link's capabilities.
    temperature
        Of the motors ``(n,)``, degC.
    oldest, newest
        Numbers of the samples that the controller still has.
    moves
        Whether the joints turned between this status and those before; None: not known. An arm brakes on after its
        program was aborted.
    received
        ``time.monotonic()`` when it came, s.
    """

    joints: Array
    boot: int | None = None
    accepted: int | None = None
    running: int | None = None
    finished: int | None = None
    aborted: int | None = None
    point: int | None = None
    reason: str = ""
    stopped: bool | None = None
    mode: str | None = None
    drives: bool | None = None
    brakes_open: bool | None = None
    estop: bool | None = None
    clock: float | None = None
    torque: Array | None = None
    current: Array | None = None
    temperature: Array | None = None
    oldest: int | None = None
    newest: int | None = None
    moves: bool | None = None
    received: float = field(default_factory=time.monotonic)

    @property
    def age(self) -> float:
        """Since it came, s."""
        return time.monotonic() - self.received

    def to_json(self) -> dict[str, Any]:
        """For JSON, with its age."""
        arrays = {"torque": self.torque, "current": self.current, "temperature_C": self.temperature}
        return {
            "q_rad": self.joints.tolist(),
            "age_s": self.age,
            "boot": self.boot,
            "accepted": self.accepted,
            "running": self.running,
            "finished": self.finished,
            "aborted": self.aborted,
            "point": self.point,
            "reason": self.reason,
            "stopped": self.stopped,
            "mode": self.mode,
            "drives": self.drives,
            "brakes_open": self.brakes_open,
            "estop": self.estop,
            "clock_s": self.clock,
            "moves": self.moves,
            **{name: None if value is None else value.tolist() for name, value in arrays.items()},
        }


@dataclass(frozen=True, eq=False)
class Recording:
    """Samples that the controller has recorded.

    Attributes
    ----------
    number
        Consecutive in the controller ``(m,)``; a jump is a gap.
    time
        Of the controller's clock ``(m,)``, s.
    joints
        Measured ``(m, n)``, rad.
    torque, current
        ``(m, n)`` in the units of the link's capabilities.
    lost
        First and last number of what was asked for and is no longer there; None: nothing is missing.
    newest
        Number of the newest sample that the controller has.
    """

    number: Numbers
    time: Array
    joints: Array
    torque: Array
    current: Array
    lost: tuple[int, int] | None
    newest: int
