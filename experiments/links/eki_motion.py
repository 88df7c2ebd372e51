"""The motion channel of an EthernetKRL link: one thread sends programs and receives their results.

If the connection breaks after a program was sent, the thread connects again and sends a fence: a document with boot
number 0, which a controller always refuses. The answer proves that the controller has dropped the data of the old
connection. Only after it does a status show whether the program was accepted, or never will be.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from experiments.links.connection import Backoff, Connection, NotSentError, Wake, readable
from experiments.links.programs import Programs
from experiments.links.protocol import LinkLostError, Phase, Program, Status
from experiments.links.schema import AXES, MOTION, Event, Reason, document
from experiments.links.splitter import StreamError, values_of

__all__ = ["FENCE", "MotionChannel", "documents_of"]

Array = npt.NDArray[np.float64]

ACKNOWLEDGE = 2.0  # s within which the controller has to say something of a program that was sent
FULL = 0.5  # s that the controller may leave its buffers full
FENCE = 2**31 - 1000
"""Number of the document that no controller executes."""


@dataclass(frozen=True)
class _Job:
    number: int
    data: bytes
    stops: int


class MotionChannel:
    """Sends programs, each once.

    Parameters
    ----------
    host, port
        Of the motion channel.
    programs
        What becomes of them.
    asked
        Asks for a status and gives the answer to that very question; raises `LinkLostError`.
    changed
        Called when a program has ended, so that a status is asked for.
    """

    def __init__(
        self, host: str, port: int, programs: Programs, asked: Callable[[], Status], changed: Callable[[], None]
    ) -> None:
        self._where, self._programs, self._asked, self._changed = (host, port), programs, asked, changed
        self._connection: Connection | None = None
        self._lock = threading.Lock()
        self._job: _Job | None = None
        self._stops = 0
        self._sent: tuple[int, float] | None = None  # program that is not acknowledged yet, and when it was sent
        self._fence: float | None = None  # when one was sent that is not answered yet
        self._fence_due = False
        self._closing = False
        self._wake = Wake()
        self.trouble = "not connected yet"
        self.malformed = self.attempts = 0
        self._thread = threading.Thread(target=self._run, name="eki-motion", daemon=True)
        self._thread.start()

    @property
    def ready(self) -> bool:
        """Whether a program could be sent now."""
        return self._connection is not None and not self._fence_due and self._fence is None

    def queue(self, number: int, data: bytes, stops: int) -> None:
        """Send a program's documents, unless a stop comes first.

        Parameters
        ----------
        number
            Of the program.
        data
            Its documents.
        stops
            What `stops` was when it was wanted.
        """
        with self._lock:
            self._job = _Job(number, data, stops)
        self._wake.set()

    @property
    def stops(self) -> int:
        """How often `stopped` was called."""
        return self._stops

    def stopped(self) -> None:
        """Discard programs that were queued before and are not sent yet."""
        self._stops += 1

    def close(self) -> None:
        """Hang up, and end the thread."""
        self._closing = True
        self._wake.set()
        self._thread.join(ACKNOWLEDGE + 2.0)
        self._wake.close()

    def _run(self) -> None:
        backoff = Backoff()
        while not self._closing:
            try:
                if self._connection is None:
                    self.attempts += 1
                    self._connection = Connection(*self._where)
                    self.trouble = ""
                self._send()
                self._hear()
                if self._fence is None and not self._fence_due:
                    backoff.reset()
            except (LinkLostError, StreamError) as error:
                self.malformed += isinstance(error, StreamError)
                self._lost(str(error))
                self._drop_job()
                readable(None, self._wake, backoff.seconds())
        self._lost("closed")

    def _lost(self, why: str) -> None:
        if self._connection is not None:
            self._connection.close()
        self._connection, self._fence, self.trouble = None, None, why
        self._fence_due = self._undecided() is not None

    def _undecided(self) -> int | None:
        """The program that was sent and of which nothing was heard."""
        if self._sent is None:
            return None
        current = self._programs.current()
        if current is None or current.id != self._sent[0] or current.phase is not Phase.SENT:
            self._sent = None
            return None
        return current.id

    def _drop_job(self) -> None:
        with self._lock:
            job, self._job = self._job, None
        if job is not None:
            self._programs.not_sent(job.number, f"it was not sent: {self.trouble or 'no connection'}")

    def _send(self) -> None:
        connection = self._connection
        if connection is None:
            return
        if self._fence_due:
            self._fence_due = False
            if self._undecided() is not None:
                connection.send(_fence(), FULL)
                self._fence = time.monotonic()
        with self._lock:
            job, self._job = self._job, None
        if job is None:
            return
        if job.stops != self._stops:
            self._programs.not_sent(job.number, "the robot was stopped before it was sent")
            return
        self._sent = job.number, time.monotonic()
        try:
            connection.send(job.data, FULL)
        except NotSentError as error:
            if not error.sent:
                self._sent = None
                self._programs.not_sent(job.number, f"it was not sent: {error}")
            raise

    def _hear(self) -> None:
        connection = self._connection
        if connection is None:
            return
        now = time.monotonic()
        waiting = self._undecided()
        if waiting is not None and self._sent is not None and self._fence is None and now - self._sent[1] > ACKNOWLEDGE:
            raise LinkLostError(f"motion channel: nothing was heard of program {waiting} for {ACKNOWLEDGE:g} s")
        if self._fence is not None and now - self._fence > ACKNOWLEDGE:
            raise LinkLostError(f"motion channel: no answer for {ACKNOWLEDGE:g} s")
        if readable(connection, self._wake, 0.1):
            for root, texts in connection.receive():
                if root != MOTION.send[0].root:
                    raise StreamError(f"motion channel: expected {MOTION.send[0].root}, found {root}")
                self._take(texts)

    def _take(self, texts: Mapping[str, str]) -> None:
        values = values_of(MOTION.send, texts)
        boot, number, point = (int(values[f"Moved/{name}"]) for name in ("Boot", "Id", "Point"))
        try:
            event, reason = Event(int(values["Moved/Event"])), Reason(int(values["Moved/Reason"]))
        except ValueError as error:
            raise StreamError(f"motion channel: {error}") from None
        if number == FENCE:
            self._fenced()
        elif event is Event.ACCEPTED:
            self._programs.accepted(boot, number)
        elif event is Event.POINT:
            self._programs.reached(boot, number, point)
        else:
            phases = {Event.FINISHED: Phase.FINISHED, Event.REFUSED: Phase.REFUSED, Event.ABORTED: Phase.INTERRUPTED}
            self._programs.ended(boot, number, phases[event], point, reason.words if reason else "")
            self._changed()

    def _fenced(self) -> None:
        """The controller has dropped what it had: a status from now on decides."""
        self._fence = None
        number = self._undecided()
        if number is not None:
            self._programs.fenced(number, self._asked())
            if self._undecided() is not None:  # accepted, and a status did not say so yet
                self._fence_due = True


def documents_of(program: Program, boot: int, number: int) -> bytes:
    """All documents of a program: one for each point.

    Parameters
    ----------
    program
        Its postures have six joints.
    boot, number
        Of the controller's programs as known, and of this one.
    """
    degrees, count = np.degrees(program.postures), len(program.postures)
    return b"".join(_move(boot, number, k, count, 100.0 * program.speed, q) for k, q in enumerate(degrees, 1))


def _move(boot: int, number: int, point: int, count: int, speed: float, degrees: Array) -> bytes:
    values: dict[str, float | bool] = {
        "Move/Boot": boot, "Move/Id": number, "Move/Point": point, "Move/Count": count, "Move/Speed": speed,
        **{f"Move/Axis/@A{k}": float(value) for k, value in enumerate(degrees, 1)},
    }  # fmt: skip
    return document(MOTION.receive, values)


def _fence() -> bytes:
    return _move(0, FENCE, 1, 1, 1.0, np.zeros(AXES))
