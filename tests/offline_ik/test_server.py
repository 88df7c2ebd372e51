"""The server on a socket: many clients, bounded lines and queues, and answers between any amount of rubbish."""

from __future__ import annotations

import asyncio
import json

import numpy as np
import pytest
from server_clients import ask, connected, serving, until
from server_lines import GOOD, rubbish

from offline_ik.errors import DetectorError
from offline_ik.exchange.address import is_loopback, parse_address
from offline_ik.inverse.detector import Detector
from offline_ik.server.server import LINE_BYTES, Limits, Server


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
