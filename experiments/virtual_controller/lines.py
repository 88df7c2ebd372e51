"""A small service of lines: one request a line, one JSON answer a line; bounded lines, clients and patience.

A connection that begins with none of the service's words speaks another protocol (a web page's POST, say): it is told
so and hung up on, and no later line of it is obeyed.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Collection
from typing import Any

from experiments.virtual_controller.errors import ControllerError

__all__ = ["LineService"]

LINE_BYTES = 1024
CLIENTS = 16  # at once; one more, and the one that has been silent longest is hung up on
PATIENCE = 10.0  # s for a line that has begun, or an answer that is not read

Answer = Callable[[str], Awaitable[dict[str, Any]]]


class LineService:
    """Answers lines.

    Parameters
    ----------
    answer
        Gets a line without its end; a `ControllerError` becomes ``{"error": …}``.
    words
        With one of which a line begins.
    """

    def __init__(self, answer: Answer, words: Collection[str]) -> None:
        self._answer, self._words = answer, frozenset(word.encode() for word in words)
        self._clients: dict[asyncio.StreamWriter, float] = {}
        self.refused = 0  # lines that were none

    async def client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection until it ends."""
        loop = asyncio.get_running_loop()
        if len(self._clients) >= CLIENTS:
            silent = min(self._clients, key=lambda one: self._clients[one])
            self._clients.pop(silent)
            silent.transport.abort()
        self._clients[writer] = loop.time()
        known = False
        try:
            while (line := await _line(reader)) is not None:
                self._clients[writer] = loop.time()
                known = known or b"".join(line.split()[:1]) in self._words
                writer.write(await self._reply(line))
                await asyncio.wait_for(writer.drain(), PATIENCE)
                if not known:
                    break
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            self.refused += 1
        except asyncio.CancelledError:
            pass  # the controller ends; streams would print a cancelled client's traceback
        finally:
            self._clients.pop(writer, None)
            writer.transport.abort() if writer.is_closing() else writer.close()

    async def _reply(self, line: bytes) -> bytes:
        try:
            text = line.decode("ascii").strip()
            if not text.isprintable():
                raise ControllerError("expected printable ASCII")
            answer = await self._answer(text)
        except UnicodeDecodeError:
            answer = {"error": "expected printable ASCII"}
        except ControllerError as error:
            answer = {"error": str(error)}
        if "error" in answer:
            self.refused += 1
        return json.dumps(answer).encode() + b"\n"


async def _line(reader: asyncio.StreamReader) -> bytes | None:
    """The next line; None at the end. A line that has begun must end within the patience."""
    first = await reader.read(1)
    if not first:
        return None
    if first == b"\n":
        return first
    return first + await asyncio.wait_for(reader.readuntil(b"\n"), PATIENCE)
