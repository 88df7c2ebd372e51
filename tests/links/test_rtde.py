"""The RTDE link against a controller of the test's own; an unmodified fake controller was tried by hand."""

from __future__ import annotations

import contextlib
import os
import random
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from experiments.links.address import LinkAddress
from experiments.links.protocol import CannotError, Link, LinkError, LinkLostError, Program
from experiments.links.rtde import RtdeLink, connect

TYPES = {
    "timestamp": "DOUBLE", "actual_q": "VECTOR6D", "actual_current": "VECTOR6D", "joint_temperatures": "VECTOR6D",
    "robot_mode": "INT32", "safety_mode": "INT32",
}  # fmt: skip


def package(kind: bytes, payload: bytes = b"") -> bytes:
    return struct.pack(">HB", 3 + len(payload), kind[0]) + payload


def data(clock: float, a1: float = 0.5, mode: int = 7, safety: int = 1) -> bytes:
    numbers = [clock, a1, *[-1.0] * 5, *[0.25] * 6, *[31.0] * 6]
    return package(b"U", struct.pack(">B19dii", 1, *numbers, mode, safety))


class Controller:
    """Answers what a controller answers, and sends what `sends` gives, byte by byte where it is `slow`."""

    def __init__(self) -> None:
        self.listening = socket.create_server(("127.0.0.1", 0))
        self.port = self.listening.getsockname()[1]
        self.heard: list[tuple[bytes, bytes]] = []
        self.sends: Callable[[int], bytes] = lambda k: data(0.008 * k)
        self.refuses, self.connections, self.silent, self.slow = b"", 0, False, False
        self.closing = False
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()

    def run(self) -> None:
        while not self.closing:
            try:
                client, _ = self.listening.accept()
            except OSError:
                return
            self.connections += 1
            with client, contextlib.suppress(OSError, struct.error):  # hung up on
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self.converse(client)

    def converse(self, client: socket.socket) -> None:
        for _ in range(4):
            size, kind = struct.unpack(">HB", client.recv(3, socket.MSG_WAITALL))
            asked = client.recv(size - 3, socket.MSG_WAITALL) if size > 3 else b""
            self.heard.append((bytes([kind]), asked))
            answer = {
                b"V": b"\1", b"v": struct.pack(">4I", 5, 11, 0, 0), b"S": b"\1",
                b"O": b"\1" + ",".join(TYPES.get(n, "NOT_FOUND") for n in asked[8:].decode().split(",")).encode(),
            }[bytes([kind])]  # fmt: skip
            if bytes([kind]) == self.refuses:
                answer = b"\0" + answer[1:].replace(b"DOUBLE", b"NOT_FOUND")
            out = package(b"M", b"\5hello\0\0") + package(bytes([kind]), answer)
            for k in range(len(out)):
                client.sendall(out[k : k + 1])
        k = 0
        while not self.closing:
            if not self.silent:
                out, k = self.sends(k), k + 1
                for at in range(0, len(out), 50 if self.slow else len(out)):
                    client.sendall(out[at : at + (50 if self.slow else len(out))])
            time.sleep(0.002)

    def close(self) -> None:
        self.closing = True
        with contextlib.suppress(OSError):
            self.listening.shutdown(socket.SHUT_RDWR)
        self.listening.close()
        self.thread.join(5)


@pytest.fixture
def controller() -> Iterator[Controller]:
    found = Controller()
    yield found
    found.close()


@pytest.fixture
def link(controller: Controller) -> Iterator[RtdeLink]:
    found = connect(LinkAddress("rtde", "127.0.0.1", controller.port))
    yield found
    found.close()


def until(holds: Callable[[], object]) -> None:
    end = time.monotonic() + 10.0
    while not holds():
        assert time.monotonic() < end, "it never came to be"
        time.sleep(0.002)


