"""The line protocol's server on a loop in a thread of its own, and plain clients of it."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
from types import TracebackType
from typing import Any

from memory_link import MemoryLink

from offline_ik.inverse.detector import Detector
from offline_ik.server.protocol import Speaker
from offline_ik.server.server import Limits, Server


class Serving:
    """A server that runs while the block does."""

    def __init__(
        self, detector: Detector, link: MemoryLink | None, *, token: str | None = None, answers_only: bool = False,
        limits: Limits | None = None,
    ) -> None:  # fmt: skip
        self.speaker = Speaker(detector, link, token=token, answers_only=answers_only)
        self._limits = limits
        self._ready = threading.Event()
        self.at = ("", 0)

    def __enter__(self) -> Serving:
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()))
        self._thread.start()
        assert self._ready.wait(30)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join(30)

    async def _serve(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        self.server = Server(self.speaker, self._limits)
        self.at = await self.server.start("127.0.0.1", 0)
        self._ready.set()
        await self._end.wait()
        await self.server.close()

    @property
    def address(self) -> str:
        return f"{self.at[0]}:{self.at[1]}"

    def client(self, name: str = "", hello: bool = True) -> Talker:
        return Talker(self.at, name, hello)


class Talker:
    """One connection, as anybody would write it."""

    def __init__(self, at: tuple[str, int], name: str = "", hello: bool = True) -> None:
        self.socket = socket.create_connection(at, timeout=20)
        self.lines = self.socket.makefile("rb")
        if hello:
            assert self.ask("hello" + (f" name={name}" if name else ""))["ok"]

    def send(self, line: str) -> None:
        self.socket.sendall(line.encode() + b"\n")

    def hear(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.lines.readline())
        return found

    def ask(self, line: str) -> dict[str, Any]:
        self.send(line)
        return self.hear()

    def close(self) -> None:
        self.lines.close()
        self.socket.close()

    def __enter__(self) -> Talker:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
