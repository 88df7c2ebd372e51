"""The RSI listener: gaps by the clock, hostile datagrams, and the unmodified rsipi as the controller."""

from __future__ import annotations

import random
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from test_splitter import spoilt

from experiments.links.address import LinkAddress
from experiments.links.protocol import CannotError, Link, LinkLostError
from experiments.links.rsi import RsiLink, connect
from experiments.links.rsi_config import rsi_config_text


def datagram(ipoc: int, a1: float = 1.0, delay: int = 0) -> bytes:
    axes = f'A1="{a1}" A2="-90.0" A3="90.0" A4="0.0" A5="0.0" A6="0.0"'
    gear = "".join(f' A{k}="{10.0 * k}"' for k in range(1, 7))
    return (
        f'<Rob Type="KUKA"><AIPos {axes}/><ASPos {axes}/><MACur {axes}/><Gear{gear}/>'
        f'<Delay D="{delay}"/><IPOC>{ipoc}</IPOC></Rob>'
    ).encode()


@pytest.fixture
def listener() -> RsiLink:
    found = RsiLink("127.0.0.1", 0)
    yield found
    found.close()


def test_a_cycle_is_read_whole(listener: RsiLink) -> None:
    assert isinstance(listener, Link)
    with pytest.raises(LinkLostError):
        listener.status()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
        robot.sendto(datagram(4208163634, 45.0, 3), ("127.0.0.1", listener.port))
        end = time.monotonic() + 5.0
        while not listener.cycles():
            assert time.monotonic() < end
            time.sleep(0.001)
    (cycle,) = listener.cycles()
    assert (cycle.ipoc, cycle.delay) == (4208163634, 3)
    np.testing.assert_allclose(cycle.gear_torque, 10.0 * np.arange(1, 7))
    assert listener.status().joints[0] == pytest.approx(np.radians(45.0))
    assert listener.status().age < 5.0
    sides = {s.name: s.side for s in listener.capabilities.signals}
    assert sides["torque"] == "gear"
    with pytest.raises(CannotError, match="listens only"):
        listener.stop()


def test_gaps_late_and_foreign_datagrams_are_counted(listener: RsiLink) -> None:
    for ipoc in (1000, 1004, 1016, 1012, 1016, 1020):
        listener.take(datagram(ipoc), "10.0.0.1")
    listener.take(datagram(1024), "10.0.0.2")
    counts = listener.counts
    assert (counts.received, counts.late, counts.foreign, counts.missing) == (6, 2, 1, 2)
    assert list(counts.gaps) == [(1008, 1012)]
    found = listener.recording(252)
    assert list(found.number) == [254, 255]
    assert listener.recording(1).lost == (1, 249)


def test_a_stream_that_begins_anew_is_taken_up(listener: RsiLink) -> None:
    listener.take(datagram(5_000_000), "a")
    listener.take(datagram(100), "a")
    assert [c.ipoc for c in listener.cycles()] == [100]


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\0" * 4096,
        datagram(4)[:-1],
        datagram(4) + datagram(8),
        datagram(4) + b"<Rob",
        datagram(4).replace(b"IPOC", b"IPOK"),
        datagram(4).replace(b">4<", b">-4<"),
        datagram(4).replace(b">4<", b">4e3<"),
        datagram(4).replace(b"-90.0", b"nan"),
        datagram(4).replace(b"<AIPos", b"<AIPot"),
        datagram(4).replace(b'D="0"', b'D="x"'),
        b'<!DOCTYPE a [<!ENTITY b "c">]>' + datagram(4),
        b"<a>" * 1000,
    ],
)
def test_what_is_no_cycle_is_counted(listener: RsiLink, data: bytes) -> None:
    listener.take(data, "a")
    assert (listener.counts.malformed, listener.counts.received) == (1, 0)
    listener.take(datagram(8), "b")  # who sent rubbish first does not keep the robot out
    assert listener.counts.received == 1


