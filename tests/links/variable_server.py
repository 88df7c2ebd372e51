"""A variable proxy for tests: what KUKAVARPROXY is on a real controller."""

from __future__ import annotations

import contextlib
import socket
import socketserver
import struct
import threading
from collections.abc import Callable

from experiments.links.varproxy_wire import Question

GOOD, BAD = b"\x00\x01\x01", b"\x00\x00\x00"

IDLE = 60.0  # s after which a silent client is dropped
MOST_CLIENTS = 10


class VariableServer:
    """Serves variables, in threads of its own, until closed.

    Parameters
    ----------
    host, port
        Where to listen; port 0: any.
    read
        A variable's value as text, or None. Called from several threads.
    write
        Takes a variable's name and value; whether it could be written.
    """

    def __init__(
        self,
        host: str,
        port: int,
        read: Callable[[str], str | None],
        write: Callable[[str, str], bool] = lambda name, value: False,
    ) -> None:
        slots = threading.BoundedSemaphore(MOST_CLIENTS)

        class Handler(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                if not slots.acquire(blocking=False):
                    return
                try:
                    _converse(self.request, read, write)
                finally:
                    slots.release()

        socketserver.ThreadingTCPServer.allow_reuse_address = True
        self._server = socketserver.ThreadingTCPServer((host, port), Handler)
        self._server.daemon_threads = True
        self._server.block_on_close = False
        self.port: int = self._server.server_address[1]
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def _converse(client: socket.socket, read: Callable[[str], str | None], write: Callable[[str, str], bool]) -> None:
    """Answer one client until it is gone, silent, or speaks something else."""
    client.settimeout(IDLE)
    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    stream = Questions()
    with contextlib.suppress(OSError, ValueError):
        while data := client.recv(4096):
            for question in stream.feed(data):
                if question.value is None:
                    value = read(question.name)
                else:
                    value = question.value if write(question.name, question.value) else None
                client.sendall(answer_bytes(question.number, question.value is not None, value))


def answer_bytes(number: int, written: bool, value: str | None) -> bytes:
    """Write an answer; None as value: there is none."""
    text = (value or "").encode()
    body = struct.pack(">BH", written, len(text)) + text + (BAD if value is None else GOOD)
    return struct.pack(">HH", number, len(body)) + body


class Questions:
    """What a server reads."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[Question]:
        """Take a piece; give the questions that are whole."""
        self._buffer += data
        found = []
        while len(self._buffer) >= 4:
            number, length = struct.unpack_from(">HH", self._buffer)
            if not 3 <= length <= 4096:
                raise ValueError("no message")
            if len(self._buffer) < 4 + length:
                break
            found.append(_question(number, self._buffer[4 : 4 + length]))
            self._buffer = self._buffer[4 + length :]
        return found


def _question(number: int, body: bytes) -> Question:
    mode, length = struct.unpack_from(">BH", body)
    name, rest = body[3 : 3 + length], body[3 + length :]
    if mode not in (0, 1) or len(name) < length:
        raise ValueError("no variable")
    if mode == 0:
        return Question(number, name.decode())
    if len(rest) < 2 or len(rest) < 2 + struct.unpack_from(">H", rest)[0]:
        raise ValueError("no value")
    return Question(number, name.decode(), rest[2 : 2 + struct.unpack_from(">H", rest)[0]].decode())
