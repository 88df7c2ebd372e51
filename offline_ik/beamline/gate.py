"""Gate before the Tango server: only whole messages pass, from a bounded number of connections.

The server of Tango (omniORB) gives a thread to each connection whose message has begun, for as long as it is not
complete: hundreds of connections that send four bytes and wait leave no thread for anybody else. Behind this door a
connection reaches that server with its first whole message, and only whole messages follow. A message is twelve bytes,
``GIOP``, and as many more as they announce (CORBA 3.3, part 2, section 9.4.1).
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
import time
from dataclasses import dataclass

__all__ = ["Bounds", "Gate", "free_port"]

HEADER = 12  # bytes
LONGEST_MESSAGE = 65536  # bytes after the header; omniORB sends fragments of 8 kB
BYTES_AT_ONCE = 65536  # bytes of answers at a time
BACKLOG = 100  # connections that wait to be accepted


@dataclass(frozen=True)
class Bounds:
    """What connections may do.

    Attributes
    ----------
    connections
        At a time. One more takes the place of one that has sent no whole message, the oldest first; where there is
        none, of the one that has been silent the longest. A Tango client whose place is taken connects again.
    patience
        s, for the first message, and for each message from its first byte to its last.
    """

    connections: int = 256
    patience: float = 5.0


class _Visitor:
    """A connection: when it was last heard, and whether it has sent a whole message."""

    def __init__(self, writer: asyncio.StreamWriter) -> None:
        self.writer, self.heard, self.spoke = writer, time.monotonic(), False

    def end(self) -> None:
        self.writer.transport.abort()


class Gate:
    """Listens in a thread of its own.

    Parameters
    ----------
    host, port
        Where.
    behind
        Port of the loopback that the device's server listens on.
    bounds
        What connections may do.
    """

    def __init__(self, host: str, port: int, behind: int, bounds: Bounds | None = None) -> None:
        self._at, self._behind, self._bounds = (host, port), behind, bounds or Bounds()
        self._visitors: set[_Visitor] = set()
        self._listening, self._trouble = threading.Event(), ""

    def open(self) -> None:
        """Listen.

        Raises
        ------
        OSError
            The address is in use, not of this machine, or not permitted.
        """
        threading.Thread(target=lambda: asyncio.run(self._serve()), name="gate", daemon=True).start()
        self._listening.wait()
        if self._trouble:
            raise OSError(self._trouble)

    async def _serve(self) -> None:
        try:
            server = await asyncio.start_server(self._visit, *self._at, backlog=BACKLOG)
        except OSError as error:
            self._trouble = error.strerror or str(error)
            return
        finally:
            self._listening.set()
        await server.serve_forever()

    def _make_place(self) -> None:
        if len(self._visitors) >= self._bounds.connections:
            first = min(self._visitors, key=lambda one: (one.spoke, one.heard))
            self._visitors.discard(first)
            first.end()

    async def _visit(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._make_place()
        visitor = _Visitor(writer)
        self._visitors.add(visitor)
        try:
            await self._pass_on(reader, visitor)
        except (OSError, EOFError, ValueError):  # hung up, by one side or the other, or no message of CORBA
            pass
        finally:
            self._visitors.discard(visitor)
            visitor.end()

    async def _pass_on(self, reader: asyncio.StreamReader, visitor: _Visitor) -> None:
        message = await self._message(reader, first=True)
        answers, server = await asyncio.open_connection("127.0.0.1", self._behind)
        back = asyncio.create_task(_copy(answers, visitor))
        try:
            while True:
                visitor.heard, visitor.spoke = time.monotonic(), True
                server.write(message)
                await server.drain()
                message = await self._message(reader)
        finally:
            back.cancel()
            server.transport.abort()

    async def _message(self, reader: asyncio.StreamReader, first: bool = False) -> bytes:
        """The next whole message.

        Raises
        ------
        ValueError
            What comes is none.
        EOFError, OSError
            Nothing comes any more; not within the patience.
        """
        begun = b"" if first else await reader.readexactly(1)
        async with asyncio.timeout(self._bounds.patience):
            header = begun + await reader.readexactly(HEADER - len(begun))
            size = int.from_bytes(header[8:12], "little" if header[6] & 1 else "big")
            if header[:4] != b"GIOP" or size > LONGEST_MESSAGE:
                raise ValueError("expected a message of CORBA")
            return header + await reader.readexactly(size)


async def _copy(answers: asyncio.StreamReader, visitor: _Visitor) -> None:
    with contextlib.suppress(OSError):
        while data := await answers.read(BYTES_AT_ONCE):
            visitor.writer.write(data)
            await visitor.writer.drain()
    visitor.end()  # the server hung up


def free_port() -> int:
    """A port of the loopback that nobody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as found:
        return int(found.getsockname()[1])
