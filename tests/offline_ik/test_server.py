"""The server on a socket: many clients, bounded lines and queues, and answers between any amount of rubbish."""

from __future__ import annotations

import asyncio
import json
import math
import socket
import struct
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any

import numpy as np
import pytest
from server_lines import GOOD, rubbish

from kinematics.collision.moves import LongCheckError
from offline_ik.collision.safety import PathReport, check_path
from offline_ik.errors import DetectorError
from offline_ik.exchange.address import is_loopback, parse_address
from offline_ik.inverse.detector import Detector
from offline_ik.server.protocol import Speaker
from offline_ik.server.server import LINE_BYTES, Limits, Server

Talk = Callable[[Server, str, int], Awaitable[Any]]


def serving(detector: Detector, talk: Talk, limits: Limits | None = None) -> Any:
    async def run() -> Any:
        server = Server(Speaker(detector), limits)
        host, port = await server.start("127.0.0.1", 0)
        try:
            return await asyncio.wait_for(talk(server, host, port), 120)
        finally:
            await server.close()

    return asyncio.run(run())


@asynccontextmanager
async def connected(
    host: str, port: int, hello: bool = False
) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    """A client that leaves nothing open behind it."""
    reader, writer = await asyncio.open_connection(host, port, limit=1 << 20)
    try:
        if hello:
            assert (await ask(reader, writer, b"hello"))["ok"]
        yield reader, writer
    finally:
        writer.transport.abort()
        with suppress(ConnectionError):
            await writer.wait_closed()


async def until(holds: Callable[[], Any]) -> None:
    """Let the loop turn until a condition holds, which it is to do soon."""
    async with asyncio.timeout(20):
        while not holds():
            await asyncio.sleep(0.002)


async def ask(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, line: bytes) -> dict[str, Any]:
    writer.write(line + b"\n")
    answer: dict[str, Any] = json.loads(await reader.readline())
    return answer


def test_many_clients_each_get_their_own_answers_in_order(detector: Detector) -> None:
    async def one(host: str, port: int, k: int) -> None:
        async with connected(host, port) as (reader, writer):
            for i in range(20):
                writer.write(GOOD + f" id={k}-{i}\n".encode())
            for i in range(20):
                found = json.loads(await reader.readline())
                assert found["id"] == f"{k}-{i}"
                assert found["ok"]

    async def talk(server: Server, host: str, port: int) -> None:
        await asyncio.gather(*(one(host, port, k) for k in range(30)))
        assert server.speaker.answered == 600

    serving(detector, talk)


def test_rubbish_is_answered_and_every_good_request_between_is(detector: Detector) -> None:
    rng = np.random.default_rng(0)

    async def talk(server: Server, host: str, port: int) -> int:
        async with connected(host, port) as (reader, writer):
            reading = asyncio.create_task(good_ones(reader))
            for k in range(3000):
                writer.write((GOOD if k % 10 == 0 else rubbish(rng)) + b"\n")
                if k % 100 == 0:
                    await writer.drain()
            writer.write_eof()
            return await reading

    async def good_ones(reader: asyncio.StreamReader) -> int:
        good = 0
        while line := await reader.readline():
            good += json.loads(line)["ok"]
        return good

    assert serving(detector, talk) == 300


def test_a_search_for_the_nearest_position_gives_way_to_others(detector: Detector) -> None:
    async def talk(server: Server, host: str, port: int) -> None:
        async with connected(host, port) as (reader, writer), connected(host, port) as other:
            assert (await ask(*other, GOOD))["ok"]
            writer.write(b"where gamma=0.3 delta=0.2 r=3.0 id=far\n" + GOOD + b" id=after\n")
            far = asyncio.create_task(reader.readline())
            await asyncio.sleep(0)
            for _ in range(3):
                assert (await ask(*other, GOOD))["reachable"]
            assert not far.done()
            writer.write_eof()
            told = json.loads(await far)
            assert told["id"] == "far"
            assert not told["reachable"]
            assert told["nearest"]["distance_m"] > 0.1
            assert json.loads(await reader.readline())["id"] == "after"
            assert not await reader.readline()

    serving(detector, talk)


FROM = b" from=0.1,-1.2,1.2,0.1,0.4,0"
PATH = GOOD.replace(b"where", b"path") + FROM


