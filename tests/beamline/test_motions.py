"""Motions over the line protocol: who holds the robot, when a motion has ended and where, and `stop` from anyone."""

from __future__ import annotations

import socket
import struct
import threading
import time

import numpy as np
import pytest
from memory_link import START, MemoryLink
from serving_thread import Serving

from clampid.verbs.errors import CallError
from offline_ik.exchange.requests import WORDS
from offline_ik.inverse.detector import Detector

MOVE = "move gamma=0.35 delta=0.2 r=0.8"


def until_moving(link: MemoryLink) -> None:
    limit = time.monotonic() + 10
    while not link.state()["moving"]:
        assert time.monotonic() < limit
        time.sleep(0.002)


def test_a_move_that_waits_tells_where_it_ended(serving: Serving, link: MemoryLink, detector: Detector) -> None:
    link.residual = 1e-5
    with serving.client("scan") as scan:
        begun = time.monotonic()
        told = scan.ask(MOVE + " wait=yes id=1")
        assert time.monotonic() - begun >= link.seconds
        assert told["moving"] is False
        assert told["ended"] == {"number": 1, "outcome": "arrived", "reason": ""}
        at = told["at"]
        there = detector.locate(0.35, 0.2, 0.8, near=START, direction="moved").solutions[0].q
        assert np.allclose(at["q_rad"], there + 1e-5, atol=1e-9)
        # What was measured is not what was accepted; what was accepted comes back as it was asked for.
        assert 1e-7 < abs(at["gamma_rad"] - 0.35) < 1e-4
        seen = scan.ask("robot")
        assert seen["setpoint"]["gamma_rad"] == 0.35
        assert seen["setpoint"]["r_m"] == 0.8
        assert seen["holder"] is None


def test_a_second_client_learns_who_moves_the_robot(serving: Serving, link: MemoryLink) -> None:
    link.seconds = 1.0
    with serving.client("alignment") as one, serving.client("scan") as other, serving.client(hello=False) as person:
        assert one.ask(MOVE)["moving"] is True
        told = other.ask("move gamma=0.2 delta=0.2 r=0.8")
        assert "moves for alignment (127.0.0.1:" in told["error"]
        holder = person.ask("robot")["holder"]
        assert (holder["name"], holder["moves"], holder["keeps"]) == ("alignment", True, False)
        assert person.ask("state")["holder"]["name"] == "alignment"
        assert person.ask("robot")["last_refusal"] == told["error"]
        assert other.ask("moved")["moving"] is False
        assert other.ask("move gamma=0.36 delta=0.2 r=0.8")["moving"] is True
        assert len(link.sent) == 2


def test_hold_keeps_it_between_motions_until_the_connection_ends(serving: Serving, link: MemoryLink) -> None:
    with serving.client("other") as other:
        with serving.client("scan") as scan:
            assert scan.ask("hold")["holder"]["keeps"] is True
            assert "scan" in other.ask("hold")["error"]
            assert "scan (127.0.0.1:" in other.ask(MOVE)["error"]
            assert scan.ask(MOVE + " wait=yes")["ended"]["outcome"] == "arrived"
        limit = time.monotonic() + 10
        while other.ask("robot")["holder"] and time.monotonic() < limit:
            time.sleep(0.01)
        assert other.ask(MOVE)["ok"]
        assert other.ask("hold")["ok"]
        assert other.ask("release")["holder"] is None or link.state()["moving"]


@pytest.mark.parametrize("where", ["same connection", "without hello"])
def test_stop_is_carried_out_within_10_ms(where: str, serving: Serving, link: MemoryLink) -> None:
    link.seconds = 20.0
    took = []
    with serving.client("scan") as scan, serving.client(hello=False) as other:
        for _ in range(9):
            scan.send(MOVE + " wait=yes")
            until_moving(link)
            time.sleep(0.02)
            told = time.perf_counter()
            if where == "same connection":
                scan.send("stop")
            else:
                other.send("stop")
            moved = scan.hear()
            assert moved["ended"]["outcome"] == "stopped"
            assert (scan if where == "same connection" else other).hear()["do"] == "stop"
            took.append(link.stopped[-1] - told)
        assert link.state()["moving"] is False
    assert np.median(took) < 0.01  # one of nine may be late: other tests run beside this one


