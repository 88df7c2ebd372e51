"""Speaks to a virtual controller in a process of its own: raw sockets, no code of the suite's client."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from experiments.links.eki_config import config_text
from experiments.links.schema import MOTION, STATE
from experiments.virtual_controller.arm import COUNT, FLICKER
from experiments.virtual_controller.running import Asked, built
from experiments.virtual_controller.serving import Address
from kinematics.description import load_robot

START = (
    "import sys; from clampid.verbs.virtual_robot import virtual_robot; import typer; "
    "app = typer.Typer(); app.command()(virtual_robot); app(sys.argv[1:])"
)
AXES = range(1, 7)
TRANSMISSION = load_robot("kuka_kr20_r1810").transmission
HOME = np.array([0.0, -60.0, 18.5, 0.0, 0.0, 0.0])
STEP = np.array([10.0, 5.0, -5.0, 20.0, 10.0, -30.0])


def move(boot: int, number: int, points: Sequence[Sequence[float]], speed: float = 100.0) -> list[bytes]:
    """Documents of one program; angles in degrees."""
    return [
        f"<Move><Boot>{boot}</Boot><Id>{number}</Id><Point>{k}</Point><Count>{len(points)}</Count>"
        f"<Speed>{speed}</Speed><Axis {_attributes(point)}></Axis></Move>".encode()
        for k, point in enumerate(points, 1)
    ]


def _attributes(point: Sequence[float]) -> str:
    return " ".join(f'A{k}="{angle:.9g}"' for k, angle in zip(AXES, point, strict=True))


class Link:
    """One connection, read by the end tag of its documents."""

    def __init__(self, address: tuple[str, int], root: str) -> None:
        self.sock = socket.create_connection(address, 5)
        self.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.end, self.rest = f"</{root}>".encode(), b""

    def send(self, data: bytes) -> None:
        self.sock.sendall(data)

    def receive(self, timeout: float = 5.0) -> dict[str, float]:
        """The next document as numbers by name; ConnectionError at the end."""
        until = time.monotonic() + timeout
        while self.end not in self.rest:
            if not select.select([self.sock], [], [], max(until - time.monotonic(), 0.0))[0]:
                raise TimeoutError(self.rest[:200])
            more = self.sock.recv(65536)
            if not more:
                raise ConnectionError("closed")
            self.rest += more
        document, _, self.rest = self.rest.partition(self.end)
        return numbers(document)

    def closed(self, timeout: float = 3.0) -> bool:
        """Whether the other side hangs up."""
        until = time.monotonic() + timeout
        with contextlib.suppress(ConnectionError):
            while time.monotonic() < until:
                if select.select([self.sock], [], [], 0.05)[0] and not self.sock.recv(65536):
                    return True
            return False
        return True

    def close(self) -> None:
        self.sock.close()

    def __enter__(self) -> Link:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def configs() -> tuple[tuple[str, str], tuple[str, str]]:
    """The config files that are shipped."""
    motion, state = ((f"{channel.name}.xml", config_text(channel)) for channel in (MOTION, STATE))
    return motion, state


def numbers(document: bytes) -> dict[str, float]:
    """Values by name: ``Boot`` of an element, ``Axis.A1`` of an attribute."""
    text = document.decode()
    found = {name: float(value) for name, value in re.findall(r"<(\w+)>([^<>]+)<", text)}
    for name, attributes in re.findall(r"<(\w+) ([^<>]*)>", text):
        found |= {f"{name}.{key}": float(value) for key, value in re.findall(r'(\w+)="([^"]*)"', attributes)}
    return found


class Controller:
    """Speaks to a running virtual controller; `at` says where its services are."""

    truth: Path | None

    def __init__(self) -> None:
        self.at: dict[str, tuple[str, int]] = {}
        self.sequence = 0
        self._state: Link | None = None
        self._lines: dict[str, Any] = {}

    def fresh(self, speed: float = 20.0) -> Controller:
        """Everything as after switch-on, at `HOME`."""
        self.lost_state()
        for line in ("estop off", "mode EXT", "drives on", "sight lost 0", "kill-link", "speed 1000"):
            assert "error" not in self.line("operator", line)
        while not self.try_ask():
            time.sleep(0.02)
        self.ask(1)
        until = time.monotonic() + 5
        while self.ask(2)["State.Stopped"]:
            assert time.monotonic() < until
        assert self.run(int(self.ask()["State.Accepted"]) + 1, [HOME]) == [1, 2, 3]
        self.lost_state()
        for line in (f"speed {speed}", "restart"):
            assert "error" not in self.line("operator", line)
        for fault in ("split=0", "coalesce=0", "padding=0"):
            assert "error" not in self.line("operator", f"fault {fault}")
        while not self.try_ask():
            time.sleep(0.02)
        return self

    @property
    def boot(self) -> int:
        return int(self.line("operator", "state")["boot"])

    def try_ask(self) -> dict[str, float] | None:
        """The state, or None where nobody answers now."""
        try:
            return self.ask()
        except ConnectionError:
            self.lost_state()
            return None

    def motion(self) -> Link:
        return Link(self.at["listening"], "Moved")

    def state_link(self) -> Link:
        return Link(self.at["state"], "Robot")

    def ask(self, kind: int = 0, first: int = 0) -> dict[str, float]:
        """The state, over a connection that is kept."""
        if self._state is None:
            self._state = self.state_link()
        self.sequence += 1
        self._state.send(
            f"<Ask><Sequence>{self.sequence}</Sequence><Kind>{kind}</Kind><From>{first}</From></Ask>".encode()
        )
        answer = self._state.receive()
        assert answer["State.Sequence"] == self.sequence
        return answer

    def lost_state(self) -> None:
        """Forget the state connection."""
        if self._state is not None:
            self._state.close()
            self._state = None

    def line(self, what: str, text: str) -> dict[str, Any]:
        """One line of the operator's or the instrument's protocol."""
        if what not in self._lines:
            sock = socket.create_connection(self.at[what], 10)
            self._lines[what] = sock, sock.makefile("rwb")
        _, file = self._lines[what]
        file.write(text.encode() + b"\n")
        file.flush()
        answer: dict[str, Any] = json.loads(file.readline())
        return answer

    def run(
        self, number: int, points: Sequence[Sequence[float]], speed: float = 100.0, timeout: float = 20.0
    ) -> list[int]:
        """Run a program to its end; the events."""
        boot = int(self.ask()["State.Boot"])
        with self.motion() as link:
            link.send(b"".join(move(boot, number, points, speed)))
            events: list[int] = []
            until = time.monotonic() + timeout
            while not events or events[-1] not in (3, 4, 5):
                try:
                    events.append(int(link.receive(0.5)["Event"]))
                except TimeoutError:
                    assert time.monotonic() < until
                    self.ask()
            return events

    def events(self) -> list[dict[str, Any]]:
        """The journal."""
        assert self.truth is not None
        file = self.truth.with_name(f"{self.truth.stem}.journal.jsonl")
        return [json.loads(line) for line in file.read_text().splitlines()]

    def said(self, event: int) -> list[tuple[int, int, int]]:
        """Boot, id and point of the journal's events of one kind."""
        return [(e["boot"], e["id"], e["point"]) for e in self.events() if e["event"] == event]

    def told(self, event: int) -> list[tuple[int, int]]:
        """Id and point of such events since the last start."""
        boot = self.boot
        return [said[1:] for said in self.said(event) if said[0] == boot]

    def hang_up(self) -> None:
        self.lost_state()
        for sock, file in self._lines.values():
            with contextlib.suppress(OSError):
                file.close()
            sock.close()
        self._lines.clear()