def test_it_reads_and_moves_nothing(controller: Controller, link: RtdeLink) -> None:
    assert isinstance(link, Link)
    assert [kind for kind, _ in controller.heard] == [b"V", b"v", b"O", b"S"]
    assert controller.heard[2][1][:8] == struct.pack(">d", 125.0)
    until(lambda: link.status().moves is False)
    status = link.status()
    np.testing.assert_array_equal(status.joints, [0.5, -1.0, -1.0, -1.0, -1.0, -1.0])
    np.testing.assert_array_equal(status.current, [0.25] * 6)
    np.testing.assert_array_equal(status.temperature, [31.0] * 6)
    assert (status.drives, status.brakes_open, status.estop, status.torque) == (True, True, False, None)
    assert status.age < 1.0
    for call in (link.stop, link.release, lambda: link.execute(Program(np.zeros(6), 0.1)), lambda: link.recording(1)):
        with pytest.raises(CannotError):
            call()
    controller.sends = lambda k: data(1000 + 0.008 * k, 0.5 + 0.01 * k, mode=5, safety=7)
    until(lambda: link.status().moves and link.status().estop and not link.status().drives)


def test_packages_in_any_pieces_and_a_break(controller: Controller, link: RtdeLink) -> None:
    controller.slow = True
    clock = link.status().clock
    until(lambda: link.status().clock != clock)
    controller.sends = lambda k: package(b"U", b"\1short")  # ends the connection
    until(lambda: "expected" in link.trouble)
    controller.sends = lambda k: data(5000 + 0.008 * k)
    until(lambda: link.status().clock > 5000 and not link.trouble)
    assert controller.connections > 1


def test_silence_and_a_clock_that_stands_make_it_old(controller: Controller, link: RtdeLink) -> None:
    controller.sends = lambda k: data(77.0)
    until(lambda: link.status().clock == 77.0)
    until(lambda: link.status().age > 0.5)
    assert not link.trouble  # it sends, and nothing new
    controller.silent = True
    until(lambda: link.trouble)


@pytest.mark.parametrize("refuses", [b"V", b"O", b"S"])
def test_a_controller_that_does_not_agree_is_said(
    refuses: bytes, controller: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("experiments.links.rtde.FIRST_STATUS_TIMEOUT", 0.7)
    controller.refuses = refuses
    with pytest.raises(LinkLostError, match="RTDE: "):
        connect(LinkAddress("rtde", "127.0.0.1", controller.port))


def test_a_rate_that_is_none_is_refused() -> None:
    with pytest.raises(LinkError, match="rate: expected 10 or 125 or 500"):
        connect(LinkAddress("rtde", "127.0.0.1", 9, {"rate": "1000"}))


@pytest.mark.parametrize(
    "count", [300, pytest.param(20_000, marks=pytest.mark.slow), pytest.param(100_000, marks=pytest.mark.study)]
)
def test_spoilt_packages_are_errors_and_nothing_else(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each to the reader of a connection: errors of the link's own kinds, or statuses of finite numbers."""
    from experiments.links import rtde

    rng, errors, good = random.Random(5), 0, 0
    for k in range(count):
        spoilt = bytearray(data(0.008 * k))
        for _ in range(rng.randrange(1, 4)):
            spoilt[rng.randrange(len(spoilt))] = rng.randrange(256)
        if k % 3 == 0:
            del spoilt[rng.randrange(len(spoilt)) :]
        ours, theirs = socket.socketpair()
        with ours, theirs:
            theirs.sendall(bytes(spoilt) + data(1.0))
            theirs.shutdown(socket.SHUT_WR)
            try:
                for kind, payload in rtde._packages(ours, threading.Event()):
                    if kind == b"U" and len(payload) == rtde.DATA.size:
                        assert np.isfinite(rtde._status_of(payload).joints).all()
                        good += 1
            except (OSError, ValueError):
                errors += 1
    assert errors == count  # the end of the connection, at the latest
    assert good > count / 10


@pytest.mark.skipif("RTDE_CONTROLLER" not in os.environ, reason="needs a fake controller of somebody else's: its file")
def test_an_unmodified_fake_controller() -> None:
    """Of JaneliaSciComp/janelia-unity-toolkit: org.janelia.ur/fake-rtde-controller.py."""
    import subprocess
    import sys

    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [sys.executable, os.environ["RTDE_CONTROLLER"], "--sine", "--port", str(port), "--count", "1000"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as peer:
        link = connect(LinkAddress("rtde", "127.0.0.1", port))
        try:
            until(lambda: (link.status().clock or 0) > 50)
            status = link.status()
            at = 30.0 * np.sin(np.arange(1, 7) * 0.01 * float(status.clock or 0))
            np.testing.assert_allclose(status.joints, at, atol=1e-12)
            np.testing.assert_array_equal(status.current, [status.clock] * 6)
        finally:
            link.close()
            peer.kill()
