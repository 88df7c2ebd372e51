"""The door of the Tango side: what reaches the server behind it, and who keeps a place when there are too many."""

from __future__ import annotations

import contextlib
import socket
import socketserver
import struct
import threading
import time
from collections.abc import Iterator

import pytest

from offline_ik.beamline.gate import Bounds, Gate, free_port

WHOLE = b"GIOP\x01\x02\x01\x03" + struct.pack("<I", 4) + b"abcd"


class Behind(socketserver.ThreadingTCPServer):
    """Says back what it hears, and counts who comes."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Echo)
        self.came = 0


class Echo(socketserver.BaseRequestHandler):
    def handle(self) -> None:
        assert isinstance(self.server, Behind)
        self.server.came += 1
        with contextlib.suppress(OSError):
            while data := self.request.recv(4096):
                self.request.sendall(data)


@pytest.fixture
def behind() -> Iterator[Behind]:
    with Behind() as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def opened(behind: Behind, bounds: Bounds) -> int:
    port = free_port()
    Gate("127.0.0.1", port, behind.server_address[1], bounds).open()
    return port


def knock(port: int, data: bytes = b"") -> socket.socket:
    one = socket.create_connection(("127.0.0.1", port), 5)
    one.sendall(data)
    return one


def hung_up(one: socket.socket) -> bool:
    with contextlib.suppress(ConnectionError):
        return one.recv(100) == b""
    return True


def test_whole_messages_pass_in_pieces_or_together(behind: Behind) -> None:
    with knock(opened(behind, Bounds())) as one:
        for piece in (WHOLE[:3], WHOLE[3:14], WHOLE[14:] + WHOLE):
            one.sendall(piece)
            time.sleep(0.02)
        got = b""
        while len(got) < 2 * len(WHOLE):
            got += one.recv(100)
    assert got == 2 * WHOLE


@pytest.mark.parametrize("begun", [b"", b"G", b"GIOP", WHOLE[:12], WHOLE[:-1]])
def test_what_is_no_whole_message_reaches_nobody_and_is_hung_up_on(begun: bytes, behind: Behind) -> None:
    with knock(opened(behind, Bounds(patience=0.2)), begun) as one:
        assert hung_up(one)
    assert not behind.came


def test_a_second_message_that_does_not_end_is_hung_up_on_and_silence_between_messages_is_not(behind: Behind) -> None:
    with knock(opened(behind, Bounds(patience=0.2)), WHOLE) as one:
        assert one.recv(100) == WHOLE
        time.sleep(0.5)
        one.sendall(WHOLE)
        assert one.recv(100) == WHOLE
        one.sendall(WHOLE[:5])
        assert hung_up(one)


@pytest.mark.parametrize(
    "data", [b"GET / HTTP/1.1\r\n\r\n", b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\x00", WHOLE[:8] + b"\xff" * 4]
)
def test_what_is_no_message_of_corba_is_hung_up_on_at_once(data: bytes, behind: Behind) -> None:
    with knock(opened(behind, Bounds(patience=60.0)), data) as one:
        assert hung_up(one)
    assert not behind.came


def test_who_has_said_nothing_whole_gives_place_first(behind: Behind) -> None:
    port = opened(behind, Bounds(connections=4, patience=60.0))
    with contextlib.ExitStack() as stack:
        old = stack.enter_context(knock(port, WHOLE))
        assert old.recv(100) == WHOLE
        silent = [stack.enter_context(knock(port, b"GIOP")) for _ in range(10)]
        new = stack.enter_context(knock(port, WHOLE))
        assert new.recv(100) == WHOLE
        assert all(map(hung_up, silent[:8]))
        old.sendall(WHOLE)
        assert old.recv(100) == WHOLE


def test_among_those_who_spoke_the_longest_silent_gives_place(behind: Behind) -> None:
    port = opened(behind, Bounds(connections=2))
    with contextlib.ExitStack() as stack:
        first, second, third = (stack.enter_context(socket.socket()) for _ in range(3))
        for one in (first, second):
            one.connect(("127.0.0.1", port))
            one.sendall(WHOLE)
            assert one.recv(100) == WHOLE
        first.sendall(WHOLE)
        assert first.recv(100) == WHOLE
        third.connect(("127.0.0.1", port))
        assert hung_up(second)
        first.sendall(WHOLE)
        assert first.recv(100) == WHOLE


def test_a_port_in_use_is_said(behind: Behind) -> None:
    with pytest.raises(OSError, match=r"in use|bind"):
        Gate("127.0.0.1", behind.server_address[1], 1).open()