class Process(Controller):
    """A ``clampid virtual-robot`` in a process of its own."""

    def __init__(
        self, *options: str, truth: Path | None = None, wants: Sequence[str] = ("operator", "tracker")
    ) -> None:
        super().__init__()
        self.truth = truth
        besides = [part for name in wants for part in (f"--{name}", "127.0.0.1:0")]
        told = [] if truth is None else ["--truth", str(truth)]
        self.process = subprocess.Popen(
            [sys.executable, "-c", START, "--listen", "127.0.0.1:0", *besides, *told, *options],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        for _ in range(1 + len(wants)):
            assert self.process.stdout is not None
            line = self.process.stdout.readline()
            found = re.fullmatch(r"(\w+) on (\S+):(\d+)\n", line)
            assert found, (line, self.process.stderr.read() if self.process.stderr else "")
            self.at[found[1]] = (found[2], int(found[3]))
        host, port = self.at["listening"]
        self.at["state"] = (host, port + 1)

    def memory(self) -> float:
        """MB that it holds."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        found = re.search(r"VmRSS:\s+(\d+)", status)
        assert found
        return int(found[1]) / 1024

    def cpu(self) -> float:
        """CPU seconds that it has used."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / 100.0

    def descriptors(self) -> int:
        return len(list(Path(f"/proc/{self.process.pid}/fd").iterdir()))

    def kill(self) -> None:
        """End it as a power cut does."""
        self.hang_up()
        self.process.kill()
        self.process.communicate(timeout=20)

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)  # while its clients are still there
        try:
            _, errors = self.process.communicate(timeout=20)
        finally:
            self.process.kill()
            self.hang_up()
        assert self.process.returncode == 0, errors
        assert not errors, errors