def test_stop_does_not_wait_for_a_link_that_waits_for_its_controller(serving: Serving, link: MemoryLink) -> None:
    link.slow, link.seconds = 0.5, 20.0
    with serving.client() as one, serving.client(hello=False) as other:
        one.send(MOVE)
        limit = time.monotonic() + 10
        while not link.called and time.monotonic() < limit:
            time.sleep(0.001)
        told = time.perf_counter()
        assert other.ask("stop")["ok"]
        assert link.stopped[0] - told < 0.2
        assert other.ask("where gamma=0.3 delta=0.2 r=0.8")["reachable"]  # others are answered meanwhile
        assert "stopped as this motion began" in one.hear()["error"]
        assert len(link.stopped) == 2  # once more, in case the controller heard of the stop first
        assert not link.state()["moving"]


def test_a_stop_that_waits_for_nothing_needs_no_thread(
    serving: Serving, link: MemoryLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    link.stops_at_once, link.seconds, called = True, 30.0, []
    stop = link.stop
    monkeypatch.setattr(link, "stop", lambda: (called.append(threading.current_thread()), stop()))
    with serving.client() as mover, serving.client(hello=False) as other:
        assert mover.ask(MOVE)["moving"]
        told = other.ask("stop")
        assert told["link"]["moving"] is False
        assert told["at"]["q_rad"] == pytest.approx(link.posture().tolist())
        assert {"X_mm", "C_deg"} <= told["at"]["detector"].keys()
        assert called == [serving._thread]
        assert mover.ask("moved")["ended"]["outcome"] == "stopped"

        def lost() -> None:
            raise CallError("the controller could not be told")

        monkeypatch.setattr(link, "stop", lost)
        assert other.ask("stop") == {"ok": False, "error": "the controller could not be told"}


def test_a_move_that_a_stop_overtakes_does_not_begin(serving: Serving, link: MemoryLink) -> None:
    with serving.client() as one:
        one.send("\n".join(["simulate gamma=0.3 delta=0.2 r=0.8", MOVE + " id=a", MOVE + " id=b", "stop", "state"]))
        found = [one.hear() for _ in range(5)]
        assert [f.get("do") for f in found] == ["simulate", None, None, "stop", "state"]
        assert [f.get("id") for f in found[1:3]] == ["a", "b"]
        assert all("a stop came after it" in f["error"] for f in found[1:3])
        assert not link.sent


@pytest.mark.parametrize("line", [b"STOP\n", b"stop now!\n", b"stop robot=another id=a\n", b"stop \xe9\n", b"stop"])
def test_a_stop_in_a_hurry_is_obeyed(line: bytes, serving: Serving, link: MemoryLink) -> None:
    link.seconds = 30.0
    with serving.client("mover") as mover, serving.client(hello=False) as other:
        assert mover.ask("move gamma=0.35 delta=0.2 r=0.8")["moving"]
        other.socket.sendall(line)
        other.socket.shutdown(socket.SHUT_WR)
        assert other.hear()["do"] == "stop"
        assert len(link.stopped) == 1
        assert mover.ask("moved timeout=5")["ended"]["outcome"] == "stopped"


def test_a_word_that_begins_like_stop_is_none(serving: Serving, link: MemoryLink) -> None:
    with serving.client() as client:
        assert "no request is called 'stopwatch'" in client.ask("stopwatch")["error"]
    assert not link.stopped


def test_after_a_stop_the_setpoint_is_where_the_robot_stands(serving: Serving, link: MemoryLink) -> None:
    link.seconds = 2.0
    with serving.client() as one:
        assert one.ask(MOVE)["moving"]
        time.sleep(0.2)
        assert one.ask("stop")["ok"]
        seen = one.ask("robot")
        assert seen["ended"]["outcome"] == "stopped"
        assert seen["setpoint"]["gamma_rad"] == pytest.approx(seen["at"]["gamma_rad"], abs=1e-12)
        link.put(link.posture() + 2e-4)  # it settles: what was told stays
        assert one.ask("robot")["setpoint"] == seen["setpoint"]
        link.put(link.posture() + 0.05)  # moved by hand: what was told is over
        assert abs(one.ask("robot")["setpoint"]["gamma_rad"] - seen["setpoint"]["gamma_rad"]) > 1e-3


def test_a_motion_that_fails_or_falls_silent_is_reported(serving: Serving, link: MemoryLink) -> None:
    with serving.client() as one:
        link.failed = "axis 3: following error"
        assert one.ask(MOVE + " wait=yes")["ended"] == {
            "number": 1, "outcome": "failed", "reason": "axis 3: following error",
        }  # fmt: skip
        link.failed, link.seconds = "", 5.0
        one.send("move gamma=0.3 delta=0.2 r=0.8 wait=yes")
        until_moving(link)
        link.age = 3.0
        told = one.hear()
        assert told["ended"]["outcome"] == "unknown"
        assert "3.0 s" in told["ended"]["reason"]
        link.stop()
        assert "has not heard from the robot" in one.ask(MOVE)["error"]
        link.age, link.refuses = 0.0, "the drives are off"
        assert "the drives are off" in one.ask(MOVE)["error"]
        seen = one.ask("robot")
        assert (seen["ended"]["outcome"], seen["holder"]) == ("not begun", None)


def test_a_connection_that_breaks_while_it_waits_ends_no_motion(serving: Serving, link: MemoryLink) -> None:
    link.seconds = 1.0
    with serving.client() as one:
        one.send(MOVE + " wait=yes")
        until_moving(link)
    with serving.client() as other:
        assert other.ask("robot")["moving"] is True
        told = other.ask("moved timeout=0.01")
        assert told["moving"] is True
        assert other.ask("moved")["ended"]["outcome"] == "arrived"
    assert len(link.sent) == 1


def test_a_client_that_has_closed_its_side_moves_nothing(serving: Serving, link: MemoryLink) -> None:
    with serving.client("gone") as gone:
        gone.socket.send(MOVE.encode() + b"\n", socket.MSG_MORE)  # in one segment with the end
        gone.socket.shutdown(socket.SHUT_WR)
        assert "the connection was closed before the move was checked; nothing moves" in gone.hear()["error"]
    gone = serving.client("reset")
    gone.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    gone.socket.send(MOVE.encode() + b"\n", socket.MSG_MORE)
    gone.close()
    with serving.client() as other:
        assert not other.ask("moved timeout=5")["moving"]
        assert other.ask("robot")["number"] == 0
    assert not link.sent


def test_hello_says_that_a_link_only_reads(serving: Serving, link: MemoryLink) -> None:
    link.executes = False
    with serving.client(hello=False) as client:
        told = client.ask("hello")
    assert (told["linked"], told["moves"]) == (True, False)


def test_a_server_that_a_network_reaches_without_a_token_moves_nothing(detector: Detector, link: MemoryLink) -> None:
    with Serving(detector, link, answers_only=True) as serving, serving.client() as one:
        assert one.ask("hello")["moves"] is False
        for line in (MOVE, "hold", "temperature link=45,45,45,45,45,45"):
            assert "only answers" in one.ask(line)["error"]
        assert one.ask("where gamma=0.3 delta=0.2 r=0.8")["reachable"]
        assert one.ask("simulate gamma=0.3 delta=0.2 r=0.8")["would_move"]
        assert one.ask("stop")["ok"]
        assert not link.sent


@pytest.mark.parametrize("word", ["moved", "robot", "hold", "release", "stop", "move gamma=0.3 delta=0.2 r=0.8"])
def test_without_a_robot_it_is_said(word: str, detector: Detector) -> None:
    assert word.split(maxsplit=1)[0] in WORDS
    with Serving(detector, None) as serving, serving.client() as one:
        assert "no robot is linked" in one.ask(word)["error"]
        assert "timeout" not in one.ask("moved timeout=1")["error"]


@pytest.mark.parametrize("timeout", ["-1", "nan", "1e9", "soon"])
def test_a_timeout_that_is_none_is_refused(timeout: str, serving: Serving) -> None:
    with serving.client() as one:
        assert "timeout: expected" in one.ask(f"moved timeout={timeout}")["error"]


def test_a_person_confirms_what_the_link_asks(
    serving: Serving, link: MemoryLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    with serving.client("person") as person, serving.client(hello=False) as stranger:
        assert person.ask("confirm")["error"] == "confirm: this link never asks"
        confirmed: list[bool] = []
        monkeypatch.setattr(link, "confirm", lambda: confirmed.append(True), raising=False)
        assert "hello" in stranger.ask("confirm")["error"]
        assert not confirmed
        assert person.ask("confirm")["ok"] is True
        assert confirmed == [True]
        link.seconds = 1.0
        assert person.ask(MOVE)["moving"] is True
        assert "the robot moves" in person.ask("confirm")["error"]
        person.ask("stop")
