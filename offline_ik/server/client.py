"""One connection of the server: lines in, answers out in order, bounded in length, number and time.

What looks like HTTP is hung up on before any of it is answered: a web page can make its reader's browser send what it
likes to a port of the reader's own machine. A connection that begins with no request is told so, and ends: of what
speaks another protocol (SMTP, Redis, FTP), no later line is obeyed.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import re
import socket
from collections import deque
from functools import partial
from typing import Any, NamedTuple, Protocol

from offline_ik.exchange.requests import is_request, is_stop
from offline_ik.server.protocol import Job, Session, Speaker

__all__ = ["LINE_BYTES", "Client", "Limits"]

LINE_BYTES = 4096  # of a request
TOO_LONG = f"expected a line of at most {LINE_BYTES} bytes"
PENDING = 64  # requests that a client may have waiting; beyond, it is not read
TURN = 8  # requests of one client before others have their turn
WRITE_BYTES = 65536  # that a client may leave unread; beyond, it is answered no more until it reads
PATIENCE = 30.0  # s for a line to be completed
CLIENTS = 256
RESERVED = 8  # connections beyond, on which nothing but `stop` is answered; a further one takes the oldest's place
_NUMBERS = itertools.count()  # of connections, in the order in which they came
STOP_WITHIN = 5.0  # s that such a connection may stay without saying it
IDLE = 3600.0  # s without a whole line, after which a connection is ended
SILENT = 300.0  # s for the first line
CUT_OFF = b"\n"  # stands, as no line can, for one that the end of its connection cut off
KEEPALIVE = (("TCP_KEEPIDLE", 60), ("TCP_KEEPINTVL", 15), ("TCP_KEEPCNT", 4))  # s, s, times
_HTTP = re.compile(rb"(?:GET|HEAD|POST|PUT|DELETE|CONNECT|OPTIONS|TRACE|PATCH|PRI) |[^\n]* HTTP/\d|\x16\x03")
"""How a request of HTTP begins, by its method or by what its first line ends with, and one of TLS."""


class Host(Protocol):
    """What a connection needs of its server."""

    speaker: Speaker
    limits: Limits
    clients: set[Client]

    def reply(self, line: bytes, session: Session) -> bytes | Job:
        """The answer to a line."""
        ...

    def compute(self, job: Job) -> asyncio.Future[Any]:
        """Begin a job."""
        ...

    def finish(self, job: Job, done: asyncio.Future[Any]) -> bytes | Job:
        """The answer of a job that has been done, or what has to be done next."""
        ...


class Limits:
    """What the server allows; a value of its own so that tests can be impatient."""

    def __init__(
        self,
        patience: float = PATIENCE,
        clients: int = CLIENTS,
        reserved: int = RESERVED,
        idle: float = IDLE,
        silent: float = SILENT,
    ) -> None:
        self.patience, self.clients, self.reserved = patience, clients, reserved
        self.idle, self.silent = idle, silent


class Begun(NamedTuple):
    """What was begun, and is answered when it is done; a `stop` is begun when it comes, before its turn."""

    job: Job
    done: asyncio.Future[Any]


class Answered(bytes):
    """The answer to a `stop` that was refused when it came."""


class Overtaken(bytes):
    """A `move` that waited when a `stop` came after it: it does not begin any more."""


class Client(asyncio.Protocol):
    """One connection: splits lines, answers in order, and stops reading while either side is behind."""

    def __init__(self, server: Host) -> None:
        self.server, self.session, self.number = server, Session(), next(_NUMBERS)
        self.loop = asyncio.get_running_loop()
        self.partial = b""
        self.skipping = False
        self.lines: deque[bytes | Begun] = deque()
        self.writable, self.reading, self.working, self.ended = True, True, False, False
        self.timer: asyncio.TimerHandle | None = None
        self.idle: asyncio.TimerHandle | None = None
        self.heard = 0  # whole lines
        self.job: tuple[Job, asyncio.Future[Any]] | None = None
        self.transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a connection in, or say that there are too many."""
        if not isinstance(transport, asyncio.Transport):  # a pipe, which this server does not make
            transport.close()
            return
        self.transport = transport
        self.transport.set_write_buffer_limits(high=WRITE_BYTES)
        limits, here = self.server.limits, len(self.server.clients)
        if here >= limits.clients + limits.reserved and not self._make_room():
            self.tell_end(self._too_many())
            return
        self.server.clients.add(self)
        if here >= limits.clients:
            self.session.only_stop = True
            self.transport.write(self._too_many())
        _keep_alive(self.transport.get_extra_info("socket"))
        at = self.transport.get_extra_info("peername")
        self.session.address = f"{at[0]}:{at[1]}" if at else ""
        self._rest()

    def _make_room(self) -> bool:
        """Hang up on whoever has had a place for a `stop` longest: who means to stop has said so by then."""
        kept = (c for c in self.server.clients if c.session.only_stop)
        oldest = min(kept, key=lambda c: c.number, default=None)
        if oldest is None:
            return False
        oldest.tell_end(self._too_many())
        self.server.clients.discard(oldest)
        return True

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it, and what it waits for."""
        self.ended = self.session.closed = True
        self.server.clients.discard(self)
        self.lines.clear()
        self.partial = b""
        for timer in (self.timer, self.idle):
            if timer is not None:
                timer.cancel()
        robot = self.server.speaker.robot
        if robot is not None:
            robot.release(self.session)
        # What is on its way to the robot is seen through.
        if self.job is not None and self.job[0].later.lane in ("compute", "soon", "wait"):
            self.job[1].cancel()

    def data_received(self, data: bytes) -> None:
        """Split what came into lines, and answer them unless that is under way."""
        if self.ended:
            return
        parts = data.split(b"\n")
        parts[0] = self.partial + parts[0]
        if self._is_other_protocol(parts):
            return
        self.partial = parts.pop()
        self.heard += len(parts)
        if parts:
            self._rest()
        for line in parts:
            if self.skipping:  # the rest of a line that was too long, already answered
                self.skipping = False
            elif len(line) <= LINE_BYTES and is_stop(line):
                self._stop_now(line)
            else:
                self.lines.append(line)
        if len(self.partial) > LINE_BYTES:
            if not self.skipping:
                self.lines.append(self.partial)
            self.skipping, self.partial = True, b""
        elif self.skipping:
            self.partial = b""
        self._watch(begun=bool(parts))
        if self.working:
            self._pace(self.transport)
        else:
            self._work()

    def _is_other_protocol(self, parts: list[bytes]) -> bool:
        """Hang up on HTTP; answer a first line that is no request, and end; nothing that came after it is looked at."""
        if not self.skipping and any(map(_HTTP.match, parts)):
            self._hang_up()
            return True
        first = parts[0]
        if self.heard or self.skipping or (len(parts) == 1 and len(first) <= LINE_BYTES) or is_request(first):
            return False
        self.lines.clear()
        self.partial = b""
        found = self.server.reply(first, self.session) if len(first) <= LINE_BYTES else None
        self.tell_end(found if isinstance(found, bytes) else self.server.speaker.refuse(TOO_LONG))
        return True

    def eof_received(self) -> bool:
        """Answer what has come, and end; what the end cuts off is refused."""
        self.session.closed = True
        if self.partial and not self.skipping:  # cut off, it may be another request than was meant: r=0.8 of r=0.85
            self._stop_now(self.partial) if is_stop(self.partial) else self.lines.append(CUT_OFF)
            self.partial = b""
        open_ = bool(self.lines) or self.working
        self.ended = not open_
        if open_:
            self.session.done = False
            self._last = True
            if not self.working:
                self._work()
        return open_

    _last = False

    def pause_writing(self) -> None:
        """Answer no more: the client does not read."""
        self.writable = False

    def resume_writing(self) -> None:
        """Answer again."""
        self.writable = True
        if not self.working and not self.ended:
            self._work()

    def _work(self) -> None:
        """Answer a few requests, then let others have their turn."""
        self.working = False
        transport = self.transport
        if transport is None or transport.is_closing():
            return
        for _ in range(TURN):
            if not self.lines or not self.writable:
                break
            found = self._begin(self.lines.popleft())
            if found is None:
                self.tell_end(b"")
                return
            if isinstance(found, Begun):
                self._await(*found)
                return
            transport.write(found)
            if self.session.done:
                transport.close()
                return
        if self.lines and self.writable:
            self.working = True
            self.loop.call_soon(self._work)
        elif not self.lines and self._last:
            transport.close()
            return
        self._pace(transport)

    def _begin(self, line: bytes | Begun) -> bytes | Begun | None:
        """The answer to a line, or what it waits for; None: this connection is not heard."""
        speaker = self.server.speaker
        if isinstance(line, (Begun, Answered)):
            return line
        if isinstance(line, Overtaken):
            return speaker.overtaken(line)
        if line == CUT_OFF:
            return speaker.refuse("expected a newline at the end of a line, found the end of the connection")
        if len(line) > LINE_BYTES:
            return speaker.refuse(TOO_LONG)
        if self.session.only_stop:  # stops are begun before their turn
            return None
        found = self.server.reply(line, self.session)
        return found if isinstance(found, bytes) else Begun(found, self.server.compute(found))

    def _pace(self, transport: asyncio.Transport | None) -> None:
        """Read on only while the client keeps up with its answers, and we with its requests."""
        behind = len(self.lines) > PENDING or not self.writable
        if transport is not None and behind == self.reading:
            transport.pause_reading() if behind else transport.resume_reading()
            self.reading = not behind

    def _stop_now(self, line: bytes) -> None:
        """Begin a stop when it comes, whatever this connection waits for; its answer comes in its turn."""
        self.lines = deque(
            Overtaken(other) if isinstance(other, bytes) and other.split(None, 1)[:1] == [b"move"] else other
            for other in self.lines
        )
        found = self.server.reply(line, self.session)
        self.lines.append(Answered(found) if isinstance(found, bytes) else Begun(found, self.server.compute(found)))

    def _await(self, job: Job, done: asyncio.Future[Any]) -> None:
        """Answer nothing before a job is done."""
        self.working, self.job = True, (job, done)
        _acknowledge(self.transport)
        done.add_done_callback(partial(self._computed, job))

    def _computed(self, job: Job, done: asyncio.Future[Any]) -> None:
        """Answer what was done elsewhere, and go on; for a connection that was reset, nothing moves."""
        self.job = None
        transport = self.transport
        gone = self.ended or transport is None or transport.is_closing()
        if done.cancelled() or (gone and job.later.lane in ("compute", "soon")):
            return
        found = self.server.finish(job, done)
        if gone or transport is None:
            return
        if not isinstance(found, bytes):
            self._await(found, self.server.compute(found))
            return
        transport.write(found)
        self._work()

    def _watch(self, begun: bool) -> None:
        """Give an incomplete line its time, and no more; ``begun``: another line than the one watched so far."""
        if begun and self.timer is not None:
            self.timer.cancel()
            self.timer = None
        if (self.partial or self.skipping) and self.timer is None:
            self.timer = self.loop.call_later(self.server.limits.patience, self._too_slow)
        elif not self.partial and not self.skipping and self.timer is not None:
            self.timer.cancel()
            self.timer = None

    def _too_many(self) -> bytes:
        most = self.server.limits.clients
        return self.server.speaker.refuse(f"too many clients: {most} at most; beyond, only stop is answered")

    def _hang_up(self) -> None:
        """End it at once: nothing that is waiting is answered, and what is computed moves nothing."""
        self.ended = self.session.closed = True
        self.lines.clear()
        self.partial = b""
        if self.transport is not None:
            self.transport.abort()

    def _rest(self) -> None:
        """Begin to wait for the next line."""
        limits = self.server.limits
        patience = (
            min(limits.patience, STOP_WITHIN)
            if self.session.only_stop
            else limits.idle
            if self.heard
            else limits.silent
        )
        if self.idle is not None:
            self.idle.cancel()
        self.idle = self.loop.call_later(patience, self._too_quiet, patience)

    def _too_quiet(self, patience: float) -> None:
        if self.working or self.lines or not self.reading:  # it is we who are behind
            self._rest()
            return
        self.tell_end(self.server.speaker.refuse(f"no line for {patience:g} s"))

    def tell_end(self, line: bytes) -> None:
        """Say a last line, and hang up once it is sent."""
        if self.transport is not None and not self.transport.is_closing():
            self.transport.write(line)
            self.transport.close()
        self.ended = self.session.closed = True

    def _too_slow(self) -> None:
        self.timer = None
        if self.lines or not self.reading:  # it is we who are behind: the rest of the line may lie unread
            self._watch(begun=True)
            return
        if self.transport is not None and not self.transport.is_closing():
            patience = self.server.limits.patience
            self.transport.write(self.server.speaker.refuse(f"a line was not completed within {patience:g} s"))
            self.transport.close()
        self.ended = True


def _acknowledge(transport: asyncio.Transport | None) -> None:
    """Acknowledge at once what has no answer yet: by Nagle's algorithm a `stop` would wait for that, for 40 ms."""
    found = None if transport is None else transport.get_extra_info("socket")
    if found is not None and hasattr(socket, "TCP_QUICKACK"):
        with contextlib.suppress(OSError):
            found.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)


def _keep_alive(found: socket.socket | None) -> None:
    """Let the system ask whether the other side is still there: a cable that was pulled says nothing."""
    if found is None:
        return
    with contextlib.suppress(OSError):
        found.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in KEEPALIVE:
            if hasattr(socket, name):
                found.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
