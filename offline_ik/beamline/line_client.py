"""Clients of the line protocol, for threads and for asyncio; Tango, EPICS and bluesky use them.

Nothing that moves is sent twice. What only asks is asked again over a new connection where the old one had ended.
A `move` is sent over a connection that has just answered; where its own answer does not come, what became of it is not
known, and that is said.
"""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import orjson

from clampid.wrong_call import CallError

__all__ = ["AsyncLine", "Line", "LostError", "RefusedError", "Server", "line_of"]

LONGEST_ANSWER = 1 << 24  # bytes
CONNECT = 3.0  # s
ANSWER = 30.0  # s that an answer may take, waiting for a motion aside


class RefusedError(CallError):
    """The server refused a request; the message is its own."""


class LostError(CallError):
    """The server cannot be reached, or its answer did not come: what a `move` did is not known then."""


@dataclass(frozen=True)
class Server:
    """Where the line protocol's server is, and how one greets it; who does not greet only asks."""

    host: str
    port: int
    name: str = ""
    token: str | None = field(default=None, repr=False)
    greets: bool = True

    @property
    def greeting(self) -> bytes:
        """The first line of a connection."""
        pairs = {"name": self.name or None, "token": self.token}
        return line_of("hello", {k: v for k, v in pairs.items() if v is not None})


def line_of(word: str, given: Mapping[str, Any]) -> bytes:
    """A request's line; floats in full, lists with commas, True as yes.

    Raises
    ------
    RefusedError
        A value has blanks or control characters.
    """
    parts = [word]
    for key, value in given.items():
        match value:
            case bool():
                text = "yes" if value else "no"
            case float():
                text = repr(float(value))
            case str() | int():
                text = str(value)
            case _:
                text = ",".join(repr(float(v)) for v in value)
        if not text or not text.isascii() or not text.isprintable() or " " in text:
            raise RefusedError(f"{key}: expected printable ASCII without blanks")
        parts.append(f"{key}={text}")
    return " ".join(parts).encode() + b"\n"


def _answer(found: bytes) -> dict[str, Any]:
    if not found.endswith(b"\n"):
        raise LostError("the connection to the server ended before its answer came")
    try:
        reply = orjson.loads(found)
    except orjson.JSONDecodeError:
        reply = None
    if not isinstance(reply, dict):
        raise LostError("the server answered something else than JSON: is it clampid serve?")
    if reply.get("ok") is not True:
        raise RefusedError(str(reply.get("error", "refused")))
    return reply


class Line:
    """One connection, for one thread at a time; others wait."""

    def __init__(self, server: Server) -> None:
        self.server = server
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None
        self._read = b""

    def ask(self, word: str, timeout: float = ANSWER, **given: Any) -> dict[str, Any]:
        """The answer to a request that moves nothing.

        Raises
        ------
        RefusedError
            The server refuses it.
        LostError
            It cannot be reached.
        """
        line = line_of(word, given)
        with self._lock:
            old = self._socket is not None
            try:
                return self._ask(line, timeout)
            except LostError:
                if not old:
                    raise
                return self._ask(line, timeout)

    def move(self, timeout: float = ANSWER, **given: Any) -> dict[str, Any]:
        """The answer to `move`, which is sent once.

        Raises
        ------
        RefusedError, LostError
            As above; after the latter ask `robot` where it is.
        """
        line = line_of("move", given)
        with self._lock:
            if self._socket is not None:
                try:
                    self._ask(self.server.greeting, ANSWER)  # is the server still there?
                except LostError:
                    self._greeted()
            return self._ask(line, timeout)

    def close(self) -> None:
        """End the connection."""
        with self._lock:
            self._drop()

    def _drop(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket, self._read = None, b""

    def _greeted(self) -> None:
        try:
            self._socket = socket.create_connection((self.server.host, self.server.port), timeout=CONNECT)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            self._socket = None
            raise LostError(f"the server at {self.server.host}:{self.server.port} cannot be reached: {error}") from None
        if not self.server.greets:
            return
        try:
            self._ask(self.server.greeting, ANSWER)
        except RefusedError:
            self._drop()
            raise

    def _ask(self, line: bytes, timeout: float) -> dict[str, Any]:
        if self._socket is None:
            self._greeted()
        assert self._socket is not None
        try:
            self._socket.settimeout(timeout)
            self._socket.sendall(line)
            while b"\n" not in self._read:
                found = self._socket.recv(1 << 16)
                if not found or len(self._read) > LONGEST_ANSWER:
                    raise OSError("the connection ended")
                self._read += found
        except OSError as error:
            self._drop()
            raise LostError(f"the server at {self.server.host}:{self.server.port} did not answer: {error}") from None
        reply, _, self._read = self._read.partition(b"\n")
        return _answer(reply + b"\n")


class AsyncLine:
    """The same for asyncio: one request at a time, in turn."""

    def __init__(self, server: Server) -> None:
        self.server = server
        self._lock = asyncio.Lock()
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def ask(self, word: str, timeout: float = ANSWER, **given: Any) -> dict[str, Any]:
        """As :meth:`Line.ask`."""
        line = line_of(word, given)
        async with self._lock:
            old = self._streams is not None
            try:
                return await self._ask(line, timeout)
            except LostError:
                if not old:
                    raise
                return await self._ask(line, timeout)

    async def move(self, timeout: float = ANSWER, **given: Any) -> dict[str, Any]:
        """As :meth:`Line.move`."""
        line = line_of("move", given)
        async with self._lock:
            if self._streams is not None:
                try:
                    await self._ask(self.server.greeting, ANSWER)
                except LostError:
                    await self._greet()
            return await self._ask(line, timeout)

    async def close(self) -> None:
        """End the connection."""
        self._drop()

    def _drop(self) -> None:
        if self._streams is not None:
            self._streams[1].close()
        self._streams = None

    async def _greet(self) -> None:
        try:
            async with asyncio.timeout(CONNECT):
                self._streams = await asyncio.open_connection(self.server.host, self.server.port, limit=LONGEST_ANSWER)
        except (OSError, TimeoutError) as error:
            self._streams = None
            raise LostError(f"the server at {self.server.host}:{self.server.port} cannot be reached: {error}") from None
        if not self.server.greets:
            return
        try:
            await self._ask(self.server.greeting, ANSWER)
        except RefusedError:
            self._drop()
            raise

    async def _ask(self, line: bytes, timeout: float) -> dict[str, Any]:
        if self._streams is None:
            await self._greet()
        assert self._streams is not None
        reader, writer = self._streams
        try:
            async with asyncio.timeout(timeout):
                writer.write(line)
                await writer.drain()
                found = await reader.readline()
            return _answer(found)
        except RefusedError:
            raise
        except (LostError, asyncio.CancelledError):
            self._drop()  # an answer that comes later must not be taken for the next one's
            raise
        except (OSError, ValueError, TimeoutError) as error:
            self._drop()
            raise LostError(f"the server at {self.server.host}:{self.server.port} did not answer: {error}") from None
