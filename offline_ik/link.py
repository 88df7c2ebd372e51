"""What a robot, real or virtual, must offer to be commanded by the server, and any link of the suite as such a robot.

The links themselves, their protocol and their errors are in :mod:`experiments.links`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from experiments.links.protocol import Link, LinkError, Program
from offline_ik.errors import DetectorError

__all__ = ["MAX_AGE", "LinkedRobot", "RobotLink"]

Array = npt.NDArray[np.float64]

MAX_AGE = 0.5  # s: a posture that is older is refused, not passed on


class RobotLink(Protocol):
    """A robot that can be asked where it is, and moved. No call waits for the robot."""

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
        """Begin a move.

        Raises
        ------
        DetectorError
            It was refused, or there is no connection.
        """
        with _worded():
            self._program = self.link.execute(Program(postures, speed))

    def state(self) -> Mapping[str, Any]:
        """The last status with its age, the program sent last, and what a person has to look at."""
        found: dict[str, Any] = {"address": self.name, "question": self.link.open_question()}
        try:
            found |= self.link.status().to_json()
        except LinkError as error:
            found["lost"] = str(error)
        else:
            found["stale"] = found["age_s"] > MAX_AGE
        if self._program is not None:
            fate = self.link.fate(self._program)
            found["program"] = {"id": fate.id, "phase": str(fate.phase), "point": fate.point, "reason": fate.reason}
        return found

    def capabilities(self) -> Mapping[str, Any]:
        """What the link can do, and what its numbers are, for JSON."""
        return self.link.capabilities.to_json()

    def stop(self) -> None:
        """Stop at once, and let nothing move until `release`.

        Raises
        ------
        DetectorError
            The controller could not be told.
        """
        self._tell(self.link.stop)

    def release(self) -> None:
        """Lift the stop; as `stop`."""
        self._tell(self.link.release)

    def confirm(self) -> None:
        """A person has looked at the robot; as `stop`."""
        self._tell(self.link.confirm)

    def close(self) -> None:
        """Hang up."""
        self.link.close()

    def _tell(self, call: Callable[[], None]) -> None:
        with _worded():
            call()


@contextmanager
def _worded() -> Iterator[None]:
    """Errors of links as refusals of the server."""
    try:
        yield
    except LinkError as error:
        raise DetectorError(str(error)) from None
