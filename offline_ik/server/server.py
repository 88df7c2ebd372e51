"""The command server: many clients on one asyncio loop, with bounded lines, queues and patience."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from offline_ik.beamline.processes import Side, Sides
from offline_ik.beamline.waiting import Waiting
from offline_ik.cell.cell import Cell
from offline_ik.errors import DetectorError
from offline_ik.inverse.detector import Detector
from offline_ik.server.client import LINE_BYTES, Client, Limits
from offline_ik.server.protocol import Job, Session, Speaker

__all__ = ["LINE_BYTES", "Limits", "Server", "serve", "settle", "take"]


BACKLOG = 100  # connections that wait to be accepted
MOST_WAITING_STOPS = 4  # stops at a time that wait for the robot's link
GRACE = 0.8  # s that a stop waits for the robot's link, and then for a computation that is under way
SWITCH = 5e-4  # s after which a computation in its thread gives way to the answers that are ready at once


class Server:
    """The server of one speaker.

    What one call of a kernel answers is answered on the loop. The rest (searches, checks of a move) is computed in one
    thread of its own, on a detector of its own; every client waits for one such computation at most.

    Parameters
    ----------
    speaker
        Answers lines.
    limits
        What clients may do.
    """

    def __init__(self, speaker: Speaker, limits: Limits | None = None) -> None:
        self.speaker, self.limits = speaker, limits or Limits()
        self.clients: set[Client] = set()
        self.failures = 0
        self._servers: list[asyncio.Server] = []
        self._thread = ThreadPoolExecutor(1, "clampid")
        self._twin: Detector = speaker.detector.twin
        self._switched = sys.getswitchinterval()
        self._link_thread = ThreadPoolExecutor(1, "clampid-link")
        self._stop_threads = ThreadPoolExecutor(MOST_WAITING_STOPS, "clampid-stop")
        self._waiting = Waiting()
        self._busy, self._lock = 0, threading.Lock()

    def reply(self, line: bytes, session: Session) -> bytes | Job:
        """The answer to a line; an error of the program itself is one client's answer, not everyone's end."""
        try:
            return self.speaker.begin(line, session)
        except Exception as error:  # the outermost boundary of a service that must outlive any request
            return self._failed(error)

    def compute(self, job: Job) -> asyncio.Future[Any]:
        """Begin a job, at the temperatures and the running time of now."""
        loop, later = asyncio.get_running_loop(), job.later
        if later.lane == "compute":
            return loop.run_in_executor(self._thread, self._run, job, self.speaker.detector.cell)
        if later.lane == "soon":  # its result is looked at one turn of the loop later still: that has read what came
            done: asyncio.Future[Any] = loop.create_future()
            loop.call_soon(_fulfil, done, job, self.speaker.detector)
            return done
        robot = self.speaker.robot
        if later.lane == "wait" and robot is not None:
            return self._waiting.until_ended(robot, later.number, later.patience)
        # A link may wait for its controller: neither the others' answers nor a stop wait with it.
        return loop.run_in_executor(self._stop_threads if later.lane == "stop" else self._link_thread, self._apart, job)

    def _run(self, job: Job, cell: Cell) -> Any:
        with self._counted():
            self._twin = self._twin.within(cell)
            return job.run(self._twin)

    def _apart(self, job: Job) -> Any:
        with self._counted():
            return job.run(self._twin)

    @contextlib.contextmanager
    def _counted(self) -> Iterator[None]:
        """Count what runs in threads, which the interpreter would wait for at its end."""
        with self._lock:
            self._busy += 1
        try:
            yield
        finally:
            with self._lock:
                self._busy -= 1

    def finish(self, job: Job, done: asyncio.Future[Any]) -> bytes | Job:
        """The answer of a job that has been done, or what has to be done next."""
        try:
            return job.end(done.result())
        except Exception as error:  # as in reply
            return self._failed(error)

    def _failed(self, error: Exception) -> bytes:
        self.failures += 1
        return self.speaker.refuse(f"internal error: {type(error).__name__}: {error}")

    async def start(self, host: str, port: int, taken: Sequence[socket.socket] | None = None) -> tuple[str, int]:
        """Listen; the address that was taken (port 0 takes a free one).

        Parameters
        ----------
        taken
            Of :func:`take`, where the address was taken before.
        """
        sys.setswitchinterval(SWITCH)
        loop, found = asyncio.get_running_loop(), take(host, port) if taken is None else taken
        self._servers = [await loop.create_server(lambda: Client(self), sock=one) for one in found]
        name = found[0].getsockname()
        return str(name[0]), int(name[1])

    async def run(self) -> None:
        """Serve until cancelled."""
        if not self._servers:
            raise RuntimeError("start the server before it can run")
        # Not serve_forever: from Python 3.12 on it waits, once cancelled, for clients to hang up by themselves.
        await asyncio.get_running_loop().create_future()

    async def close(self) -> bool:
        """Stop listening, stop a robot that was sent on its way, tell the clients, and hang up.

        Returns
        -------
        bool
            Whether the computation that was under way has ended, too.
        """
        for server in self._servers:
            server.close()
        stopped = await self._stop_robot()
        for client in list(self.clients):
            client.tell_end(self.speaker.refuse(f"the server stops{stopped}"))
        for _ in range(3):  # a closed transport tells so on a later turn of the loop
            await asyncio.sleep(0)
        for client in list(self.clients):  # what a client does not read is dropped
            if client.transport is not None:
                client.transport.abort()
        for _ in range(3):
            await asyncio.sleep(0)
        self._waiting.close()
        for threads in (self._thread, self._link_thread, self._stop_threads):
            threads.shutdown(wait=False, cancel_futures=True)
        sys.setswitchinterval(self._switched)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(GRACE):
                while self._busy:
                    await asyncio.sleep(0.01)
        return not self._busy

    async def _stop_robot(self) -> str:
        """Once the server is gone no client can stop the robot, so that a move does not outlive it."""
        robot = self.speaker.robot
        if robot is None or not robot.begun:
            return ""
        link = robot.link
        # In a thread of its own: a controller that does not answer must not keep the server from ending.
        done: asyncio.Future[str] = asyncio.get_running_loop().create_future()

        def stop() -> None:
            try:
                link.stop()
                said = "; the robot was stopped"
            except Exception as error:  # a link may raise anything; it is told, and the server ends all the same
                said = f"; the robot could not be stopped: {error}"
            with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
                done.get_loop().call_soon_threadsafe(answered, said)

        def answered(said: str) -> None:
            if not done.done():
                done.set_result(said)

        threading.Thread(target=stop, name="clampid-stop", daemon=True).start()
        try:
            return await asyncio.wait_for(done, GRACE)
        except TimeoutError:
            return "; the robot did not answer when it was to be stopped"


def _fulfil(done: asyncio.Future[Any], job: Job, detector: Detector) -> None:
    if not done.done():  # not cancelled with its connection
        done.set_result(job.run(detector))


def take(host: str, port: int) -> list[socket.socket]:
    """Take an address, so that nobody else does while the server is made ready; one socket for each of its forms.

    Raises
    ------
    DetectorError
        It is in use, not of this machine, or not permitted.
    """
    found: list[socket.socket] = []
    try:
        forms = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        for family, kind, protocol, _, address in dict.fromkeys(forms):
            one = socket.socket(family, kind, protocol)
            found.append(one)
            if os.name == "posix":
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                one.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            one.bind((address[0], found[0].getsockname()[1] if len(found) > 1 else port, *address[2:]))
            # An address is refused to a second listener only: bound alone, two servers could hold it.
            one.listen(BACKLOG)
    except OSError as error:
        for one in found:
            one.close()
        raise DetectorError(f"cannot listen on {host}:{port}: {error.strerror or error}") from None
    return found


def _reached(at: tuple[str, int]) -> str:
    """Where a process of this machine reaches a server that listens at an address."""
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(at[0], at[0])
    return f"[{host}]:{at[1]}" if ":" in host else f"{host}:{at[1]}"


def settle() -> None:
    """Exclude present objects from garbage collection: they stay, and scanning them again delays answers."""
    gc.collect()
    gc.freeze()


def serve(
    speaker: Speaker,
    host: str,
    port: int,
    say: Callable[[str], None],
    taken: Sequence[socket.socket] | None = None,
    sides: Sequence[Side] = (),
    warn: Callable[[str], None] = lambda _: None,
) -> bool:
    """Serve until interrupted (SIGINT, SIGTERM).

    Parameters
    ----------
    say, warn
        Are told the addresses, and what goes wrong meanwhile.
    taken
        Of :func:`take`.
    sides
        What else answers, see :mod:`offline_ik.beamline.processes`.

    Returns
    -------
    bool
        Whether nothing is left running: False where a computation did not end within the time that a stop has.

    Raises
    ------
    DetectorError
        The address cannot be listened on, or a side does not start.
    """

    async def run() -> bool:
        server, beside = Server(speaker), Sides(sides, say, warn)
        settle()
        at = await server.start(host, port, taken)
        # Said, not left to the interpreter: started in the background of a shell, it would not hear an interrupt.
        loop, serving = asyncio.get_running_loop(), asyncio.ensure_future(server.run())
        for number in (signal.SIGINT, signal.SIGTERM):
            with contextlib.suppress(NotImplementedError):  # Windows hears an interrupt by itself
                loop.add_signal_handler(number, serving.cancel)
        say(f"listening on {at[0]}:{at[1]}")
        ended, starting = False, asyncio.ensure_future(beside.start(_reached(at)))
        serving.add_done_callback(lambda _: starting.cancel())
        try:
            with contextlib.suppress(asyncio.CancelledError):
                await starting
                await serving
        finally:
            ended, _ = await asyncio.gather(server.close(), beside.close())
        return ended

    return asyncio.run(run())
