"""The Tango device, driven by a client in a process of its own that does what contrast's source does."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from free_ports import free_port
from memory_link import MemoryLink
from peers import Peer, peer, side
from serving_thread import Serving

from offline_ik.inverse.detector import Detector

pytest.importorskip("tango")
START = [20.0, 11.0, 800.0]


@pytest.fixture(scope="module")
def link() -> MemoryLink:
    return MemoryLink(seconds=0.3, residual=1e-5)


@pytest.fixture(scope="module")
def serving(detector: Detector, link: MemoryLink) -> Iterator[Serving]:
    with Serving(detector, link) as found:
        yield found


@pytest.fixture(scope="module")
def contrast(serving: Serving) -> Iterator[Peer]:
    listen = f"127.0.0.1:{free_port()}"
    with (
        side("tango_device", "clampid/robot", "--server", serving.address, "--listen", listen) as at,
        peer("contrast_client.py", at) as client,
    ):
        assert at == f"tango://{listen}/clampid/robot/detector#dbase=no"
        yield client


@pytest.fixture(autouse=True)
def at_the_start(contrast: Peer, link: MemoryLink) -> None:
    link.seconds = 0.3
    assert contrast.ask("wait")["ok"] == "ON"
    assert contrast.ask(f"write {' '.join(map(str, START))}")
    assert contrast.ask("wait")["ok"] == "ON"


def test_a_move_is_moving_when_the_write_returns_and_ends_on(contrast: Peer, link: MemoryLink) -> None:
    sent = len(link.sent)
    assert contrast.ask("move 0 22.5")["ok"] == {"again": 0, "state": "MOVING"}
    assert contrast.ask("wait")["ok"] == "ON"
    assert contrast.ask("read position")["ok"] == pytest.approx([22.5, 11.0, 800.0], abs=1e-12)
    assert len(link.sent) == sent + 1


def test_moves_of_one_axis_leave_the_others_where_they_were_asked_to_be(contrast: Peer, link: MemoryLink) -> None:
    """The robot misses every end; were its measured position given back, delta would creep."""
    for k in range(3):
        assert contrast.ask(f"move 0 {21 + 0.1 * k}")["ok"]["again"] == 0
        contrast.ask("wait")
        gamma, delta, radius = contrast.ask("read position")["ok"]
        assert (gamma, delta, radius) == (pytest.approx(21 + 0.1 * k, abs=1e-12), 11.0, 800.0)
        measured = contrast.ask("read measured")["ok"]
        assert 1e-6 < abs(measured[1] - delta) < 0.01
    there = link.sent[-1][-1]
    contrast.ask("move 1 11.0")  # what is there already
    contrast.ask("wait")
    assert np.abs(link.sent[-1][-1] - there).max() < 5e-6  # creeping, it would be the residual of 1e-5


@pytest.mark.parametrize("target", ["20 11 2500", "20 11", "20 -75 400", "3000 11 800"])
def test_a_refusal_stays_on_raises_nothing_and_is_published(contrast: Peer, link: MemoryLink, target: str) -> None:
    sent = len(link.sent)
    assert contrast.ask(f"write {target}")["ok"] == "ON"
    assert contrast.ask("read last_refusal")["ok"]
    assert contrast.ask("read position")["ok"] == pytest.approx(START, abs=1e-12)
    assert len(link.sent) == sent
    assert contrast.ask("write 20.5 11 800")["ok"] == "MOVING"
    assert contrast.ask("read last_refusal")["ok"] == ""


def test_refused_moves_do_not_loop(contrast: Peer) -> None:
    begun = time.monotonic()
    assert contrast.ask("move 2 2500")["ok"] == {"again": 0, "state": "ON"}
    assert time.monotonic() - begun < 5


def test_stop_ends_a_motion_and_the_position_is_where_it_stands(contrast: Peer, link: MemoryLink) -> None:
    link.seconds = 30.0
    assert contrast.ask("move 0 40")["ok"]["state"] == "MOVING"
    time.sleep(0.3)
    assert contrast.ask("Stop") == {"ok": "None"}
    assert contrast.ask("wait")["ok"] == "ON"
    position = contrast.ask("read position")["ok"]
    assert abs(position[0] - 40) > 10
    assert position == contrast.ask("read measured")["ok"]
    assert contrast.ask("Status")["ok"] == "The robot stands.\nThe last motion: stopped"


def test_what_is_no_number_is_refused_by_tango_itself(contrast: Peer, link: MemoryLink) -> None:
    sent = len(link.sent)
    assert "NaN" in contrast.ask("write 20 11 nan")["failed"]
    assert len(link.sent) == sent


def test_init_and_connect_move_nothing(contrast: Peer, link: MemoryLink) -> None:
    sent, stopped = len(link.sent), len(link.stopped)
    assert contrast.ask("Init") == {"ok": "None"}
    assert contrast.ask("Connect") == {"ok": "None"}
    assert (len(link.sent), len(link.stopped)) == (sent, stopped)


def test_what_else_is_reported(contrast: Peer, serving: Serving, link: MemoryLink) -> None:
    link.seconds = 2.0
    with serving.client("alignment") as other:
        assert other.ask(f"move gamma={math.radians(25)!r} delta=0.2 r=0.8")["moving"]
        assert contrast.ask("read holder")["ok"].startswith("alignment (127.0.0.1:")
        assert contrast.ask("State")["ok"] == "MOVING"
        assert contrast.ask("write 20 11 800")["ok"] == "MOVING"  # by the other; this one is refused
        assert "moves for alignment" in contrast.ask("read last_refusal")["ok"]
        assert "held by alignment" in contrast.ask("Status")["ok"]
        other.ask("moved")
    gamma, delta, radius = contrast.ask("read uncertainty")["ok"]
    assert 1e-5 < gamma < 0.1
    assert 1e-5 < delta < 0.1
    assert 1e-3 < radius < 5
    assert len(contrast.ask("read joints")["ok"]) == 6
    assert len(contrast.ask("read flange")["ok"]) == 6


def test_without_its_server_it_is_in_fault_and_moves_once_it_is_back(detector: Detector, tmp_path: Path) -> None:
    port, link = free_port(), MemoryLink()
    with (
        side("tango_device", "a/b", "--server", f"127.0.0.1:{port}", "--listen", f"127.0.0.1:{free_port()}") as at,
        peer("contrast_client.py", at) as client,
    ):
        assert client.ask("State")["ok"] == "FAULT"
        assert "cannot be reached" in client.ask("read position")["failed"]
        client.send("write 20 11 800")
        assert client.hear()["ok"] == "FAULT"  # raised nothing: it would be tried again when nobody is looking
        assert "cannot be reached" in client.ask("read last_refusal")["ok"]
        assert not link.sent


@pytest.mark.parametrize("lock", ["token", "closed"])
def test_one_that_a_network_reaches_moves_only_with_the_token(lock: str, detector: Detector) -> None:
    link, listen = MemoryLink(), f"127.0.0.1:{free_port()}"
    with (
        Serving(detector, link, token="secret-7") as serving,
        side("tango_device", "a/b", "--server", serving.address, "--listen", listen, "--lock", lock) as at,
        peer("contrast_client.py", at) as client,
    ):
        assert client.ask("write 20 11 800")["ok"] == "ON"
        assert client.ask("read last_refusal")["ok"].startswith("locked: a network reaches this side")
        assert "failed" in client.ask("Unlock other")
        assert client.ask("write 20 11 800")["ok"] == "ON"
        assert not link.sent
        opened = client.ask("Unlock secret-7")
        assert ("ok" in opened) is (lock == "token")
        client.ask("write 20 11 800")
        assert len(link.sent) == (lock == "token")
        assert client.ask("Stop") == {"ok": "None"}