class Inside(Controller):
    """A virtual controller in a thread of the test: quick to start; what goes wrong in its loop is kept."""

    def __init__(self, truth: Path | None = None, **asked: Any) -> None:
        super().__init__()
        self.truth = truth
        description = load_robot(asked.pop("robot", "kuka_kr20_r1810"))
        self.robot = built(Asked(robot=description, configs=configs(), truth=truth, **asked))
        self.robot.restart_time = 0.05
        self.errors: list[dict[str, Any]] = []
        self._loop = asyncio.new_event_loop()
        self._loop.set_exception_handler(lambda _, context: self.errors.append(context))
        ready = threading.Event()
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(self._serve(ready),))
        self._thread.start()
        assert ready.wait(20)

    async def _serve(self, ready: threading.Event) -> None:
        self._serving = asyncio.ensure_future(self.robot.run())
        host, port = await self.robot.listen(Address("127.0.0.1", 0))
        self.at = {"listening": (host, port), "state": (host, port + 1)}
        for name in ("operator", "tracker", "varproxy"):
            self.at[name] = await self.robot.listen_besides(name, Address("127.0.0.1", 0))
        ready.set()
        with contextlib.suppress(asyncio.CancelledError):
            await self._serving
        self.robot.close()
        for _ in range(5):
            await asyncio.sleep(0)
        rest = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
        for task in rest:
            task.cancel()
        await asyncio.gather(*rest, return_exceptions=True)

    def end(self) -> None:
        self.hang_up()
        self._loop.call_soon_threadsafe(self._serving.cancel)
        self._thread.join(20)
        self._loop.close()
        assert not self.errors, self.errors


@contextlib.contextmanager
def process(
    *options: str, truth: Path | None = None, wants: Sequence[str] = ("operator", "tracker")
) -> Iterator[Process]:
    """A controller in its process, which must end cleanly, with nothing on stderr."""
    one = Process(*options, truth=truth, wants=wants)
    try:
        yield one
    finally:
        one.end()


@contextlib.contextmanager
def inside(truth: Path | None = None, **asked: Any) -> Iterator[Inside]:
    """A controller in a thread, in whose loop nothing may have gone wrong."""
    one = Inside(truth, **asked)
    try:
        yield one
    finally:
        one.end()


def angles(answer: dict[str, float], of: str = "Axis") -> np.ndarray[Any, Any]:
    """Six values of an answer."""
    return np.array([answer[f"{of}.A{k}"] for k in AXES])


def same_place(read: ArrayLike, at: ArrayLike, readings: int = 1) -> bool:
    """Whether angles that were read, deg, are those of ``at``, within what encoders can read wrongly.

    A count is rounded and flickers: a motor's angle is wrong by half a count and five standard deviations at most, and
    a joint's by that of every motor that turns it. ``readings``: two where ``at`` was read as well.
    """
    wrong = readings * (0.5 + 5 * FLICKER) * np.degrees(COUNT)
    return bool(np.all(np.abs(np.subtract(read, at)) <= wrong * np.sum(np.abs(TRANSMISSION), axis=1)))
