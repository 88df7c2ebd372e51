"""One TCP connection that carries documents: no wait longer than the caller allows, no delayed packets."""

from __future__ import annotations

import contextlib
import selectors
import socket
import time
from collections.abc import Mapping

from experiments.links.protocol import LinkLostError
from experiments.links.splitter import Splitter, StreamError

__all__ = ["Backoff", "Connection", "NotSentError", "Wake", "readable"]

# Not select.select where there is another: it ends at file descriptor 1023.
Selector: type[selectors.BaseSelector] = getattr(selectors, "PollSelector", selectors.SelectSelector)
FIRST_WAIT = 0.05  # s before the second attempt
CONNECT = 2.0  # s that a connection may take
BYTES_AT_ONCE = 65536  # bytes that are read at once


class Backoff:
    """Waiting times between attempts, doubled each time, up to 1 s."""

    def __init__(self) -> None:
        self._next = FIRST_WAIT

    def seconds(self) -> float:
        """How long to wait now."""
        now, self._next = self._next, min(2 * self._next, 1.0)
        return now

    def reset(self) -> None:
        """An attempt was good."""
        self._next = FIRST_WAIT


class Wake:
    """Ends a `select` of another thread."""

    def __init__(self) -> None:
        self.reader, self._writer = socket.socketpair()
        self.reader.setblocking(False)
        self._writer.setblocking(False)

    def set(self) -> None:
        """End it."""
        with contextlib.suppress(OSError):
            self._writer.send(b"x")

    def clear(self) -> None:
        """Take notice."""
        with contextlib.suppress(OSError):
            while self.reader.recv(1024):
                pass

    def close(self) -> None:
        """Free both ends."""
        self.reader.close()
        self._writer.close()


def readable(connection: Connection | None, wake: Wake, patience: float) -> bool:
    """Wait until something has come; whether it has. Ended early by the wake, which is cleared.

    Raises
    ------
    LinkLostError
        The connection was closed meanwhile, by another thread.
    """
    with Selector() as selector:
        selector.register(wake.reader, selectors.EVENT_READ)
        if connection is not None:
            try:
                selector.register(connection.fileno(), selectors.EVENT_READ, connection)
            except ValueError:
                raise LinkLostError(f"{connection.name}: closed") from None
        ready = [key.data for key, _ in selector.select(max(patience, 0.0))]
    if None in ready:
        wake.clear()
    return any(data is not None for data in ready)


class Connection:
    """Opens at once.

    Parameters
    ----------
    host, port
        Of the controller.

    Raises
    ------
    LinkLostError
        Nobody listens there, or it is taken by another client.
    """

    def __init__(self, host: str, port: int) -> None:
        self.name = f"{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), CONNECT)
        except (OSError, UnicodeError) as error:
            raise LinkLostError(f"{self.name}: {getattr(error, 'strerror', None) or error}") from None
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._splitter = Splitter()
        self._heard = False

    @property
    def _closed(self) -> str:
        """What is said where the other side has hung up."""
        taken = "" if self._heard else "; another client may have the channel, which takes one"
        return f"{self.name}: the controller closed the connection{taken}"

    def fileno(self) -> int:
        """For `select`; -1 once closed."""
        return self._socket.fileno()

    def send(self, data: bytes, patience: float = 0.0) -> None:
        """Hand all of it to the system.

        Parameters
        ----------
        patience
            How long the other side may leave its buffers full, s; 0: not at all.

        Raises
        ------
        LinkLostError
            It was not taken; ``sent`` of the error says how many bytes had been.
        """
        sent, end = 0, time.monotonic() + patience
        while sent < len(data):
            try:
                sent += self._socket.send(data[sent:])
            except BlockingIOError:
                left = end - time.monotonic()
                if left <= 0 or self.fileno() < 0:
                    raise NotSentError(f"{self.name}: the controller does not read", sent) from None
                with Selector() as selector:
                    selector.register(self._socket, selectors.EVENT_WRITE)
                    selector.select(left)
            except (ConnectionResetError, BrokenPipeError):
                raise NotSentError(self._closed, sent) from None
            except OSError as error:
                raise NotSentError(f"{self.name}: {error.strerror or error}", sent) from None

    def receive(self) -> list[tuple[str, Mapping[str, str]]]:
        """Documents that are whole, without waiting.

        Raises
        ------
        LinkLostError
            The other side has closed, or sends what is no such stream.
        """
        try:
            data = self._socket.recv(BYTES_AT_ONCE)
        except BlockingIOError:
            return []
        except ConnectionResetError:
            data = b""
        except OSError as error:
            raise LinkLostError(f"{self.name}: {error.strerror or error}") from None
        if not data:
            raise LinkLostError(self._closed)
        self._heard = True
        try:
            return self._splitter.feed(data)
        except StreamError as error:
            raise LinkLostError(f"{self.name}: {error}") from None

    def close(self) -> None:
        """Hang up."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


class NotSentError(LinkLostError):
    """With how much of it was sent."""

    def __init__(self, message: str, sent: int) -> None:
        super().__init__(message)
        self.sent = sent
