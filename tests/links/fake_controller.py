"""A small controller for tests: the wire of the schema, one client a channel, and cuts at any byte.

It shares with the client only the schema and the splitter. What it has executed it counts, program by program.
"""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections import Counter

from experiments.links.schema import MOTION, RING, STATE, Event, Kind, Mode, Reason, document
from experiments.links.splitter import Splitter, values_of


class CutError(Exception):
    """The connection is to be ended here."""


class Channel:
    """One listening port, one client; `cut_in`, `cut_out`: bytes after which the connection is ended, once."""

    def __init__(self, port: int = 0) -> None:
        self.server = socket.create_server(("127.0.0.1", port))
        self.port = self.server.getsockname()[1]
        self.client: socket.socket | None = None
        self.splitter = Splitter()
        self.cut_in: int | None = None
        self.cut_out: int | None = None
        self.taken = self.given = 0
        self.connections = 0
        self.mute = False

    def accept(self) -> None:
        client, _ = self.server.accept()
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self.client is not None:
            client.close()  # one client a channel
            return
        self.client, self.splitter, self.connections = client, Splitter(), self.connections + 1

    def deaf(self) -> None:
        """Listen no longer."""
        self.drop()
        self.server.close()

    def listen(self) -> None:
        """Listen again."""
        self.server = socket.create_server(("127.0.0.1", self.port))

    def drop(self) -> None:
        """End the connection; from any thread: the next client may be accepted before this returns."""
        client, self.client = self.client, None
        if client is not None:
            client.close()

    def read(self) -> list:
        """Documents; ends the connection after the bytes that `cut_in` allows, once they are taken."""
        try:
            most = 65536 if self.cut_in is None else max(self.cut_in - self.taken, 0)
            data = self.client.recv(most) if most else b""
        except OSError:
            raise CutError from None
        if most and not data:
            raise CutError
        self.taken += len(data)
        found = self.splitter.feed(data)
        if self.cut_in is not None and self.taken >= self.cut_in:
            self.cut_in = None
            return [*found, None]
        return found

    def write(self, data: bytes) -> None:
        if self.client is None or self.mute:
            return
        if self.cut_out is not None and self.given + len(data) >= self.cut_out:
            data, self.cut_out = data[: self.cut_out - self.given], None
            with contextlib.suppress(OSError):
                self.client.sendall(data)
            raise CutError
        self.given += len(data)
        try:
            self.client.sendall(data)
        except OSError:
            raise CutError from None


