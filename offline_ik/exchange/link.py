"""What a robot, real or virtual, must offer to be commanded by the server, and any link of the suite as such a robot.

The links themselves, their protocol and their errors are in :mod:`experiments.links`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from experiments.links.protocol import Link, LinkError, Phase, Program, RefusedError
from experiments.links.schema import Reason
from offline_ik.errors import DetectorError

__all__ = ["MAX_AGE", "LinkedRobot", "RobotLink"]

Array = npt.NDArray[np.float64]

LIFT = 1.0  # s within which a stop has to be lifted before a move
PAUSE = 0.005  # s between two looks
THERE = 1e-3  # rad from its end within which a program's arm has arrived, and settles
MAX_AGE = 0.5  # s: a posture that is older is refused, not passed on


class RobotLink(Protocol):
    """A robot that can be asked where it is, and moved. No call waits for the robot, but `move` after a stop."""

    def posture(self) -> Array:
        """Joint angles now ``(n,)``, rad.

        Raises
        ------
        CallError
            They are not known now.
        """
        ...

    def move(self, postures: Array, speed: float) -> None:
        """Begin a move through postures ``(m, n)``, rad, at a share of the greatest speeds; return at once.

        Raises
        ------
        CallError
            It cannot: another one is under way, the drives are off. The client is told why.
        """
        ...

    def state(self) -> Mapping[str, Any]:
        """What the link says of itself, for JSON."""
        ...

    def stop(self) -> None:
        """Stop at once."""
        ...


class LinkedRobot:
    """A link as the robot of a server: the last status with its age, errors as the server's own.

    Parameters
    ----------
    link
        Open.
    name
        Its address, for people.
    """

    def __init__(self, link: Link, name: str) -> None:
        self.link, self.name = link, name
        self._program: int | None = None
        self._goal: Array | None = None  # of that program
        self._stops = 0
        self._stopped_here = False  # the latch that is set is this server's to lift
        with suppress(LinkError):  # a person has just started the server: a stop of before is lifted by a move
            self._stopped_here = bool(link.status().stopped)

    def posture(self) -> Array:
        """Joint angles of the last status ``(n,)``, rad.

        Raises
        ------
        DetectorError
            There is none, or it is too old.
        """
        with _worded():
            status = self.link.status()
        if status.age > MAX_AGE:
            raise DetectorError(f"the robot's posture is not known: its last status is {status.age:.1f} s old")
        return status.joints

    def move(self, postures: Array, speed: float) -> None:
        """Begin a move. After a stop of this server's own it lifts the latch first, which takes up to `LIFT`.

        Raises
        ------
        DetectorError
            It was refused, or there is no connection.
        """
        with _worded():
            program = Program(postures, speed)
            question = self.link.open_question()
            if question is not None:  # before a stop is lifted
                raise RefusedError(f"a person has to look and confirm first: {question}")
            if self._stopped_here:
                self._lift()
            self._program = self.link.execute(program)
            self._goal = program.postures[-1]

    def _lift(self) -> None:
        """Lift the stop that was asked for here, once the robot stands, unless another one comes meanwhile."""
        stops, end, released = self._stops, time.monotonic() + LIFT, math.inf
        while time.monotonic() < end and self._stops == stops:
            status = self.link.status()
            if not status.stopped and (status.received > released or not self._stops):
                self._stopped_here = False
                return
            with suppress(RefusedError):  # not acknowledged yet, or the robot still brakes
                self.link.release()
                released = min(released, time.monotonic())
            time.sleep(PAUSE)
        raise RefusedError("the robot was stopped, and the stop could not be lifted")

    def state(self) -> Mapping[str, Any]:
        """The last status with its age, the program sent last, and what a person has to look at.

        ``moving``: a program of this link is on its way, the controller runs one, or the arm still brakes after one
        that was aborted, or is moved by hand. ``failed``: why the last program
        of this link did not finish, where it was not simply stopped.
        """
        found: dict[str, Any] = {"address": self.name, "question": self.link.open_question()}
        running = turns = False
        try:
            status = self.link.status()
        except LinkError as error:
            found["lost"] = str(error)
        else:
            found |= status.to_json()
            found["stale"], running = found["age_s"] > MAX_AGE, bool(status.running)
            goal = self._goal
            turns = bool(status.moves) and (goal is None or np.abs(status.joints - goal).max() > THERE)
        fate = None if self._program is None else self.link.fate(self._program)
        if fate is not None:
            found["program"] = {"id": fate.id, "phase": str(fate.phase), "point": fate.point, "reason": fate.reason}
        ended = fate is None or fate.phase.final
        well = fate is None or fate.phase is Phase.FINISHED or not ended or fate.reason.startswith(Reason.STOPPED.words)
        found["moving"] = running or not ended or turns
        found["failed"] = None if well or fate is None else f"{fate.phase}: {fate.reason}"
        return found

    @property
    def executes(self) -> bool:
        """Whether it moves the robot at all."""
        return self.link.capabilities.executes

    @property
    def stops_at_once(self) -> bool:
        """Whether `stop` waits for nothing."""
        return self.link.capabilities.stops_at_once

    @property
    def begins_at_once(self) -> bool:
        """Whether `move` waits for nothing now."""
        return self.link.capabilities.begins_at_once and not self._stopped_here

    def capabilities(self) -> Mapping[str, Any]:
        """What the link can do, and what its numbers are, for JSON."""
        return self.link.capabilities.to_json()

    def stop(self) -> None:
        """Stop at once, and let nothing move but a later `move`.

        Raises
        ------
        DetectorError
            The controller could not be told.
        """
        self._stops += 1
        self._stopped_here = True
        self._call(self.link.stop)

    def release(self) -> None:
        """Lift the stop; as `stop`."""
        self._call(self.link.release)

    def confirm(self) -> None:
        """A person has looked at the robot: questions are settled, and the next `move` lifts a stop of whoever."""
        self._call(self.link.confirm)
        self._stopped_here = True

    def close(self) -> None:
        """Hang up."""
        self.link.close()

    def _call(self, call: Callable[[], None]) -> None:
        with _worded():
            call()


@contextmanager
def _worded() -> Iterator[None]:
    """Errors of links as refusals of the server."""
    try:
        yield
    except LinkError as error:
        raise DetectorError(str(error)) from None
