"""One EthernetKRL channel on a socket: one client, queues that overflow, answers in the config's form, faults.

When the connection ends, ``$FLAG`` ALIVE falls and the program runs ``EKI_Clear``, ``EKI_Init`` and ``EKI_Open``: the
queues are empty again, and the next client may come. Where EthernetKRL closes (a queue that overflows, a document that
is no XML, beyond BUFFSIZE, or with a value of another type), this closes at once; what was stored before is still
taken.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Mapping, Sequence
from typing import cast

from experiments.virtual_controller.config import Config
from experiments.virtual_controller.documents import Splitter, Value, Writer
from experiments.virtual_controller.errors import DocumentError
from experiments.virtual_controller.faults import ChannelFaults
from experiments.virtual_controller.fifos import Fifos

__all__ = ["Channel"]

UNREAD_BYTES = 65536  # bytes that a client may leave unread; then the connection is closed
COALESCE_S = 0.05  # s, after which held answers go out
SPLIT_S = 0.0005  # s between two pieces of an answer
KEEPALIVE = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}  # s, s, 1: half-open peers are found

Record = Mapping[str, Value]


class Channel:
    """A channel of the controller.

    Parameters
    ----------
    config
        Its config file.
    taken
        Gets every whole record.
    closed
        Is called when the client is gone.
    """

    def __init__(self, config: Config, taken: Callable[[Record], None], closed: Callable[[], None]) -> None:
        self.config, self.faults = config, ChannelFaults()
        self.fifos = Fifos(config)
        self.client: _Client | None = None
        self.refused = self.broken = 0  # clients that came second; connections closed for what they sent
        self.last_error = ""
        self._taken, self._closed = taken, closed
        self._write = Writer(config.send)
        self.open = True  # while the controller is starting, nobody is let in

    @property
    def alive(self) -> bool:
        """Whether a client is connected: the flag ALIVE."""
        return self.client is not None

    def new_client(self) -> _Client:
        """Return the protocol of a connection that is coming in."""
        return _Client(self)

    def send(self, values: Record) -> None:
        """Send a document to the client, if there is one."""
        if self.client is not None:
            self.client.send(self._write(values))

    def close(self) -> None:
        """Close the connection."""
        if self.client is not None:
            self.client.close()

    def take_in(self, documents: Sequence[Record]) -> bool:
        """Store documents and let the program take what is whole; False if a queue overflowed."""
        stored = all(self.fifos.store(document) for document in documents)
        if self.faults.overflow:  # the program takes nothing until the connection has ended
            self.faults.overflow = stored
            return stored
        while (record := self.fifos.take()) is not None:
            self._taken(record)
        return stored

    def leave(self, client: _Client) -> None:
        """The client is gone: ALIVE falls, and the program clears and opens the channel again."""
        if self.client is client:
            self.client = None
            self.fifos.clear()
            self._closed()


class _Client(asyncio.Protocol):
    """One connection."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._splitter = Splitter(channel.config)
        self._transport: asyncio.Transport | None = None
        self._held: list[bytes] = []
        self._pieces: list[bytes] = []
        self._stalled = False
        self._waiting = b""  # what came while stalled, at most one read

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        channel = self._channel
        if channel.client is not None or not channel.open:
            channel.refused += 1
            self._transport.abort()
            self._transport = None
            return
        channel.client = self
        sock = self._transport.get_extra_info("socket")
        if sock is not None:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            for name, value in KEEPALIVE.items():
                if hasattr(socket, name):
                    sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None
        self._channel.leave(self)

    def eof_received(self) -> bool:
        return False  # a client that has closed its side is gone

    def data_received(self, data: bytes) -> None:
        faults = self._channel.faults
        if self._transport is None:
            return
        if faults.stall and not self._stalled:
            seconds, faults.stall = faults.stall, 0.0
            self._stalled, self._waiting = True, data
            self._transport.pause_reading()
            asyncio.get_running_loop().call_later(seconds, self._go_on)
            return
        drop = faults.drop_received is not None and len(data) >= faults.drop_received
        if drop:
            data = data[: faults.drop_received]
            faults.drop_received = None
        elif faults.drop_received is not None:
            faults.drop_received -= len(data)
        try:
            kept = self._channel.take_in(self._splitter.feed(data))
        except DocumentError as error:
            self._channel.take_in(error.whole)
            self._broken(str(error))
        else:
            if not kept:
                self._broken("a queue overflowed")
            elif drop:
                self.close()

    def _go_on(self) -> None:
        """The stall is over."""
        data, self._waiting, self._stalled = self._waiting, b"", False
        if self._transport is not None and not self._transport.is_closing():
            self._transport.resume_reading()
            self.data_received(data)

    def _broken(self, why: str) -> None:
        self._channel.broken += 1
        self._channel.last_error = why
        self.close()

    def close(self) -> None:
        if self._transport is not None:
            self._transport.abort()
            self._transport = None
            self._channel.leave(self)

    def send(self, document: bytes) -> None:
        faults = self._channel.faults
        if faults.padding:
            document = (b"\0\r\n" * faults.padding)[: faults.padding] + document
        if not faults.coalesce:
            self._out(document)
            return
        self._held.append(document)
        if len(self._held) >= faults.coalesce:
            self._flush()
        elif len(self._held) == 1:
            asyncio.get_running_loop().call_later(COALESCE_S, self._flush)

    def _flush(self) -> None:
        held, self._held = b"".join(self._held), []
        if held:
            self._out(held)

    def _out(self, data: bytes) -> None:
        transport, faults = self._transport, self._channel.faults
        if transport is None or transport.is_closing():
            return
        if faults.drop_sent is not None:
            if len(data) >= faults.drop_sent:
                transport.write(data[: faults.drop_sent])
                faults.drop_sent = None
                transport.close()  # what was sent arrives
                self._transport = None
                self._channel.leave(self)
                return
            faults.drop_sent -= len(data)
        if self._pieces or 0 < faults.split < len(data):
            size = faults.split or len(data)
            if not self._pieces:
                asyncio.get_running_loop().call_soon(self._next_piece)
            self._pieces += [data[begin : begin + size] for begin in range(0, len(data), size)]
            waiting = sum(map(len, self._pieces))
        else:
            transport.write(data)
            waiting = 0
        if transport.get_write_buffer_size() + waiting > UNREAD_BYTES:
            self._broken("answers are not read")

    def _next_piece(self) -> None:
        if self._transport is None or not self._pieces:
            self._pieces.clear()
            return
        self._transport.write(self._pieces.pop(0))
        if self._pieces:
            asyncio.get_running_loop().call_later(SPLIT_S, self._next_piece)
