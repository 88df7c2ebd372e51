"""The interface of a link to a robot of any vendor: values, calls and errors.

A link states its capabilities and the units of its numbers. It keeps the controller's last status with its age. It
sends a program of moves once and reports the result. If the result is unknown, the program is never sent again, and a
person must look and confirm. :mod:`experiments.links.programs` decides on the results.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, runtime_checkable

from experiments.links.errors import (
    CannotError,
    InterruptedProgramError,
    LinkError,
    LinkLostError,
    NotExecutedError,
    RefusedError,
    UnknownFateError,
)
from experiments.links.values import UNKNOWN_UNIT, Capabilities, Program, Recording, Signal, Status

__all__ = [
    "UNKNOWN_UNIT",
    "CannotError",
    "Capabilities",
    "Fate",
    "InterruptedProgramError",
    "Link",
    "LinkError",
    "LinkLostError",
    "NotExecutedError",
    "Phase",
    "Program",
    "Recording",
    "RefusedError",
    "Signal",
    "Status",
    "UnknownFateError",
]


class Phase(StrEnum):
    """Where a program is on its way."""

    SENT = "sent"
    RUNNING = "running"
    FINISHED = "finished"
    REFUSED = "refused"
    INTERRUPTED = "interrupted"
    NOT_EXECUTED = "not executed"
    UNKNOWN = "unknown"

    @property
    def final(self) -> bool:
        """Whether nothing more is expected."""
        return self not in (Phase.SENT, Phase.RUNNING)


@dataclass(frozen=True)
class Fate:
    """What is known of one program.

    Attributes
    ----------
    id
        Its number.
    phase
        Where it is.
    point
        The last point that was reached, from 1.
    reason
        In words, where it did not finish.
    """

    id: int
    phase: Phase
    point: int = 0
    reason: str = ""

    def checked(self) -> Fate:
        """The same, if it has finished or is on its way.

        Raises
        ------
        LinkError
            The error of its phase.
        """
        kind = _ERRORS.get(self.phase)
        if kind is None:
            return self
        where = f" after point {self.point}" if self.phase is Phase.INTERRUPTED else ""
        raise kind(f"program {self.id}: {_WORDS[self.phase]}{where}: {self.reason}")


_ERRORS: Mapping[Phase, type[LinkError]] = {
    Phase.REFUSED: RefusedError,
    Phase.INTERRUPTED: InterruptedProgramError,
    Phase.NOT_EXECUTED: NotExecutedError,
    Phase.UNKNOWN: UnknownFateError,
}
_WORDS: Mapping[Phase, str] = {
    Phase.REFUSED: "refused",
    Phase.INTERRUPTED: "interrupted",
    Phase.NOT_EXECUTED: "not executed",
    Phase.UNKNOWN: "its fate is unknown",
}


@runtime_checkable
class Link(Protocol):
    """A connection to one robot. Every call may come from any thread; none but `wait` and `recording` waits."""

    @property
    def capabilities(self) -> Capabilities:
        """What it can do, and what its numbers are."""
        ...

    def status(self) -> Status:
        """The last status, whatever its age.

        Raises
        ------
        LinkLostError
            None has ever come.
        """
        ...

    def execute(self, program: Program) -> int:
        """Begin a program and give its number, without waiting for the controller.

        Raises
        ------
        RefusedError
            It is not sent: another one is on its way, a person has to confirm, the robot is stopped.
        LinkLostError
            There is no connection, or the status is too old to move by.
        CannotError
            This link does not execute programs.
        """
        ...

    def fate(self, program: int) -> Fate:
        """What is known of a program of this link now."""
        ...

    def wait(self, program: int, patience: float) -> Fate:
        """Wait until a program has ended.

        Raises
        ------
        LinkError
            It did not finish; see :meth:`Fate.checked`. `LinkLostError`: it is still on its way after the patience, s.
        """
        ...

    def stop(self) -> None:
        """Stop at once, and let nothing move until `release`. Works from any thread, within 10 ms.

        Raises
        ------
        LinkLostError
            The controller could not be told. It is told as soon as there is a connection.
        """
        ...

    def release(self) -> None:
        """Lift the stop, once the robot stands."""
        ...

    def confirm(self) -> None:
        """A person has looked at the robot: what was unknown is settled, and moves are possible again."""
        ...

    def open_question(self) -> str | None:
        """What a person has to look at before anything moves again; None: nothing."""
        ...

    def recording(self, start: int, most: int = 1000, patience: float = 5.0) -> Recording:
        """Samples from a number on, as many as there are, at most ``most``; waits for them at most ``patience``, s."""
        ...

    def close(self) -> None:
        """Hang up. A program that runs is not stopped by that: the controller's watchdog ends it."""
        ...
