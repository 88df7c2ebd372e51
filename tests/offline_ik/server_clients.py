"""A server in the process, clients that talk to it, and a linked robot that records its moves."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any

import numpy as np

from offline_ik.inverse.detector import Detector
from offline_ik.server.protocol import Speaker
from offline_ik.server.server import Limits, Server

__all__ = ["Link", "Talk", "ask", "connected", "serving", "until"]

Talk = Callable[[Server, str, int], Awaitable[Any]]


def serving(detector: Detector, talk: Talk, limits: Limits | None = None) -> Any:
    async def run() -> Any:
        server = Server(Speaker(detector), limits)
        host, port = await server.start("127.0.0.1", 0)
        try:
            return await asyncio.wait_for(talk(server, host, port), 120)
        finally:
            await server.close()

    return asyncio.run(run())


@asynccontextmanager
async def connected(
    host: str, port: int, hello: bool = False
) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    """A client that leaves nothing open behind it."""
    reader, writer = await asyncio.open_connection(host, port, limit=1 << 20)
    try:
        if hello:
            assert (await ask(reader, writer, b"hello"))["ok"]
        yield reader, writer
    finally:
        writer.transport.abort()
        with suppress(ConnectionError):
            await writer.wait_closed()


async def until(holds: Callable[[], Any]) -> None:
    """Let the loop turn until a condition holds, which it is to do soon."""
    async with asyncio.timeout(20):
        while not holds():
            await asyncio.sleep(0.002)


async def ask(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, line: bytes) -> dict[str, Any]:
    writer.write(line + b"\n")
    answer: dict[str, Any] = json.loads(await reader.readline())
    return answer


class Link:
    """A linked robot that remembers where it was sent."""

    def __init__(self, q: np.ndarray) -> None:
        self.q, self.sent = q, 0

    def posture(self) -> np.ndarray:
        return self.q

    def move(self, postures: np.ndarray, speed: float) -> None:
        self.sent += 1

    def state(self) -> dict[str, Any]:
        return {}

    def stop(self) -> None:
        pass