class Held:
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
    held = Held(monkeypatch)

    async def talk(server: Server, host: str, port: int) -> None:
        async with connected(host, port) as (reader, writer), connected(host, port) as other:
            writer.write(
                PATH + b" id=1\n" + GOOD + b" id=2\n" + b"y=1 id=3\n" + PATH + b" branch=all id=4\n" + GOOD + b"\n"
            )
            await held.until_begun()
            for _ in range(50):
                assert (await ask(*other, GOOD))["reachable"]
            assert not (await ask(*other, b"nothing"))["ok"]
            assert server.speaker.answered == 50
            held.go.set()
            writer.write_eof()
            answers = [json.loads(line) for line in [await reader.readline() for _ in range(5)]]
            assert [a.get("id") for a in answers] == ["1", "2", None, "4", None]
            assert [a["ok"] for a in answers] == [True, True, False, True, True]
            assert answers[0]["path"]["safe"]
            assert all("path" in s for s in answers[3]["solutions"])
            assert not await reader.readline()

    serving(detector, talk)


class Link:
    """A linked robot that remembers where it was sent."""

    def __init__(self, q: np.ndarray) -> None:
        self.q, self.sent = q, 0

    def posture(self) -> np.ndarray:
        return self.q

    def move(self, postures: np.ndarray, speed: float) -> None:
        self.sent += 1

    def state(self) -> dict[str, Any]:
        return {}

    def stop(self) -> None:
        pass


