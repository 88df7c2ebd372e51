"""The state channel of an EthernetKRL link: one thread asks each 20 ms; a stop goes out from any thread."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from experiments.links.connection import Backoff, Connection, Wake, readable
from experiments.links.protocol import LinkLostError, Status
from experiments.links.schema import AXES, STATE, Kind, Mode, Reason, document
from experiments.links.splitter import StreamError, values_of
from experiments.links.turning import Turning

__all__ = ["StateChannel", "status_of"]

Array = npt.NDArray[np.float64]
Values = Mapping[str, float]

SILENCE = 1.0  # s without an answer, after which the connection counts as dead
MOST_ASKED = 8  # questions on their way, short of the controller's buffers
ABSOLUTE_ZERO = -273.15  # degC
ROOT = STATE.send[0].root


class StateChannel:
    """Asks for the state, and keeps the last one.

    Parameters
    ----------
    host, port
        Of the state channel.
    notify
        Called with each status, from this channel's thread.
    tick
        Called each period, from this channel's thread.
    period
        Between two questions, s.
    """

    def __init__(
        self,
        host: str,
        port: int,
        notify: Callable[[Status], None],
        tick: Callable[[], None],
        period: float = 0.02,
    ) -> None:
        self._where, self._notify, self._tick, self._period = (host, port), notify, tick, period
        self._lock = threading.Lock()  # of sending: held for as long as a send that does not wait
        self._answered = threading.Condition()
        self._connection: Connection | None = None
        self._sequence = 0
        self._asked: dict[int, tuple[Kind, float]] = {}  # with the time of asking
        self._awaited: dict[int, Values | None] = {}
        self._stop_wanted = False
        self._closing = False
        self._due = 0.0  # when the next question is, monotonic s
        self._wake = Wake()
        self.last: Status | None = None
        self._turning = Turning()
        self.trouble = "not connected yet"
        self._broke = ""  # why the last connection ended
        self.malformed = 0
        self._thread = threading.Thread(target=self._run, name="eki-state", daemon=True)
        self._thread.start()

    @property
    def stop_wanted(self) -> bool:
        """Whether a stop has been asked for that the controller has not acknowledged."""
        return self._stop_wanted

    def stop(self) -> None:
        """Send a stop from this thread, now; repeated until the controller acknowledges it.

        Raises
        ------
        LinkLostError
            It could not be sent now. It is the first thing that goes out once there is a connection.
        """
        self._stop_wanted = True
        self._ask(Kind.STOP)
        self._wake.set()

    def hurry(self) -> None:
        """Ask as soon as possible: something has changed."""
        self._due = 0.0
        self._wake.set()

    def release(self) -> None:
        """Ask for the stop to be lifted."""
        self._ask(Kind.RELEASE)

    def exchange(self, kind: Kind, start: int = 0, patience: float = SILENCE) -> Values:
        """Ask, and wait for the answer to this very question.

        Raises
        ------
        LinkLostError
            None came.
        """
        with self._answered:
            number = self._ask(kind, start, awaited=True)
            try:
                end = time.monotonic() + patience
                while self._awaited[number] is None and number in self._asked and not self._closing:
                    if not self._answered.wait(min(end - time.monotonic(), 0.05)) and time.monotonic() > end:
                        raise LinkLostError(f"state channel: no answer within {patience:g} s")
                values = self._awaited[number]
            finally:
                del self._awaited[number]
        if values is None:
            raise LinkLostError(f"state channel: {self.trouble or 'the connection broke before the answer'}")
        return values

    def wait_first(self, patience: float) -> Status:
        """Wait for the first status.

        Raises
        ------
        LinkLostError
            None came.
        """
        with self._answered:
            self._answered.wait_for(lambda: self.last is not None, patience)
        if self.last is None:
            raise LinkLostError(f"state channel: {self.trouble or self._broke or 'connected, but no answer'}")
        return self.last

    def close(self) -> None:
        """Hang up, and end the thread."""
        self._closing = True
        self._wake.set()
        self._thread.join(SILENCE + 2.0)
        with self._answered:
            self._answered.notify_all()
        self._wake.close()

    def _ask(self, kind: Kind, start: int = 0, awaited: bool = False) -> int:
        with self._lock:
            connection = self._connection
            if connection is None:
                raise LinkLostError(f"state channel: {self.trouble or 'not connected'}")
            if len(self._asked) >= MOST_ASKED + (MOST_ASKED - 1 if kind is Kind.STOP else 0):
                if kind is Kind.STOP and any(asked is Kind.STOP for asked, _ in self._asked.values()):
                    return 0  # stops are on their way already
                raise LinkLostError("state channel: the controller does not answer")
            self._sequence += 1
            number = self._sequence
            values = {"Ask/Sequence": number, "Ask/Kind": int(kind), "Ask/From": start}
            self._asked[number] = (kind, time.monotonic())
            if awaited:
                self._awaited[number] = None
            try:
                connection.send(document(STATE.receive, values))
            except LinkLostError as error:
                self._awaited.pop(number, None)
                self._drop(str(error))
                raise
            return number

    def _drop(self, why: str) -> None:
        """End the connection; with the lock held."""
        if self._connection is not None:
            self._connection.close()
        self._connection = None
        self._asked.clear()
        self.trouble = self._broke = why
        self._wake.set()

    def _run(self) -> None:
        backoff = Backoff()
        while not self._closing:
            if self._connection is None:
                if not self._connect():
                    self._tick()
                    readable(None, self._wake, backoff.seconds())
                    continue
                self._due = 0.0
            try:
                self._listen(self._poll(time.monotonic()))
                if self.last is not None and self.last.age < SILENCE:
                    backoff.reset()
            except (LinkLostError, StreamError) as error:
                self.malformed += isinstance(error, StreamError)
                with self._lock:
                    self._drop(str(error))
                readable(None, self._wake, backoff.seconds())
        with self._lock:
            self._drop("closed")

    def _connect(self) -> bool:
        try:
            connection = Connection(*self._where)
        except LinkLostError as error:
            self.trouble = str(error)
            return False
        with self._lock:
            self._connection, self.trouble = connection, ""
        return True

    def _poll(self, now: float) -> float:
        """Ask, if no question is on its way; a wanted stop goes first, each time until it is acknowledged.

        Returns
        -------
        float
            How long there is nothing else to do, s.
        """
        with self._lock:
            oldest = min((when for _, when in self._asked.values()), default=now)
            busy = bool(self._asked)
        if now - oldest > SILENCE:
            raise LinkLostError(f"state channel: no answer for {SILENCE:g} s")
        if busy:
            return self._period
        if now < self._due:
            return self._due - now
        self._due = now + self._period
        self._tick()
        with contextlib.suppress(LinkLostError):  # said in `trouble`, and seen in the next turn
            self._ask(Kind.STOP if self._stop_wanted else Kind.STATE)
        return self._period

    def _listen(self, patience: float) -> None:
        connection = self._connection
        if connection is None or not readable(connection, self._wake, patience):
            return
        for root, texts in connection.receive():
            if root != ROOT:
                raise StreamError(f"state channel: expected {ROOT}, found {root}")
            self._take(values_of(STATE.send, texts))

    def _take(self, values: Values) -> None:
        number, status = int(values["Robot/State/@Sequence"]), self._turning.seen(status_of(values))
        with self._answered:
            with self._lock:
                asked = self._asked.pop(number, None)
            if asked is None:
                raise StreamError(f"state channel: an answer to question {number}, which was not asked")
            if asked[0] is Kind.STOP and status.stopped:
                self._stop_wanted = False
            self.last = status
            if number in self._awaited:
                self._awaited[number] = values
            self._answered.notify_all()
        self._notify(status)


def status_of(values: Values) -> Status:
    """The status in a `Robot` document.

    Raises
    ------
    StreamError
        A mode or a reason that there is not.
    """
    said = {tag.rpartition("@")[2]: value for tag, value in values.items() if tag.startswith("Robot/State/")}
    try:
        mode, reason = Mode(int(said["Mode"])), Reason(int(said["Reason"]))
    except ValueError as error:
        raise StreamError(f"state channel: {error}") from None
    return Status(
        joints=np.radians(_six(values, "Axis")),
        boot=int(said["Boot"]),
        accepted=int(said["Accepted"]),
        running=int(said["Running"]),
        finished=int(said["Finished"]),
        aborted=int(said["Aborted"]),
        point=int(said["Point"]),
        reason=reason.words if reason else "",
        stopped=bool(said["Stopped"]),
        mode=mode.name,
        drives=bool(said["Drives"]),
        brakes_open=bool(said["Brakes"]),
        estop=bool(said["Estop"]),
        clock=said["Clock"] / 1000,
        torque=_six(values, "Torque"),
        current=_six(values, "Current"),
        temperature=_six(values, "Temperature") + ABSOLUTE_ZERO,
        oldest=int(said["Oldest"]),
        newest=int(said["Newest"]),
    )


def _six(values: Values, at: str) -> Array:
    return np.array([values[f"Robot/{at}/@A{k}"] for k in range(1, AXES + 1)])