class FakeController:
    """Runs in a thread of its own; `point_s`: how long a point takes, s."""

    def __init__(self, point_s: float = 0.0, watchdog: float = 2.0) -> None:
        for _ in range(50):
            self.motion = Channel()
            try:
                self.state = Channel(self.motion.port + 1)
                break
            except OSError:
                self.motion.server.close()
        self.port, self.point_s, self.watchdog = self.motion.port, point_s, watchdog
        self.executed: Counter[tuple[int, int]] = Counter()
        self.begun = 0
        self.boot, self.samples_from = 7, 1
        self.reset()
        self.boot = 7
        self.lock = threading.RLock()
        self.closing = False
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def reset(self) -> None:
        """Start the controller's programs again."""
        self.boot += 1
        self.accepted = self.running = self.finished = self.aborted = self.point = 0
        self.reason = Reason.NONE
        self.stopped, self.estop, self.drives, self.mode = False, False, True, Mode.EXT
        self.collected: list[dict] = []
        self.target: list[dict] = []
        self.due = 0.0
        self.newest, self.oldest = 0, 0
        self.joints = [0.0, -90.0, 90.0, 0.0, 45.0, 0.0]
        self.asked_at = time.monotonic()
        self.asks: list[int] = []

    def restart(self) -> None:
        """As a cold start: both connections end."""
        with self.lock:
            self.motion.drop()
            self.state.drop()
            self.reset()

    def close(self) -> None:
        self.closing = True
        self.thread.join(5)
        for channel in (self.motion, self.state):
            channel.drop()
            channel.server.close()

    def __enter__(self) -> FakeController:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        while not self.closing:
            with self.lock:
                sockets = [c.server for c in (self.motion, self.state)]
                sockets += [c.client for c in (self.motion, self.state) if c.client is not None]
            try:
                ready, _, _ = select.select(sockets, (), (), 0.001 if self.running else 0.01)
            except (OSError, ValueError):  # closed meanwhile, by a test
                continue
            with self.lock:
                self._turn(ready)

    def _turn(self, ready: list) -> None:
        for channel in (self.motion, self.state):
            if channel.server in ready:
                with contextlib.suppress(OSError):  # closed meanwhile, by a test
                    channel.accept()
        for channel, take in ((self.motion, self._move), (self.state, self._ask)):
            if channel.client is not None and channel.client in ready:
                try:
                    for found in channel.read():
                        if found is None:
                            raise CutError
                        take(found[1])
                except CutError:
                    self._gone(channel)
        try:
            self._advance()
        except CutError:
            self._gone(self.motion)

    def _gone(self, channel: Channel) -> None:
        channel.drop()
        if channel is self.motion:
            self.collected = []  # EKI_Clear

    def _moved(self, event: Event, number: int, point: int = 0, reason: Reason = Reason.NONE) -> None:
        values = (self.boot, event, number, point, reason)
        self.motion.write(document(MOTION.send, dict(zip((e.tag for e in MOTION.send), map(int, values), strict=True))))

    def _move(self, texts: dict) -> None:
        v = {k.removeprefix("Move/"): x for k, x in values_of(MOTION.receive, texts).items()}
        number = v["Id"]
        why = Reason.NONE
        if v["Boot"] != self.boot:
            why = Reason.WRONG_BOOT
        elif self.running:
            why = Reason.RUNNING
        elif number <= self.accepted:
            why = Reason.ID_NOT_NEW
        if why:
            self.reason = why
            self._moved(Event.REFUSED, number, 0, why)
            return
        if v["Point"] == 1:
            self.collected = []
        self.collected.append(v)
        if v["Point"] != len(self.collected):
            self._moved(Event.REFUSED, number, 0, Reason.POINTS)
            self.collected = []
        elif len(self.collected) == v["Count"]:
            self._whole(number)

    def _whole(self, number: int) -> None:
        self.target, self.collected = self.collected, []
        if self.stopped:
            self.reason = Reason.STOPPED
            self._moved(Event.REFUSED, number, 0, Reason.STOPPED)
            return
        self.accepted = self.running = number
        self.executed[self.boot, number] += 1
        self.begun += 1
        self.point, self.reason, self.due = 0, Reason.NONE, time.monotonic() + self.point_s
        self._moved(Event.ACCEPTED, number)

    def _advance(self) -> None:
        if self.running and time.monotonic() - self.asked_at > self.watchdog:
            self._abort(Reason.WATCHDOG)
        if not self.running or time.monotonic() < self.due:
            return
        number, self.point = self.running, self.point + 1
        self.joints = [self.target[self.point - 1][f"Axis/@A{k}"] for k in range(1, 7)]
        self.due = time.monotonic() + self.point_s
        last = self.point == len(self.target)
        if last:
            self.finished, self.running = number, 0
        try:
            self._moved(Event.POINT, number, self.point)
        finally:
            if last and self.motion.client is not None:
                self._moved(Event.FINISHED, number, self.point)

    def _abort(self, reason: Reason) -> None:
        self.reason, self.aborted = reason, self.running
        number, self.running = self.running, 0
        self._moved(Event.ABORTED, number, self.point, reason)

    def _ask(self, texts: dict) -> None:
        v = {k.removeprefix("Ask/"): int(x) for k, x in values_of(STATE.receive, texts).items()}
        self.asked_at = time.monotonic()
        self.asks.append(v["Kind"])
        if v["Kind"] == Kind.STOP:
            self.stopped = True
            if self.running:
                with contextlib.suppress(CutError):
                    self._abort(Reason.STOPPED)
        if v["Kind"] == Kind.RELEASE and not self.running:
            self.stopped = False
        self.state.write(document(STATE.send, self._answer(v)))

    def _answer(self, v: dict) -> dict:
        values = {e.tag: 0.0 for e in STATE.send}
        said = {
            "Sequence": v["Sequence"], "Boot": self.boot, "Accepted": self.accepted, "Running": self.running,
            "Finished": self.finished, "Aborted": self.aborted, "Point": self.point, "Reason": self.reason,
            "Stopped": self.stopped, "Mode": self.mode, "Drives": self.drives, "Brakes": 1, "Estop": self.estop,
            "Clock": 1000 * time.monotonic() % 2**31, "Oldest": self.oldest, "Newest": self.newest,
        }  # fmt: skip
        values |= {f"Robot/State/@{k}": int(x) for k, x in said.items()}
        for k in range(6):
            values[f"Robot/Axis/@A{k + 1}"] = self.joints[k]
            values[f"Robot/Temperature/@A{k + 1}"] = 300.0
        if v["Kind"] == Kind.RECORDING:
            first = max(v["From"], self.oldest)
            numbers = range(first, min(first + 4, self.newest + 1))
            values["Robot/Samples/@Count"] = len(numbers)
            for k, n in enumerate(numbers, 1):
                values[f"Robot/S{k}/@N"], values[f"Robot/S{k}/@T"] = n, 12 * n
                values[f"Robot/S{k}/@Q1"], values[f"Robot/S{k}/@M2"] = 0.001 * n, 2.0 * n
        return values

    def record(self, newest: int) -> None:
        """Let it have recorded so many samples."""
        with self.lock:
            self.newest, self.oldest = newest, max(1, newest - RING + 1)
