"""The linked robot as clients see it: who holds it, which motion is under way, how the last one ended.

One motion at a time, under a number. A motion that was begun here has ended when the link says that the robot stands;
where it ended is compared with where it was to end. Coordinates that a client reads while the robot stands are the
*accepted* ones, not the measured ones: who reads, changes one axis and writes all back would otherwise command the
other axes' residuals again, and the robot would creep.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from offline_ik.exchange.requests import RequestError
from offline_ik.exchange.session import Session
from offline_ik.reflections.place import Place, place_of

if TYPE_CHECKING:
    from offline_ik.exchange.link import RobotLink
    from offline_ik.inverse.detector import Detector

__all__ = ["LOOK", "Ended", "LinkedRobot"]

Array = npt.NDArray[np.float64]

STOOD_STILL = 1e-3  # rad by which a robot that stands may have moved and still be where it was
OLD = 2.0  # s, beyond which what a link says of the robot is no longer believed
LOOK = 0.01  # s between two looks at whether a motion has ended
MOTIONS_KEPT = 64  # ends of motions that are remembered


class Ended(NamedTuple):
    """How a motion ended.

    Attributes
    ----------
    outcome
        ``arrived``, ``stopped``, ``failed``, ``elsewhere`` (the robot stands where it was not sent), ``unknown`` (the
        link fell silent) or ``not begun``.
    reason
        More about it, where there is more.
    """

    number: int
    outcome: str
    reason: str = ""

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {"number": self.number, "outcome": self.outcome, "reason": self.reason}


@dataclass
class LinkedRobot:
    """A robot behind a link.

    Attributes
    ----------
    number
        Of the last motion that was begun here.
    stops
        How many stops were asked for.
    mover
        Who asked for the motion that is under way.
    keeper
        Who keeps the robot between motions (`hold`).
    refusal
        Why the last `move` was refused; empty where it was not.
    begun
        A motion was begun here, and neither its end is known nor was it stopped.
    """

    link: RobotLink
    clock: Callable[[], float] = time.monotonic
    number: int = 0
    stops: int = 0
    refusals: int = 0
    refusal: str = ""
    begun: bool = False
    mover: Session | None = None
    keeper: Session | None = None
    ends: OrderedDict[int, Ended] = field(default_factory=OrderedDict)
    _sending: bool = False
    _open: bool = False
    _stops_then: int = 0
    _since: float = 0.0
    _target: Array | None = None
    _from: Array | None = None
    _setpoint: dict[str, float] | None = None
    _rest: Array | None = None
    _seen: tuple[Detector, bool, Array, Place, dict[str, Any]] | None = None

    def refresh(self) -> bool:
        """Look whether it moves; a motion that has ended is noted."""
        return self._sending or self._look(self.link.state())

    def _look(self, state: Mapping[str, Any]) -> bool:
        age = state.get("age_s")
        if self._open and age is not None and age > OLD:
            self._end("unknown", f"the link has not heard from the robot for {age:.1f} s")
        moving = bool(state.get("moving", False))
        if "moving" in state and not moving:
            self.begun = False
        if self._open and not moving:
            self._conclude(state)
        return moving

    def _conclude(self, state: Mapping[str, Any]) -> None:
        here = self.link.posture()
        there = self._target is not None and bool(np.abs(here - self._target).max() <= STOOD_STILL)
        if state.get("failed"):
            self._end("failed", str(state["failed"])[:500])
        elif there:
            self._end("arrived")
        elif self.stops != self._stops_then:
            self._end("stopped")
        else:
            self._end("elsewhere", "the robot stands where this motion was not to end")

    def _end(self, outcome: str, reason: str = "") -> None:
        self._open = False
        self.mover = None
        if outcome != "arrived":
            self._setpoint = None
        self.ends[self.number] = Ended(self.number, outcome, reason)
        while len(self.ends) > MOTIONS_KEPT:
            self.ends.popitem(last=False)

    def check_free(self, session: Session) -> None:
        """Refuse who may not move it now.

        Raises
        ------
        RequestError
            It moves, somebody else keeps it, or the link does not know where it is.
        """
        state = self.link.state()
        moving = self._sending or self._look(state)
        if self.keeper is not None and self.keeper is not session:
            raise RequestError(f"move: {self.keeper.called} holds the robot; ask again when it is released")
        if moving and self.mover is not None:
            whose = "this connection" if self.mover is session else self.mover.called
            raise RequestError(f"move: the robot moves for {whose}; ask again when it stands")
        if moving:
            raise RequestError("move: the robot moves, and not for this server; ask again when it stands")
        age = state.get("age_s")
        if age is not None and age > OLD:
            raise RequestError(f"move: the link has not heard from the robot for {age:.1f} s; nothing moves")

    def hold(self, session: Session) -> None:
        """Keep it for a client.

        Raises
        ------
        RequestError
            Somebody else keeps or moves it.
        """
        self.refresh()
        for other in (self.keeper, self.mover):
            if other is not None and other is not session:
                raise RequestError(f"hold: {other.called} holds the robot")
        self.keeper, self._since = session, self.clock()

    def release(self, session: Session) -> None:
        """End what `hold` began; a motion that is under way goes on."""
        if self.keeper is session:
            self.keeper = None

    def begin(self, session: Session, asked: Mapping[str, float], here: Array, postures: Array) -> int:
        """Note a motion that is about to be sent; its number."""
        self.number += 1
        self._sending = self._open = self.begun = True
        self.mover, self._stops_then = session, self.stops
        if self.keeper is not session:
            self._since = self.clock()
        self._target = self._rest = np.array(postures[-1])
        self._from = np.array(postures[-2] if len(postures) > 1 else here)
        self._setpoint = dict(asked)
        self._seen = None
        self.refusal = ""
        return self.number

    def send(self, postures: Array, speed: float) -> None:
        """Send it; in a thread of its own, because a link may wait for the controller.

        Raises
        ------
        CallError
            The link refuses it.
        """
        try:
            self.link.move(postures, speed)
        except Exception as error:
            self._end("not begun", str(error))
            self.begun = False
            raise
        finally:
            self._sending = False
        if self.stops != self._stops_then:  # a stop that came while it was being sent may have come before it
            self.link.stop()

    @property
    def executes(self) -> bool:
        """Whether the link moves a robot at all; some only read."""
        return bool(getattr(self.link, "executes", True))

    @property
    def stops_at_once(self) -> bool:
        """Whether the link's `stop` waits for nothing, and needs no thread of its own."""
        return bool(getattr(self.link, "stops_at_once", False))

    @property
    def begins_at_once(self) -> bool:
        """Whether the link's `move` waits for nothing now, and needs no thread of its own."""
        return bool(getattr(self.link, "begins_at_once", False))

    def stop(self) -> None:
        """Stop it at once, whoever moves it."""
        self.link.stop()
        self.begun = False

    def wait(self, number: int, patience: float) -> None:
        """Wait, in a thread, until a motion has ended; the server waits on its loop instead."""
        limit = time.monotonic() + patience
        while not self.has_ended(number) and time.monotonic() < limit:
            time.sleep(LOOK)

    def has_ended(self, number: int) -> bool:
        """Whether a motion, or whatever moves where the number is 0, has ended."""
        moving = self.refresh()
        return number in self.ends if number else not moving

    def refuse(self, reason: str) -> None:
        """Note why a `move` was refused."""
        self.refusal, self.refusals = reason, self.refusals + 1

    def place(self, detector: Detector) -> tuple[Array, Place, dict[str, Any]]:
        """Where it is: joint angles ``(n,)``, what they mean on the sphere, and the same as members of an answer.

        What is the same as at the last call is not computed again: a robot that stands is looked at often.
        """
        here = detector.check_posture(self.link.posture(), "the robot's posture")
        known = self._target is not None and bool(np.abs(here - self._target).max() <= STOOD_STILL)
        seen = self._seen
        if seen is not None and seen[0] is detector and seen[1] is known and np.array_equal(seen[2], here):
            return here, seen[3], seen[4]
        place = place_of(detector, here, self._from if known else None)
        frames = detector.framing(detector.to_base(place.pose), here)
        reply = {"q_rad": here.tolist(), **place.to_json(), **frames}
        self._seen = (detector, known, here.copy(), place, reply)
        return here, place, reply

    def setpoint(self, here: Array, place: Place, moving: bool) -> dict[str, float]:
        """The accepted coordinates; where the robot was moved otherwise, those where it was first seen to stand."""
        away = self._rest is None or np.abs(here - self._rest).max() > STOOD_STILL
        if self._setpoint is None or (away and not moving):
            at = place.angles
            found = {"gamma_rad": at.gamma, "delta_rad": at.delta, "r_m": at.r, "roll_rad": at.roll}
            if moving:
                return found
            self._setpoint, self._rest = found, here
        return self._setpoint

    def holder(self) -> dict[str, Any] | None:
        """Who holds it, for a person to read: who keeps it, or else who moves it."""
        who = self.keeper or self.mover
        if who is None:
            return None
        return {
            "name": who.name or None,
            "address": who.address,
            "keeps": self.keeper is not None,
            "moves": self.mover is who,
            "since_s": self.clock() - self._since,
        }
