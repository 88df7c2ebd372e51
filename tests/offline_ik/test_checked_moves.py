"""Moves that are checked while others talk: answers stay in order, and what happens meanwhile counts."""

from __future__ import annotations

import json
import math
import socket
import struct
import threading
from typing import Any

import pytest
from server_clients import Link, ask, connected, serving, until
from server_lines import GOOD

from kinematics.collision.moves import LongCheckError
from offline_ik.collision.safety import PathReport, check_path
from offline_ik.inverse.detector import Detector
from offline_ik.server.server import Server

FROM = b" from=0.1,-1.2,1.2,0.1,0.4,0"
PATH = GOOD.replace(b"where", b"path") + FROM


class DelayedChecks:
    """Checks of moves that begin, and do not end before they are let go."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.begun, self.go = threading.Event(), threading.Event()

        def check(detector: Detector, postures: Any, most: float = math.inf) -> PathReport:
            if not most:
                raise LongCheckError
            self.begun.set()
            assert self.go.wait(60)
            return check_path(detector, postures)

        # or a short move would be checked on the loop
        monkeypatch.setattr("offline_ik.motion.simulation.PLACES_AT_ONCE", 0)
        monkeypatch.setattr("offline_ik.motion.ways.check_path", check)
        monkeypatch.setattr("offline_ik.server.protocol.check_path", check)

    async def until_begun(self) -> None:
        await until(self.begun.is_set)


def test_while_a_move_is_checked_others_are_answered_and_its_own_client_in_order(
    detector: Detector, monkeypatch: pytest.MonkeyPatch
) -> None:
    checks = DelayedChecks(monkeypatch)

    async def talk(server: Server, host: str, port: int) -> None:
        async with connected(host, port) as (reader, writer), connected(host, port) as other:
            writer.write(
                PATH + b" id=1\n" + GOOD + b" id=2\n" + b"y=1 id=3\n" + PATH + b" branch=all id=4\n" + GOOD + b"\n"
            )
            await checks.until_begun()
            for _ in range(50):
                assert (await ask(*other, GOOD))["reachable"]
            assert not (await ask(*other, b"nothing"))["ok"]
            assert server.speaker.answered == 50
            checks.go.set()
            writer.write_eof()
            answers = [json.loads(line) for line in [await reader.readline() for _ in range(5)]]
            assert [a.get("id") for a in answers] == ["1", "2", None, "4", None]
            assert [a["ok"] for a in answers] == [True, True, False, True, True]
            assert answers[0]["path"]["safe"]
            assert all("path" in s for s in answers[3]["solutions"])
            assert not await reader.readline()

    serving(detector, talk)


@pytest.mark.parametrize("what", ["nothing", "stop", "moved", "closed", "reset"])
def test_what_happens_while_a_move_is_checked_counts(
    detector: Detector, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    checks, link = DelayedChecks(monkeypatch), Link(detector.locate(0.3, 0.2, 0.8).solutions[0].q)

    async def talk(server: Server, host: str, port: int) -> None:
        server.speaker.link = link
        async with connected(host, port, hello=True) as (reader, writer), connected(host, port) as other:
            writer.write(b"move gamma=0.35 delta=0.2 r=0.8\n")
            await checks.until_begun()
            if what == "stop":
                assert (await ask(*other, b"stop"))["ok"]
            elif what == "moved":
                link.q = link.q + 0.1
            elif what == "closed":  # on the wire no other than a client that still waits for its answer
                writer.close()
                await until(lambda: any(client.session.closed for client in server.clients))
            elif what == "reset":
                sock = writer.get_extra_info("socket")
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                writer.transport.abort()
                await until(lambda: len(server.clients) == 1)
            checks.go.set()
            if what in ("closed", "reset"):
                assert (await ask(*other, PATH))["path"]["safe"]  # is computed after the move
                assert (server.speaker.answered, server.speaker.refused) == (2, 1 if what == "closed" else 0)
                assert not server.failures
            else:
                answer = json.loads(await reader.readline())
                assert answer["ok"] is (what == "nothing")
                refusals = {"stop": "was stopped while", "moved": "moved while"}
                assert refusals.get(what, "") in answer.get("error", "")
            assert link.sent == (what == "nothing")

    serving(detector, talk)


def test_of_two_moves_at_once_one_is_made(detector: Detector, monkeypatch: pytest.MonkeyPatch) -> None:
    checks, link = DelayedChecks(monkeypatch), Link(detector.locate(0.3, 0.2, 0.8).solutions[0].q)

    async def talk(server: Server, host: str, port: int) -> None:
        server.speaker.link = link
        async with connected(host, port, hello=True) as one, connected(host, port, hello=True) as other:
            one[1].write(b"move gamma=0.35 delta=0.2 r=0.8\n")
            await checks.until_begun()
            other[1].write(b"move gamma=0.25 delta=0.2 r=0.8\n")  # from where the robot still stands
            await until(lambda: all(client.job for client in server.clients))
            checks.go.set()
            assert json.loads(await one[0].readline())["moving"] is True
            assert "moved while" in json.loads(await other[0].readline())["error"]
            assert link.sent == 1
            assert (await ask(*other, b"move gamma=0.25 delta=0.2 r=0.8"))["moving"] is True

    serving(detector, talk)


def test_a_client_that_asks_and_closes_its_side_is_answered_but_moves_nothing(detector: Detector) -> None:
    link = Link(detector.locate(0.3, 0.2, 0.8).solutions[0].q)

    async def talk(server: Server, host: str, port: int) -> None:
        server.speaker.link = link
        async with connected(host, port, hello=True) as (reader, writer):
            writer.write(b"move gamma=0.35 delta=0.2 r=0.8\n" + PATH + b"\n" + GOOD + b"\n")
            writer.write_eof()
            answers = [json.loads(line) for line in (await reader.read()).splitlines()]
            assert [a["ok"] for a in answers] == [False, True, True]
            assert "connection was closed" in answers[0]["error"]
            assert not link.sent

    serving(detector, talk)
