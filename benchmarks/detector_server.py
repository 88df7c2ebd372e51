"""The command server: time beyond a bare asyncio echo, what long requests do to it, 20 000 requests, 100 000 bad lines.

    python benchmarks/detector_server.py

Malformed, truncated and oversized lines come from one client, lines that never end from others, which are hung up on.
"""

from __future__ import annotations

import asyncio
import json
import os
from pathlib import Path
from time import perf_counter, process_time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from ik_arms import CELL, drawn_model
from server_lines import GOOD, rubbish

from kinematics.description import load_robot
from offline_ik.cell.cell import read_cell
from offline_ik.inverse.opening import open_detector
from offline_ik.server.protocol import Session, Speaker
from offline_ik.server.server import Limits, Server, settle

PATIENCE = 2.0  # s for a line, so that slow ones are found out within the run
SLOW = 50  # clients that never end a line


class Echo(asyncio.Protocol):
    """What a server cannot be faster than: the answer is at hand."""

    def __init__(self, answer: bytes) -> None:
        self.answer = answer

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        self.transport.write(self.answer)


def memory() -> float:
    """Resident memory, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


async def round_trips(host: str, port: int, count: int) -> np.ndarray:
    """Seconds ``(count, 2)`` of each request, one after the other: as the client waits, and of the processor.

    Client and server are one process, so that its CPU time is that of both; what else the machine does is not in it.
    """
    reader, writer = await asyncio.open_connection(host, port, limit=1 << 20)
    near = "0.1,-1.2,1.2,0.1,0.4,0"
    took = np.empty((count, 2))
    for k in range(count):
        line = f"where gamma={0.3 + 1e-5 * (k % 1000):.6f} delta=0.2 r=0.8 near={near}\n".encode()
        start = np.array([perf_counter(), process_time()])
        writer.write(line)
        await reader.readline()
        took[k] = [perf_counter(), process_time()] - start
    writer.close()
    await writer.wait_closed()
    return took


async def beside(host: str, port: int, what: bytes, times: int = 5) -> None:
    """How long requests of one client take while another asks for what takes long, one after the other."""
    reader, writer = await asyncio.open_connection(host, port, limit=1 << 20)
    long: list[float] = []  # s each

    async def ask() -> None:
        while True:
            start = perf_counter()
            writer.write(what + b"\n")
            assert await reader.readline()
            long.append(perf_counter() - start)

    asking = asyncio.create_task(ask())
    await asyncio.sleep(0.5)
    rounds = []
    while not rounds or len(long) < times:
        rounds.append(1e3 * (await round_trips(host, port, 50))[:, 0])
    took = np.concatenate(rounds)
    asking.cancel()
    writer.close()
    print(
        f"while another client asks {what.split()[0].decode()} ({1e3 * np.median(long):.0f} ms each): "
        f"{np.median(took):.2f} ms at the median, 95 % within {np.quantile(took, 0.95):.2f}, all within "
        f"{took.max():.1f} ms"
    )


async def spoilt(server: Server, host: str, port: int) -> None:
    """100 000 lines of rubbish between 10 000 good requests, while other clients begin lines that they never end."""
    before, rng = memory(), np.random.default_rng(0)
    reader, writer = await asyncio.open_connection(host, port, limit=1 << 20)
    largest = before

    async def good_ones() -> tuple[int, int]:
        nonlocal largest
        good = answers = 0
        while line := await reader.readline():
            answers += 1
            good += json.loads(line)["ok"]
            if answers % 1000 == 0:
                largest = max(largest, memory())
        return good, answers

    slow_ones = [asyncio.create_task(slow(host, port)) for _ in range(SLOW)]
    reading = asyncio.create_task(good_ones())
    for k in range(110_000):
        writer.write((GOOD if k % 11 == 0 else rubbish(rng)) + b"\n")
        if k % 50 == 0:
            await writer.drain()
    writer.write_eof()
    good, answers = await reading
    told = sum(await asyncio.gather(*slow_ones))
    print(
        f"100 000 malformed lines: {good} of 10 000 good requests between them answered, {answers} answers in all, "
        f"{told} of {SLOW} slow clients told and hung up on, {server.failures} internal errors, memory {before:.1f}, "
        f"at most {largest:.1f}, after {memory():.1f} MB"
    )


async def slow(host: str, port: int) -> bool:
    """A client that sends a line a byte at a time, and slower; whether it was told so before the end."""
    reader, writer = await asyncio.open_connection(host, port)
    told = asyncio.create_task(reader.readline())
    while not told.done():
        if not writer.is_closing():
            writer.write(b"w")
        await asyncio.sleep(0.2 * PATIENCE)
    writer.close()
    return b"not completed" in told.result()


async def run() -> None:
    path = Path("/tmp") / f"cell-{os.getpid()}.toml"
    path.write_text(CELL, encoding="utf-8")
    detector = open_detector(drawn_model(), read_cell(path, load_robot("kuka_kr20_r1810")))
    path.unlink()
    detector.warm_up()
    server = Server(Speaker(detector), Limits(patience=PATIENCE))
    settle()
    host, port = await server.start("127.0.0.1", 0)
    loop = asyncio.get_running_loop()
    answer = server.speaker.answer(GOOD, Session())
    echo = await loop.create_server(lambda: Echo(answer), "127.0.0.1", 0)
    at = echo.sockets[0].getsockname()
    await round_trips(host, port, 500)
    ours, bare = [], []
    for _ in range(200):  # short ones by turns: what else the machine does falls on both, and on some on neither
        bare.append(await round_trips(at[0], at[1], 25))
        ours.append(await round_trips(host, port, 25))
    mine, theirs = (1e6 * np.median(np.array(v)[:, 5:], axis=1) for v in (ours, bare))  # (turns, 2)
    for what, statistic, clock in (
        ("median", np.median, 0), ("quietest turn", np.min, 0), ("median CPU time of client and server", np.median, 1)
    ):  # fmt: skip
        a, b = float(statistic(mine[:, clock])), float(statistic(theirs[:, clock]))
        print(f"{what}: {a:.0f} µs, bare echo of the same answer {b:.0f} µs: {a - b:.0f} µs beyond it")
    for what in (b"", b" branch=all"):
        await beside(host, port, GOOD.replace(b"where", b"path") + b" from=0.1,-1.2,1.2,0.1,0.4,0" + what)
    await beside(host, port, b"where gamma=0.3 delta=0.2 r=3.0")
    before = memory()
    await round_trips(host, port, 20_000)
    print(f"20 000 requests: memory {before:.1f} to {memory():.1f} MB")
    await spoilt(server, host, port)
    echo.close()
    await server.close()


if __name__ == "__main__":
    asyncio.run(run())
