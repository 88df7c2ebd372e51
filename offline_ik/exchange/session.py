"""The session of a client: its settings, and the answers to its requests, at once or after a computation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from clampid.wrong_call import CallError

if TYPE_CHECKING:
    from offline_ik.inverse.detector import Detector
    from offline_ik.server.protocol import Speaker

__all__ = ["Job", "Later", "Reply", "Session"]

Array = npt.NDArray[np.float64]
Lane = Literal["compute", "soon", "link", "stop", "wait"]


class Reply(NamedTuple):
    """What a request is answered with: members of the answer."""

    data: dict[str, Any]


class Later(NamedTuple):
    """What a request is answered with once something is done that takes long.

    Attributes
    ----------
    work
        Does it, with a given detector, and touches nothing else: it may run in another thread.
    then
        Makes the answer of that, or says what has to be done next; here sessions change.
    lane
        Where it is done: computed; at once, but after what else has come; a motion sent over the link; the robot
        stopped; or waited until motion ``number`` has ended, at most for ``patience`` s.
    """

    work: Callable[[Detector], Any]
    then: Callable[[Any], Reply | Later]
    lane: Lane = "compute"
    number: int = 0
    patience: float = 0.0


@dataclass
class Session:
    """What one client has said.

    Attributes
    ----------
    here
        The posture that its stream is at ``(n,)``, rad.
    done
        It wants to end.
    closed
        Its side of the connection is closed: whether anybody waits for an answer is not known.
    count
        Targets of its stream.
    greeted
        It has said `hello`, with the token where there is one: it may change what others see, and move.
    only_stop
        There are too many connections; of this one nothing but `stop` is heard.
    name, address
        What it calls itself, and where it calls from.
    """

    here: Array | None = None
    done: bool = False
    closed: bool = False
    count: int = 0
    greeted: bool = False
    only_stop: bool = False
    name: str = ""
    address: str = ""

    @property
    def called(self) -> str:
        """Who that is, for others to read."""
        return f"{self.name or 'a client without a name'}{f' ({self.address})' if self.address else ''}"


@dataclass(frozen=True)
class Job:
    """A request whose answer takes long: :meth:`run` may be called in another thread, :meth:`end` not."""

    speaker: Speaker
    word: str
    given: Mapping[str, str]
    later: Later

    def run(self, detector: Detector) -> Any:
        """What takes long, on a detector that nobody else uses meanwhile; a refusal is a result as well."""
        try:
            return self.later.work(detector)
        except CallError as error:
            return error

    def end(self, found: Any) -> bytes | Job:
        """The answer, of what :meth:`run` found, or what has to be done next."""
        if isinstance(found, CallError):
            return self.speaker.refuse_request(self.word, found, self.given)
        try:
            reply = self.later.then(found)
        except CallError as error:
            return self.speaker.refuse_request(self.word, error, self.given)
        if isinstance(reply, Later):
            return replace(self, later=reply)
        return self.speaker.line_of(self.word, self.given, reply)
