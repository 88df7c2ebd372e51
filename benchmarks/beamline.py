"""The beamline side: a command's time beyond a bare echo, from request to the robot's link, and 20 000 commands.

    python benchmarks/beamline.py

Client and server are one process on one loop; the echo is on the same loop and answers as many bytes, by turns with the
server, so that what else the machine does falls on both. "Beyond the check" is from the client's write to the link's
`move` call, less what the check of that very way takes when it is asked for alone (`simulate_move`, by turns).
"""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from pathlib import Path
from time import perf_counter
from unittest.mock import patch

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from detector_server import Echo, memory
from ik_arms import CELL, drawn_model

from experiments.links.address import open_link
from experiments.links.connection import Connection
from kinematics.description import load_robot
from offline_ik.cell.cell import read_cell
from offline_ik.exchange.link import LinkedRobot
from offline_ik.inverse.detector import Detector
from offline_ik.inverse.opening import open_detector
from offline_ik.motion.simulation import Position, simulate_move
from offline_ik.server.protocol import Session, Speaker
from offline_ik.server.server import Server, settle

START = np.array([0.1, -1.2, 1.2, 0.1, 0.4, 0.0])
TURNS, EACH = 100, 25
MOVES = 300


class Link:
    """Arrives at once, and notes when it was called."""

    def __init__(self) -> None:
        self.q, self.called, self.stopped = START, 0.0, 0.0

    def posture(self) -> np.ndarray:
        return self.q

    def move(self, postures: np.ndarray, speed: float) -> None:
        self.called = perf_counter()
        self.q = np.array(postures[-1])

    def state(self) -> dict[str, object]:
        return {"moving": False, "age_s": 0.0}

    def stop(self) -> None:
        self.stopped = perf_counter()


class Line:
    """A client."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    @classmethod
    async def to(cls, host: str, port: int) -> Line:
        return cls(*await asyncio.open_connection(host, port, limit=1 << 20))

    async def ask(self, line: bytes) -> bytes:
        self.writer.write(line + b"\n")
        return await self.reader.readline()


def files() -> int:
    """Open file descriptors."""
    return len(os.listdir("/proc/self/fd"))


async def beyond_echo(ours: Line, speaker: Speaker, line: bytes) -> None:
    """A command against an echo of the same answer."""
    answer = speaker.answer(line, Session(greeted=True))
    echo = await asyncio.get_running_loop().create_server(lambda: Echo(answer), "127.0.0.1", 0)
    bare = await Line.to(*echo.sockets[0].getsockname()[:2])
    mine, theirs = [], []
    for _ in range(TURNS):
        for client, took in ((bare, theirs), (ours, mine)):
            for k in range(EACH):
                begun = perf_counter()
                await client.ask(line)
                if k > 4:
                    took.append(perf_counter() - begun)
    a, b = 1e6 * np.median(mine), 1e6 * np.median(theirs)
    print(f"{line.split()[0].decode()}: {a:.0f} µs at the median, echo {b:.0f} µs, {a - b:.0f} µs beyond it")
    bare.writer.close()
    echo.close()


async def over_ethernetkrl(detector: Detector) -> None:
    """A link that does not wait, with a virtual controller in a process of its own behind it.

    `stop` against an echo, and the time from the client's `move` until its documents are with the system's socket.
    """
    command = [sys.executable, "-m", "clampid", "virtual-robot", "--listen", "127.0.0.1:0", "--speed", "1000"]
    sent, send = [0.0], Connection.send

    def timed(self: Connection, data: bytes, patience: float = 0.0) -> None:
        send(self, data, patience)
        if data.startswith(b"<Move>"):
            sent[0] = perf_counter()

    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as controller,
        patch.object(Connection, "send", timed),
    ):
        assert controller.stdout is not None
        robot = LinkedRobot(open_link(controller.stdout.readline().split()[-1]), "eki://")
        server = Server(Speaker(detector, robot))
        ours = await Line.to(*await server.start("127.0.0.1", 0))
        await ours.ask(b"hello")
        took, check = [], []
        for k in range(MOVES):
            gamma = 0.30 + 0.005 * (k % 2)
            here = robot.posture()
            begun = perf_counter()
            simulate_move(detector, Position(gamma, 0.2, 0.8), start=here)
            check.append(1e3 * (perf_counter() - begun))
            begun = perf_counter()
            answer = json.loads(await ours.ask(b"move gamma=%r delta=0.2 r=0.8 wait=yes" % gamma))
            assert answer["ended"]["outcome"] == "arrived", answer
            took.append(1e3 * (sent[0] - begun))
        less = np.subtract(took, check)[2:]
        print(
            f"EthernetKRL, from move to its documents on the socket: {np.median(took[2:]):.2f} ms at the median, the "
            f"check alone {np.median(check[2:]):.2f} ms, {np.median(less):.2f} ms beyond it"
        )
        print("EthernetKRL, ", end="")
        await beyond_echo(ours, server.speaker, b"stop")
        ours.writer.close()
        await server.close()
        robot.close()
        controller.terminate()


async def to_the_link(ours: Line, detector: Detector, link: Link) -> None:
    """From a request to the link's `move`, and the check alone."""
    twin, request, check = detector.twin, [], []
    for k in range(MOVES):
        gamma = 0.30 + 0.05 * (k % 2)
        begun = perf_counter()
        simulate_move(twin, Position(gamma, 0.2, 0.8), start=link.q)
        check.append(perf_counter() - begun)
        begun = perf_counter()
        assert json.loads(await ours.ask(b"move gamma=%r delta=0.2 r=0.8" % gamma))["moving"]
        request.append(link.called - begun)
    a, b = 1e3 * np.median(request[2:]), 1e3 * np.median(check[2:])
    more = 1e3 * np.median(np.subtract(request, check)[2:])
    print(f"from move to the link: {a:.2f} ms at the median, the check alone {b:.2f} ms, {more:.2f} ms beyond it")


