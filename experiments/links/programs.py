"""The states of a program: the state machine of every link.

A program is sent once. Only an event or a status of the controller changes its state. After the connection was lost,
silence proves nothing. The program counts as *not executed* only if the controller says so after it has dropped all
received data (a fence: see `Programs.fenced`). Otherwise it is *unknown* once the patience is over. ::

    sent ──accepted──▶ running ──▶ finished | interrupted
      │                   └───────▶ unknown       (another boot; patience over)
      └──▶ refused | not executed | unknown
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from dataclasses import dataclass, replace

from experiments.links.protocol import Fate, LinkLostError, Phase, RefusedError, Status

__all__ = ["MAX_AGE", "Programs"]

MAX_AGE = 0.5  # s: no motion is sent on the basis of an older status
CONFIRMED = 1.0  # s within which a status should say what an event has said; then the event counts alone
REMEMBERED = 1000  # programs whose fate can be asked for


@dataclass
class _Current:
    """The program that is on its way."""

    boot: int
    fate: Fate
    count: int
    since: float  # of the last evidence, monotonic s
    ending: Fate | None = None  # what an event said; a status that says so too, with the posture of then, ends it


class Programs:
    """The programs of one link. All calls may come from any thread.

    Parameters
    ----------
    patience
        How long a program may be without any evidence before it counts as unknown, s.
    """

    def __init__(self, patience: float) -> None:
        self.patience = patience
        self._changed = threading.Condition()
        self._current: _Current | None = None
        self._ended: OrderedDict[int, Fate] = OrderedDict()
        self._question: str | None = None
        self._boot: int | None = None
        self._last = 0

    @property
    def question(self) -> str | None:
        """What a person has to confirm before anything moves."""
        return self._question

    def current(self) -> Fate | None:
        """The program that is on its way."""
        with self._changed:
            return None if self._current is None else self._current.fate

    def begin(self, status: Status, count: int) -> Fate:
        """Admit a program; its number is new to the controller and to this link.

        Parameters
        ----------
        status
            The last one.
        count
            Points of the program.

        Raises
        ------
        RefusedError, LinkLostError
            It may not be sent.
        """
        with self._changed:
            running = status.running or 0
            if running in self._ended and self._ended[running].phase in (Phase.FINISHED, Phase.INTERRUPTED):
                running = 0  # an event came after the status
            _refuse_by(status, running)
            if self._current is not None:
                raise RefusedError(f"program {self._current.fate.id} is on its way; another one is not taken")
            if self._question is not None:
                raise RefusedError(f"a person has to look and confirm first: {self._question}")
            boot = status.boot or 0
            number = max(status.accepted or 0, status.finished or 0, status.aborted or 0, self._last) + 1
            self._last = number
            self._current = _Current(boot, Fate(number, Phase.SENT), count, time.monotonic())
            return self._current.fate

    def not_sent(self, number: int, why: str) -> None:
        """Nothing of it has left this machine."""
        self._settle(number, Phase.NOT_EXECUTED, why, question=False)

    def accepted(self, boot: int, number: int) -> None:
        """The controller says that it moves."""
        self._advance(boot, number, 0)

    def reached(self, boot: int, number: int, point: int) -> None:
        """The controller says that a point was reached."""
        self._advance(boot, number, point)

    def ended(self, boot: int, number: int, phase: Phase, point: int, reason: str) -> None:
        """The controller says how it ended: finished, refused or interrupted.

        The program counts as ended once a status says so too: then the last status is of the robot at rest.
        """
        with self._changed:
            current = self._current
            if current is None or current.boot != boot or current.fate.id != number:
                return
            if phase is Phase.REFUSED and current.fate.phase is Phase.RUNNING:
                return  # a fence's answer, or another client's: it had been accepted
            point = max(point, current.fate.point)
            if phase is Phase.REFUSED:
                self._end(phase, point, reason)
                return
            current.ending = Fate(number, phase, point, reason)
            current.since = time.monotonic()

    def seen(self, status: Status) -> None:
        """Update the state from what a status says of programs."""
        with self._changed:
            boot = status.boot
            if self._boot is None and status.running:
                self._question = f"program {status.running} of another client was running when this one connected"
            elif self._boot is not None and boot != self._boot:
                self._question = self._question or "the controller's programs were started again"
            self._boot = boot
            current = self._current
            if current is None:
                return
            if boot != current.boot and current.ending is not None:
                self._end(current.ending.phase, current.ending.point, current.ending.reason)
            elif boot != current.boot:
                self._end(Phase.UNKNOWN, current.fate.point, "the controller's programs were started again meanwhile")
            else:
                self._compare(current, status)

    def _compare(self, current: _Current, status: Status) -> None:
        number, point = current.fate.id, status.point or 0
        if number in (status.running, status.finished, status.aborted):
            point = max(point, current.fate.point)
            if status.running == number:
                current.fate = replace(current.fate, phase=Phase.RUNNING, point=point)
                current.since = time.monotonic()
            elif status.finished == number:
                self._end(Phase.FINISHED, current.count, "")
            else:
                self._end(Phase.INTERRUPTED, point, status.reason)
        elif (status.accepted or 0) > number:
            self._end(Phase.UNKNOWN, current.fate.point, f"program {status.accepted} of another client came after it")

    def fenced(self, number: int, status: Status) -> None:
        """Decide by a status requested after the controller had dropped all data of the program."""
        self.seen(status)
        with self._changed:
            current = self._current
            if current is None or current.fate.id != number or current.fate.phase is not Phase.SENT:
                return
            if (status.accepted or 0) < number and status.running != number:
                self._end(Phase.NOT_EXECUTED, 0, "the connection broke before the controller had all of it")

    def tick(self) -> None:
        """Let the patience run out."""
        with self._changed:
            current = self._current
            if current is None:
                return
            silent = time.monotonic() - current.since
            if current.ending is not None and silent > CONFIRMED:
                self._end(current.ending.phase, current.ending.point, current.ending.reason)
            elif silent > self.patience:
                why = f"nothing was heard of it for {self.patience:g} s: look at the robot"
                self._end(Phase.UNKNOWN, current.fate.point, why)

    def ask_person(self, question: str) -> None:
        """Refuse programs until a person confirms."""
        with self._changed:
            self._question = self._question or question

    def confirm(self) -> None:
        """A person has looked.

        Raises
        ------
        RefusedError
            A program is still on its way.
        """
        with self._changed:
            if self._current is not None:
                raise RefusedError(f"program {self._current.fate.id} is on its way; there is nothing to confirm yet")
            self._question = None

    def fate(self, number: int) -> Fate:
        """What is known of a program."""
        with self._changed:
            return self._known(number)

    def wait(self, number: int, patience: float) -> Fate:
        """Wait until it has ended; see :meth:`experiments.links.protocol.Link.wait`."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._known(number).phase.final, patience):
                raise LinkLostError(f"program {number}: still {self._known(number).phase} after {patience:g} s")
            return self._known(number).checked()

    def _known(self, number: int) -> Fate:
        if self._current is not None and self._current.fate.id == number:
            return self._current.fate
        if number not in self._ended:
            raise RefusedError(f"program {number}: this link has sent none of that number")
        return self._ended[number]

    def _advance(self, boot: int, number: int, point: int) -> None:
        with self._changed:
            current = self._current
            if current is None or current.boot != boot or current.fate.id != number:
                return
            current.fate = replace(current.fate, phase=Phase.RUNNING, point=max(point, current.fate.point))
            current.since = time.monotonic()

    def _settle(self, number: int, phase: Phase, reason: str, question: bool) -> None:
        with self._changed:
            if self._current is not None and self._current.fate.id == number:
                self._end(phase, self._current.fate.point, reason, question)

    def _end(self, phase: Phase, point: int, reason: str, question: bool = True) -> None:
        """Close the current program; with the lock held."""
        if self._current is None:
            return
        fate = replace(self._current.fate, phase=phase, point=point, reason=reason)
        self._ended[fate.id] = fate
        while len(self._ended) > REMEMBERED:
            self._ended.popitem(last=False)
        self._current = None
        if question and phase in (Phase.UNKNOWN, Phase.NOT_EXECUTED):
            self._question = f"program {fate.id}: {phase}: {reason}"
        self._changed.notify_all()


def _refuse_by(status: Status, running: int) -> None:
    """Refuse a program that the controller would refuse, according to its last status."""
    if status.age > MAX_AGE:
        raise LinkLostError(f"the robot's status is {status.age:.1f} s old, too old to move by")
    refusals = (
        (status.stopped, "the robot was stopped, and not released since"),
        (status.estop, "there is an emergency stop"),
        (running, f"program {running} is running"),
        (status.mode not in (None, "AUT", "EXT"), f"the operating mode is {status.mode}, not AUT or EXT"),
        (status.drives is False, "the drives are off"),
    )
    for holds, why in refusals:
        if holds:
            raise RefusedError(why)