@pytest.mark.parametrize(
    "count", [2000, pytest.param(20_000, marks=pytest.mark.slow), pytest.param(100_000, marks=pytest.mark.study)]
)
def test_spoilt_datagrams_over_the_socket_keep_no_cycle_out(count: int, listener: RsiLink) -> None:
    rng = random.Random(3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as rude:
        for k in range(count):
            rude.sendto(spoilt(rng, datagram(4 * k))[:60_000], ("127.0.0.1", listener.port))
            counts = listener.counts
            if k % 20 == 0:  # no more than the socket's buffer holds: each is to be read, not dropped by the system
                end = time.monotonic() + 10.0
                while counts.malformed + counts.received + counts.late + counts.foreign < k + 1:
                    assert time.monotonic() < end, counts
                    time.sleep(0.0005)
    assert listener.counts.malformed > count / 2
    assert len(listener.cycles()) <= listener._kept.maxlen
    assert len(listener.counts.gaps) <= 1000


def test_joints_that_turn_are_reported(listener: RsiLink) -> None:
    for k, a1 in enumerate((1.0, 1.1, 1.2, 1.3, 1.3, 1.3, 1.3)):
        listener.take(datagram(1000 + 4 * k, a1), "10.0.0.1")
        if k in (0, 3, 6):
            assert listener.status().moves is {0: None, 3: True, 6: False}[k]


def test_memory_is_bounded(listener: RsiLink) -> None:
    for k in range(listener._kept.maxlen + 50):
        if k % 100 == 0:
            listener.take(datagram(1000 + 4 * k), "a")
    assert len(listener.cycles()) <= listener._kept.maxlen
    assert listener.counts.gaps.maxlen == 1000


PEER = """
import sys, time
from RSIPI.rsi_echo_server import EchoServer
server = EchoServer(sys.argv[1], delay_ms=4)
server.state["AIPos"].update(A1=12.5, A2=-90.0, A6=-3.25)
server.state["Gear"].update(A3=77.5)
server.start()
time.sleep(1.0)
server.ipoc_value += 40  # ten cycles that are never sent
time.sleep(0.5)
server.stop()
print(server.ipoc_value)
"""


def test_the_unmodified_rsipi_as_the_controller_with_the_config_that_is_shipped(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    (tmp_path / "ClampidRSI.xml").write_text(rsi_config_text("127.0.0.1", port), encoding="ascii")
    with subprocess.Popen(
        [sys.executable, "-c", PEER, "ClampidRSI.xml"], cwd=tmp_path, stdout=subprocess.PIPE, text=True
    ) as peer:
        try:
            link = connect(LinkAddress("rsi", "127.0.0.1", port))
        except LinkLostError:
            peer.kill()
            raise
        out, _ = peer.communicate(timeout=60)
        assert peer.returncode == 0
    link.close()
    last = int(out.splitlines()[-1]) - 4
    cycles, counts = link.cycles(), link.counts
    assert cycles[-1].ipoc == last
    np.testing.assert_allclose(np.degrees(cycles[-1].joints), [12.5, -90.0, 0.0, 0.0, 0.0, -3.25], atol=1e-12)
    assert cycles[-1].gear_torque[2] == 77.5
    assert counts.malformed == counts.foreign == counts.late == 0
    assert counts.missing == 10
    assert len(counts.gaps) == 1
    assert len(cycles) == counts.received > 50
    steps = np.diff([c.ipoc for c in cycles])
    assert sorted(set(steps)) == [4, 44]


def test_a_port_that_is_taken_and_a_stream_that_does_not_come(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("experiments.links.rsi.FIRST_DATAGRAM_TIMEOUT", 0.1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(LinkLostError, match="cannot listen"):
            connect(LinkAddress("rsi", "127.0.0.1", taken.getsockname()[1]))
    with pytest.raises(LinkLostError, match="no datagram came"):
        connect(LinkAddress("rsi", "127.0.0.1", free_port()))


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])
