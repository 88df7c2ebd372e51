"""Hostile input to each listener: no crash, no motion, bounded memory, and good requests between are answered."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import psutil
import pytest
from free_ports import free_port
from memory_link import MemoryLink
from peers import free_udp_and_tcp, peer
from server_lines import hostile
from serving_thread import Serving

from offline_ik.inverse.detector import Detector
from offline_ik.server.client import Limits

GOOD = b"robot id=good\n"
MANY = [
    pytest.param(20_000, id="many", marks=pytest.mark.slow),
    pytest.param(100_000, id="all", marks=pytest.mark.study),
]


def megabytes(process: int | None = None) -> float:
    return float(psutil.Process(process or os.getpid()).memory_info().rss / 1e6)


@pytest.mark.parametrize("count", [pytest.param(3000, id="some"), *MANY])
def test_hostile_lines_move_nothing(count: int, detector: Detector) -> None:
    """Without hello, and with it: what moves is a good move only, and there is none among these."""
    link, rng = MemoryLink(), np.random.default_rng(0)
    with Serving(detector, link, limits=Limits(patience=1.0)) as serving, contextlib.ExitStack() as stack:
        half_open = [stack.enter_context(socket.create_connection(serving.at)) for _ in range(20)]
        for k, one in enumerate(half_open):
            one.sendall(b"move gamma=0.3 delta=0.2 r=0.8"[: k + 1])  # no end
        before = None
        for greets in (False, True):
            with serving.client(hello=greets) as client:
                client.ask("state")  # one that begins with no request is hung up on
                sent = good = 0
                while sent < count // 2:
                    lines = [GOOD if k == 25 else hostile(rng) + b"\n" for k in range(50)]
                    client.socket.sendall(b"".join(lines))
                    good += sum(b'"id":"good"' in client.lines.readline() for _ in range(50))
                    sent += 50
                assert good == sent // 50
            before = megabytes() if before is None else before
        assert megabytes() - before < 50
        assert not link.sent
        assert not serving.server.failures
        with serving.client() as client:
            assert client.ask("move gamma=0.35 delta=0.2 r=0.8")["moving"]


def knocks(rng: np.random.Generator) -> bytes:
    """What no CORBA and no Channel Access client sends; half of it in frames as they should be."""
    body = bytes(rng.integers(0, 256, rng.integers(1, 400), dtype=np.uint8))
    match rng.integers(9):
        case 0:
            return bytes(rng.integers(0, 256, rng.integers(1, 2000), dtype=np.uint8))
        case 1:  # GIOP with a length that is not there
            size = int(rng.integers(1, 2**31))
            return b"GIOP\x01\x02\x01\x00" + struct.pack("<I", size) + bytes(rng.integers(0, 99))
        case 2:  # GIOP whose frame is right: a message of any kind, and what it says is not
            return b"GIOP\x01" + bytes([rng.integers(3), 1, rng.integers(8)]) + struct.pack("<I", len(body)) + body
        case 3:  # Channel Access: a command with a payload that is not there
            return struct.pack(">HHHHII", int(rng.integers(0, 40)), 65535, 6, 1, 1, 1) + b"\0" * int(
                rng.integers(0, 99)
            )
        case 4:  # Channel Access whose frame is right: any command, to any channel, with any payload
            body += bytes(-len(body) % 8)
            ids = (int(n) for n in rng.integers(0, 2**32, 2))
            kind, what, count = (int(n) for n in rng.integers(0, (30, 40, 9)))
            return struct.pack(">HHHHII", kind, len(body), what, count, *ids) + body
        case 5:  # Channel Access: a payload of four gigabytes, by the long form of the header
            return struct.pack(">HHHHIIII", 4, 65535, 6, 0, 1, 1, 2**32 - 8, 2**31) + body
        case 6:
            return b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"
        case 7:
            return struct.pack(">HHHHII", 0, 0, 0, 13, 0, 0) * int(rng.integers(1, 50))  # versions, and nothing else
        case _:
            return b"move gamma=0.3 delta=0.2 r=0.8\n" * 20


@pytest.fixture(scope="module")
def link() -> MemoryLink:
    return MemoryLink()


@pytest.fixture(scope="module")
def serving(detector: Detector, link: MemoryLink) -> Iterator[Serving]:
    with Serving(detector, link) as found:
        yield found


def knock(port: int, count: int) -> None:
    """So many messages, up to 20 to a connection; 20 connections at a time are left half open."""
    rng, sent = np.random.default_rng(1), 0
    waiting: list[socket.socket] = []
    while sent < count:
        one = socket.create_connection(("127.0.0.1", port), timeout=5)
        waiting.append(one)
        with contextlib.suppress(OSError):  # hung up on is what it may be
            for _ in range(rng.integers(1, 21)):
                one.sendall(knocks(rng))
                sent += 1
        if len(waiting) > 20:
            waiting.pop(0).close()
    for one in waiting:
        one.close()


@pytest.mark.parametrize("count", [pytest.param(300, id="some"), *MANY])
def test_hostile_bytes_to_the_tango_port_move_nothing(count: int, serving: Serving, link: MemoryLink) -> None:
    pytest.importorskip("tango")
    port = free_port()
    with _process("tango_device", "a/b", serving, port) as (process, at), peer("contrast_client.py", at) as client:
        assert client.ask("State")["ok"] == "ON"
        before = megabytes(process)
        begun = time.monotonic()
        knock(port, count)
        assert client.ask("State")["ok"] == "ON"
        print(f"{count} messages in {time.monotonic() - begun:.0f} s, {megabytes(process) - before:+.1f} MB")
        assert megabytes(process) - before < 60
    assert not link.sent


@pytest.mark.parametrize("count", [pytest.param(300, id="some"), *MANY])
def test_hostile_bytes_to_the_epics_port_move_nothing(count: int, serving: Serving, link: MemoryLink) -> None:
    pytest.importorskip("caproto")
    port = free_udp_and_tcp()
    rng = np.random.default_rng(2)
    searching = {"EPICS_CA_ADDR_LIST": f"127.0.0.1:{port}", "EPICS_CA_AUTO_ADDR_LIST": "NO"}
    with (
        _process("epics_records", "X:", serving, port) as (process, _),
        peer("epics_client.py", "X:", **searching) as client,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp,
    ):
        assert client.ask("read gamma.DMOV")["ok"] == [1]
        before = megabytes(process)
        begun = time.monotonic()
        for _ in range(count):
            udp.sendto(knocks(rng)[:1400], ("127.0.0.1", port))
        knock(port, count)
        time.sleep(0.3)
        assert client.ask("read gamma.DMOV")["ok"] == [1]
        print(f"twice {count} messages in {time.monotonic() - begun:.0f} s, {megabytes(process) - before:+.1f} MB")
        assert megabytes(process) - before < 60
    assert not link.sent


def test_a_channel_access_message_of_four_gigabytes_is_hung_up_on(serving: Serving) -> None:
    pytest.importorskip("caproto")
    port = free_udp_and_tcp()
    with _process("epics_records", "X:", serving, port) as (process, _):
        before = megabytes(process)
        with socket.create_connection(("127.0.0.1", port), 5) as rude:
            rude.sendall(struct.pack(">HHHHIIII", 4, 65535, 6, 0, 1, 1, 2**32 - 8, 2**31))
            with pytest.raises(ConnectionError):
                rude.sendall(bytes(100_000_000))
        assert megabytes(process) - before < 10


@contextlib.contextmanager
def _process(module: str, name: str, serving: Serving, port: int) -> Iterator[tuple[int, str]]:
    """A side whose complaints about what it is sent are not shown."""
    command = [sys.executable, "-m", f"offline_ik.beamline.{module}", name, "--server", serving.address]
    with subprocess.Popen(
        [*command, "--listen", f"127.0.0.1:{port}"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    ) as process:  # fmt: skip
        try:
            assert process.stdout is not None
            yield process.pid, process.stdout.readline().split()[-1]
            assert process.poll() is None
        finally:
            process.kill()


@pytest.mark.parametrize("side", ["tango_device", "epics_records"])
def test_hundreds_of_idle_connections_lock_nobody_out(side: str, serving: Serving, link: MemoryLink) -> None:
    tango = side == "tango_device"
    pytest.importorskip("tango" if tango else "caproto")
    port = free_port() if tango else free_udp_and_tcp()
    searching = {} if tango else {"EPICS_CA_ADDR_LIST": f"127.0.0.1:{port}", "EPICS_CA_AUTO_ADDR_LIST": "NO"}
    with _process(side, "a/b" if tango else "X:", serving, port) as (_, at), contextlib.ExitStack() as stack:
        for k in range(400):
            one = stack.enter_context(socket.create_connection(("127.0.0.1", port), 10))
            if k % 2:
                one.sendall(b"GIOP" if tango else b"\0\0")  # half-open: no whole message
        script, given = ("contrast_client.py", at) if tango else ("epics_client.py", "X:")
        with peer(script, given, **searching) as client:
            found = client.ask("State" if tango else "read gamma.DMOV")["ok"]
            assert found == ("ON" if tango else [1])
        before = len(link.stopped)
        with serving.client(hello=False) as line:
            assert line.ask("stop")["ok"]
        assert len(link.stopped) > before


FRAGMENT = b"GIOP\x01\x02\x03\x00" + struct.pack("<I", 24) + struct.pack("<II", 1, 3) + bytes(16)  # more would follow


@pytest.mark.parametrize("sent", [b"GIOP", FRAGMENT], ids=["half a header", "the first of several fragments"])
def test_seven_hundred_half_open_connections_lock_no_tango_client_out(sent: bytes, serving: Serving) -> None:
    """The device's server has a thread for each connection whose message has begun, and 600 were all that it had."""
    pytest.importorskip("tango")
    port = free_port()
    with _process("tango_device", "a/b", serving, port) as (process, at), contextlib.ExitStack() as stack:
        early = stack.enter_context(peer("contrast_client.py", at))
        assert early.ask("State")["ok"] == "ON"
        for _ in range(700):
            stack.enter_context(socket.create_connection(("127.0.0.1", port), 10)).sendall(sent)
        with peer("contrast_client.py", at) as late:
            assert late.ask("State")["ok"] == "ON"
        assert early.ask("State")["ok"] == "ON"
        assert psutil.Process(process).num_threads() < 300