@pytest.mark.parametrize("what", ["nothing", "stop", "moved", "closed", "reset"])
def test_what_happens_while_a_move_is_checked_counts(
    detector: Detector, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    held, link = Held(monkeypatch), Link(detector.locate(0.3, 0.2, 0.8).solutions[0].q)

    async def talk(server: Server, host: str, port: int) -> None:
        server.speaker.link = link
        async with connected(host, port, hello=True) as (reader, writer), connected(host, port) as other:
            writer.write(b"move gamma=0.35 delta=0.2 r=0.8\n")
            await held.until_begun()
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
            held.go.set()
            if what in ("closed", "reset"):
                assert (await ask(*other, PATH))["path"]["safe"]  # is computed after the move
                assert (server.speaker.answered, server.speaker.refused) == (2, 1 if what == "closed" else 0)
                assert not server.failures
            else:
                answer = json.loads(await reader.readline())
                assert answer["ok"] is (what == "nothing")
                told = {"stop": "was stopped while", "moved": "moved while"}
                assert told.get(what, "") in answer.get("error", "")
            assert link.sent == (what == "nothing")

    serving(detector, talk)


def test_of_two_moves_at_once_one_is_made(detector: Detector, monkeypatch: pytest.MonkeyPatch) -> None:
    held, link = Held(monkeypatch), Link(detector.locate(0.3, 0.2, 0.8).solutions[0].q)

    async def talk(server: Server, host: str, port: int) -> None:
        server.speaker.link = link
        async with connected(host, port, hello=True) as one, connected(host, port, hello=True) as other:
            one[1].write(b"move gamma=0.35 delta=0.2 r=0.8\n")
            await held.until_begun()
            other[1].write(b"move gamma=0.25 delta=0.2 r=0.8\n")  # from where the robot still stands
            await until(lambda: all(client.job for client in server.clients))
            held.go.set()
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


def test_a_line_that_the_end_of_its_connection_cuts_off_is_refused(detector: Detector) -> None:
    async def talk(server: Server, host: str, port: int) -> None:
        async with connected(host, port) as (reader, writer):
            writer.write(GOOD + b"\n" + GOOD)  # may have been r=0.85
            writer.write_eof()
            whole, cut = json.loads(await reader.readline()), json.loads(await reader.readline())
            assert whole["reachable"]
            assert "expected a newline" in cut["error"]
            assert "q_rad" not in json.dumps(cut)
            assert not await reader.readline()

    serving(detector, talk)


def test_what_is_computed_apart_is_at_the_temperatures_of_now(detector: Detector) -> None:
    async def talk(server: Server, host: str, port: int) -> None:
        async with connected(host, port, hello=True) as one:
            before = (await ask(*one, GOOD))["solutions"][0]["q_rad"]
            assert (await ask(*one, b"temperature link=45,45,45,45,45,45"))["ok"]
            at_once = (await ask(*one, GOOD))["solutions"][0]["q_rad"]
            apart = (await ask(*one, GOOD + b" branch=all"))["solutions"][0]["q_rad"]
            assert np.abs(np.subtract(at_once, before)).max() > 1e-6
            assert np.abs(np.subtract(apart, at_once)).max() < 1e-8

    serving(detector, talk)


def test_a_line_in_pieces_is_one_line_and_an_oversized_one_is_one_error(detector: Detector) -> None:
    async def talk(server: Server, host: str, port: int) -> None:
        async with connected(host, port) as (reader, writer):
            for piece in (GOOD[:5], GOOD[5:20], GOOD[20:] + b"\nstate"):
                writer.write(piece)
                await writer.drain()
                await asyncio.sleep(0.01)
            assert json.loads(await reader.readline())["do"] == "where"
            writer.write(b"\n")
            assert json.loads(await reader.readline())["do"] == "state"
            for _ in range(40):
                writer.write(b"y" * LINE_BYTES)
                await writer.drain()
            writer.write(b"\nhelp\n")
            assert "at most" in json.loads(await reader.readline())["error"]
            assert json.loads(await reader.readline())["do"] == "help"

    serving(detector, talk)


def test_a_slow_line_is_ended_and_others_go_on(detector: Detector) -> None:
    async def talk(server: Server, host: str, port: int) -> None:
        async with connected(host, port) as (slow_reader, slow), connected(host, port) as other:
            slow.write(b"where gam")
            assert (await ask(*other, GOOD))["ok"]
            assert "not completed" in json.loads(await slow_reader.readline())["error"]
            assert await slow_reader.readline() == b""
            assert (await ask(*other, GOOD))["ok"]

    serving(detector, talk, Limits(patience=0.2))


def test_patience_is_with_a_line_and_not_with_a_connection(detector: Detector) -> None:
    async def talk(server: Server, host: str, port: int) -> None:
        async with connected(host, port) as (reader, writer):
            writer.write(GOOD[:9])
            for _ in range(12):  # every piece ends within a line, for three times as long as a line may take
                await asyncio.sleep(0.25)
                writer.write(GOOD[9:] + b"\n" + GOOD[:9])
            for _ in range(12):
                assert json.loads(await reader.readline())["ok"]

    serving(detector, talk, Limits(patience=1.0))


def test_one_client_too_many_is_refused(detector: Detector) -> None:
    async def talk(server: Server, host: str, port: int) -> None:
        async with connected(host, port) as first:
            assert (await ask(*first, GOOD))["ok"]
            async with connected(host, port) as (reader, _):
                assert "too many clients" in json.loads(await reader.readline())["error"]
            assert (await ask(*first, GOOD))["ok"]

    serving(detector, talk, Limits(clients=1))


def test_a_client_that_does_not_read_is_not_read_either(detector: Detector) -> None:
    async def talk(server: Server, host: str, port: int) -> None:
        async with connected(host, port) as (_, writer), connected(host, port) as other:
            for _ in range(2000):
                writer.write(b"state\n" * 50)
                await asyncio.sleep(0)
            await until(lambda: any(not client.writable for client in server.clients))
            client = next(client for client in server.clients if not client.writable)
            assert (await ask(*other, GOOD))["ok"]
            assert client.transport is not None
            assert not client.transport.is_reading()
            assert client.transport.get_write_buffer_size() < 1 << 20
            assert sum(map(len, client.lines)) < 1 << 20
            assert server.speaker.answered < 50_000  # of 100 000: those that the sockets' own buffers took

    serving(detector, talk)


def test_an_error_of_the_program_is_one_answer(detector: Detector, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> bytes:
        raise ZeroDivisionError("broken")

    async def talk(server: Server, host: str, port: int) -> None:
        async with connected(host, port) as (reader, writer):
            with monkeypatch.context() as patched:
                patched.setattr(server.speaker, "begin", broken)
                assert "internal error" in (await ask(reader, writer, GOOD))["error"]
            assert (await ask(reader, writer, GOOD))["ok"]
            assert server.failures == 1

    serving(detector, talk)


@pytest.mark.parametrize("text", ["", "7310", "host:", "host:port", "host:70000", ":7310"])
def test_an_address_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(DetectorError, match="HOST:PORT"):
        parse_address(text)


def test_addresses() -> None:
    assert parse_address("127.0.0.1:0") == ("127.0.0.1", 0)
    assert parse_address("[::1]:7310") == ("::1", 7310)
    assert is_loopback("localhost")
    assert is_loopback("127.8.0.1")
    assert not is_loopback("0.0.0.0")
