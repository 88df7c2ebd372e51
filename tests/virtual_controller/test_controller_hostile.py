"""Messages that nobody honest sends, to every listener: no crash, no motion, no growth."""

from __future__ import annotations

import contextlib
import random
import socket
import struct
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from controller_client import HOME, STEP, Process, angles, move, process, same_place

FEW_MESSAGES = 1000
NAMES = ("listening", "state", "tracker", "operator", "varproxy")
GROWTH = 30.0  # MB
ASK = b"<Ask><Sequence>1</Sequence><Kind>0</Kind><From>0</From></Ask>"
WORDS = (
    b"estopp",
    b"mode T9",
    b"measure 99999999",
    b"speed nan",
    b"speed 1e9",
    b"fault x=1",
    b"sight lost -1",
    b"\xff\xfe",
    b"",
)


def laughs(root: bytes) -> bytes:
    """Entities that would expand to a gigabyte."""
    entities = b"".join(b'<!ENTITY a%d "%s">' % (k, b"&a%d;" % (k - 1) * 10) for k in range(1, 10))
    return b'<!DOCTYPE x [<!ENTITY a0 "ha">' + entities + b"]><" + root + b">&a9;</" + root + b">"


def hostile(rng: random.Random, good: bytes, root: bytes) -> bytes:
    """One bad message, from a good one of the same listener."""
    cut, at = rng.randrange(len(good)), rng.randrange(len(good))
    makers: tuple[Callable[[], bytes], ...] = (
        lambda: good[:cut],
        lambda: good[:at] + bytes([rng.randrange(256)]) + good[at + 1 :][:cut],
        lambda: good[:cut] + good[:at],
        lambda: rng.randbytes(rng.randrange(1, 200)),
        lambda: b"<" + root + b">" + b"<a>" * rng.randrange(1, 3000),
        lambda: b"<" + root + b" a='" + b"x" * rng.randrange(1, 40000),
        lambda: laughs(root),
        lambda: b"<?xml version='1.0' encoding='utf-16'?>" + good,
        lambda: rng.choice(WORDS) + b"\n",
        lambda: b"x" * rng.randrange(1000, 5000) + b"\n",
        lambda: struct.pack(
            ">HHBH", rng.randrange(65536), rng.randrange(65536), rng.randrange(256), rng.randrange(65536)
        ),
        lambda: struct.pack(">HHBH", 1, 9, 1, 4) + b"$OV_" * rng.randrange(1, 5),
        lambda: good.replace(b">1<", b">-1<").replace(b">7<", b">%d<" % rng.randrange(-(2**40), 2**40)),
        lambda: b"\0" * rng.randrange(1, 3000),
    )
    return rng.choice(makers)()


def send_many(robot: Process, name: str, count: int, seed: int) -> int:
    """Send messages to a listener, several to a connection; how many were sent."""
    rng = random.Random(seed)
    good, root = {
        "listening": (move(7, 7, [HOME + STEP, HOME])[0], b"Move"),  # one point of two, for a boot that will not come
        "state": (ASK, b"Ask"),
    }.get(name, (b"measure 1 T1\n" if name == "tracker" else b"state\n", b"x"))
    sent = 0
    while sent < count:
        with contextlib.suppress(OSError), socket.create_connection(robot.at[name], 5) as sock:
            sock.settimeout(0.02)
            for _ in range(rng.randrange(1, 12)):
                sock.sendall(hostile(rng, good, root))
                sent += 1
            if rng.random() < 0.3:
                sock.recv(1000)
    return sent


def bombard(robot: Process, count: int) -> None:
    robot.ask()
    robot.lost_state()
    still, memory = angles(robot.ask()), 0.0
    robot.lost_state()
    for number, name in enumerate(NAMES):
        send_many(robot, name, count // 20, 100 + number)  # what is made once is made now
    memory = robot.memory()
    for number, name in enumerate(NAMES):
        begin = time.monotonic()
        sent = send_many(robot, name, count, number)
        print(f"{name}: {sent} messages in {time.monotonic() - begin:.1f} s, {robot.memory() - memory:+.1f} MB")
        assert sent >= count
        assert robot.process.poll() is None
    half_open = [socket.create_connection(robot.at[name]) for name in NAMES for _ in range(40)]
    for sock in half_open:
        with contextlib.suppress(OSError):
            sock.sendall(b"<Move><Boot>1</Bo"[: random.Random(1).randrange(1, 15)])
    time.sleep(0.3)
    assert robot.line("operator", "state")["accepted"] == 0  # a person is heard all the same
    for sock in half_open:
        sock.close()
    time.sleep(0.3)
    state = robot.ask()
    assert (state["State.Boot"], state["State.Accepted"], state["State.Mode"]) == (1, 0, 4)
    assert same_place(angles(state), still, readings=2)
    assert robot.memory() - memory < GROWTH
    assert robot.descriptors() < 40
    assert [e["event"] for e in robot.events() if e["event"] not in ("started", 4)] == []
    assert robot.run(1, [HOME]) == [1, 2, 3]


def test_hostile_messages_to_every_listener(tmp_path: Path) -> None:
    with process("--speed", "100", truth=tmp_path / "t.json", wants=("operator", "tracker", "varproxy")) as robot:
        bombard(robot, FEW_MESSAGES)


@pytest.mark.parametrize(
    "count", [pytest.param(20_000, marks=pytest.mark.slow), pytest.param(100_000, marks=pytest.mark.study)]
)
def test_many_hostile_messages_to_every_listener(count: int, tmp_path: Path) -> None:
    with process("--speed", "100", truth=tmp_path / "t.json", wants=("operator", "tracker", "varproxy")) as robot:
        bombard(robot, count)


def test_slow_sender_keeps_nobody_else_waiting(tmp_path: Path) -> None:
    with process("--speed", "100", truth=tmp_path / "t.json", wants=("operator",)) as robot:
        robot.ask()
        with robot.motion() as slow:
            for byte in move(1, 1, [HOME])[0][:60]:
                slow.send(bytes([byte]))
                begin = time.monotonic()
                robot.ask()
                assert time.monotonic() - begin < 1.0
        used = robot.cpu()
        time.sleep(2.0)
        assert robot.cpu() - used < 0.1  # standing costs nothing


def test_of_another_protocol_no_later_line_is_obeyed() -> None:
    begun = [b"POST / HTTP/1.1\r\nHost: a\r\n\r\n", b"EHLO a\r\n", b"\r\n", b"\xff\xfe\n"]
    with process("--speed", "100", wants=("operator", "tracker")) as robot:
        for name, first in ((name, first) for name in ("operator", "tracker") for first in begun):
            got = b""
            with socket.create_connection(robot.at[name], 10) as sock, contextlib.suppress(ConnectionError):
                sock.sendall(first + b"estop\nmeasure 1\n")
                while more := sock.recv(4096):
                    got += more
            assert got.count(b"\n") <= 1, (name, first)
            assert not robot.line("operator", "state")["estop"], (name, first)