async def stopping(ours: Line, host: str, port: int, link: Link) -> None:
    """From `stop` to the link, while another client keeps the server computing."""
    other, took = await Line.to(host, port), []

    async def keep_busy() -> None:
        while True:
            await other.ask(b"path gamma=0.3 delta=0.2 r=0.8 branch=all from=0.1,-1.2,1.2,0.1,0.4,0")

    busy = asyncio.create_task(keep_busy())
    await asyncio.sleep(0.1)
    for _ in range(300):
        begun = perf_counter()
        await ours.ask(b"stop")
        took.append(1e3 * (link.stopped - begun))
        await asyncio.sleep(0.003)
    busy.cancel()
    other.writer.close()
    late = np.quantile(took, 0.99)
    print(f"stop beside a client that computes: {np.median(took):.2f} ms at the median, 99 % within {late:.1f} ms")


async def many(ours: Line, count: int) -> None:
    """Commands without growth."""
    words = (
        b"where gamma=%.6f delta=0.2 r=0.8",
        b"robot",
        b"pixel i=0 j=0 pixels=514,514",
        b"moved timeout=0",
        b"state",
    )
    for k in range(2000):
        await ours.ask(words[k % 5] % (0.3 + 1e-5 * k) if k % 5 == 0 else words[k % 5])
    before, open_before, most = memory(), files(), 0.0
    for k in range(count):
        await ours.ask(words[k % 5] % (0.3 + 1e-6 * k) if k % 5 == 0 else words[k % 5])
        most = max(most, memory()) if k % 1000 == 0 else most
    print(
        f"{count} commands: memory {before:.1f}, at most {most:.1f}, after {memory():.1f} MB; "
        f"{open_before} open files before, {files()} after"
    )


async def run() -> None:
    path = Path("/tmp") / f"cell-{os.getpid()}.toml"
    path.write_text(CELL, encoding="utf-8")
    detector = open_detector(drawn_model(), read_cell(path, load_robot("kuka_kr20_r1810")))
    path.unlink()
    detector.warm_up()
    link = Link()
    server = Server(Speaker(detector, link))
    settle()
    host, port = await server.start("127.0.0.1", 0)
    ours = await Line.to(host, port)
    await ours.ask(b"hello")
    for line in (b"where gamma=0.3 delta=0.2 r=0.8 near=0.1,-1.2,1.2,0.1,0.4,0", b"robot", b"stop", b"hello"):
        await beyond_echo(ours, server.speaker, line)
    await over_ethernetkrl(detector)
    link.q = START
    await to_the_link(ours, detector, link)
    await stopping(ours, host, port, link)
    await many(ours, 20_000)
    ours.writer.close()
    await server.close()


if __name__ == "__main__":
    asyncio.run(run())
