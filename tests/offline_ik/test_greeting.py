"""Who may command the server: no web page, and nobody who has not said hello, with the token where there is one."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from server_clients import Link, ask, connected, serving, until
from server_lines import GOOD

from offline_ik.errors import DetectorError
from offline_ik.exchange.requests import WORDS
from offline_ik.inverse.detector import Detector
from offline_ik.server.client import KEEPALIVE, Limits
from offline_ik.server.protocol import Session, Speaker
from offline_ik.server.server import Server
from offline_ik.verbs.serve import _token

ODD = ["free", "all", "1,2,3,4,5,6", "1e400"]
WARM = b"temperature link=45,45,45,45,45,45"
POST = (
    b"POST / HTTP/1.1\r\nHost: 127.0.0.1:7310\r\nContent-Type: text/plain\r\n\r\n"
    b"\nhello\n" + WARM + b"\nmove gamma=0.35 delta=0.2 r=0.8\n"
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "sent",
    [
        POST,
        POST.replace(b"POST /", b"FETCH /"),
        b"GET / HTTP/1.1\r\nUpgrade: websocket\r\n\r\n",
        b"POST /" + b"x" * 10,
        GOOD + b"\n" + POST,
        b"\x16\x03\x01\x02\x00\x01",
    ],
)
@pytest.mark.parametrize("pieces", [1, 7])
def test_what_looks_like_http_is_hung_up_on_and_changes_nothing(sent: bytes, pieces: int, detector: Detector) -> None:
    link = Link(detector.locate(0.3, 0.2, 0.8).solutions[0].q)

    async def talk(server: Server, host: str, port: int) -> None:
        server.speaker.link, before = link, server.speaker.detector
        async with connected(host, port) as (reader, writer):
            size = -(-len(sent) // pieces)
            for k in range(0, len(sent), size):
                writer.write(sent[k : k + size])
                await asyncio.sleep(0.005)
            got = b""
            with contextlib.suppress(ConnectionError):
                got = await asyncio.wait_for(reader.read(), 10)
            assert b"hello" not in got
            assert b"moving" not in got
        await until(lambda: not server.clients)
        assert server.speaker.detector is before
        assert not link.sent
        async with connected(host, port) as other:
            assert (await ask(*other, GOOD))["ok"]

    serving(detector, talk)


FOREIGN = [
    b"EHLO mail.example\r\n",
    b"*1\r\n$4\r\nPING\r\n",
    b"PING\r\n",
    b"USER anonymous\r\n",
    b"SSH-2.0-OpenSSH_9.6\r\n",
    b"\r\n",
    b"\x00\x01\xff\n",
    b"x" * 5000,
    b"SELECT 1;\n",
]
"""How other protocols begin: SMTP, Redis, FTP, SSH, and what is none."""


@pytest.mark.parametrize("begun", FOREIGN)
@pytest.mark.parametrize("together", [True, False])
def test_of_another_protocol_no_later_line_is_obeyed(begun: bytes, together: bool, detector: Detector) -> None:
    link = Link(detector.locate(0.3, 0.2, 0.8).solutions[0].q)
    rest = b"\nhello\n" + WARM + b"\nmove gamma=0.35 delta=0.2 r=0.8\n"

    async def talk(server: Server, host: str, port: int) -> None:
        server.speaker.link, before = link, server.speaker.detector
        async with connected(host, port) as (reader, writer):
            got = b""
            with contextlib.suppress(ConnectionError):
                writer.write(begun + rest if together else begun)
                if not together:
                    await asyncio.sleep(0.05)
                    writer.write(rest)
                got = await asyncio.wait_for(reader.read(), 10)
            assert got.count(b"\n") <= 1
            assert not got or not json.loads(got)["ok"]
        await until(lambda: not server.clients)
        assert server.speaker.detector is before
        assert not link.sent
        async with connected(host, port) as other:
            assert (await ask(*other, GOOD))["ok"]
            assert not (await ask(*other, b"wher gamma=0.3"))["ok"]  # a slip of one who has spoken it
            assert (await ask(*other, GOOD))["ok"]

    serving(detector, talk)


@pytest.mark.parametrize(
    "line", [WARM, b"move gamma=0.35 delta=0.2 r=0.8", b"start q=0,0,0,0,0,0", b"stream gamma=0.3 delta=0.2 r=0.8"]
)
@pytest.mark.parametrize("token", [None, "secret-7"])
def test_what_changes_something_needs_hello(line: bytes, token: str | None, detector: Detector) -> None:
    speaker, session = Speaker(detector, token=token), Session()

    def say(text: bytes) -> dict[str, Any]:
        return dict(json.loads(speaker.answer(text, session)))

    assert f"{line.split()[0].decode()}: expected hello" in say(line)["error"]
    assert say(GOOD)["ok"]
    assert say(b"hello" if token is None else b"hello token=secret-7")["ok"]
    assert "expected hello" not in say(line).get("error", "")


@pytest.mark.parametrize("given", ["hello", "hello token=other", "hello token=secret-77", "hello token=secret"])
def test_a_wrong_token_is_refused_once(given: str, detector: Detector) -> None:
    speaker, session = Speaker(detector, token="secret-7"), Session()
    answer = json.loads(speaker.answer(given.encode(), session))
    assert not answer["ok"]
    assert "secret-7" not in json.dumps(answer)
    assert session.done
    assert not session.greeted


def test_stop_needs_no_greeting(detector: Detector) -> None:
    link = Link(detector.locate(0.3, 0.2, 0.8).solutions[0].q)
    assert json.loads(Speaker(detector, link, token="secret-7").answer(b"stop", Session()))["ok"]


class Out:
    """Collects warnings."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def warn(self, text: str) -> None:
        self.said.append(text)


def test_the_token_of_a_file(tmp_path: Path) -> None:
    file, out = tmp_path / "token", Out()
    file.write_text(" secret-7\n")
    file.chmod(0o600)
    assert _token(file, out) == "secret-7"  # type: ignore[arg-type]
    assert not out.said
    file.chmod(0o644)
    _token(file, out)  # type: ignore[arg-type]
    assert "chmod 600" in out.said[0]
    for wrong in (b"", b"two words", b"x" * 257, b"\xff\xfe", b"caf\xc3\xa9"):
        file.write_bytes(wrong)
        with pytest.raises(DetectorError, match="printable ASCII"):
            _token(file, out)  # type: ignore[arg-type]
    for place in (tmp_path / "none", tmp_path, Path("/dev/zero")):
        with pytest.raises(DetectorError, match="--token-file"):
            _token(place, out)  # type: ignore[arg-type]


def test_stop_is_heard_when_all_places_are_taken(detector: Detector) -> None:
    link = Link(detector.locate(0.3, 0.2, 0.8).solutions[0].q)

    async def talk(server: Server, host: str, port: int) -> None:
        server.speaker.link = link
        async with connected(host, port) as first, connected(host, port) as (reader, writer):
            assert (await ask(*first, GOOD))["ok"]
            assert "only stop is answered" in json.loads(await reader.readline())["error"]
            assert (await ask(reader, writer, b"stop"))["do"] == "stop"
            writer.write(GOOD + b"\n")
            assert await reader.read() == b""
            async with connected(host, port) as third, connected(host, port) as fourth:
                assert "only stop" in json.loads(await third[0].readline())["error"]
                assert "too many" in json.loads(await third[0].readline())["error"]  # the later one has its place
                assert await third[0].read() == b""
                assert "only stop" in json.loads(await fourth[0].readline())["error"]
                assert (await ask(*fourth, b"stop"))["do"] == "stop"

    serving(detector, talk, Limits(clients=1, reserved=1))


def test_idle_connections_end_and_busy_ones_do_not(detector: Detector) -> None:
    async def talk(server: Server, host: str, port: int) -> None:
        async with connected(host, port) as silent, connected(host, port) as quiet:
            assert (await ask(*quiet, GOOD))["ok"]
            assert "no line for 0.2 s" in json.loads(await silent[0].readline())["error"]
            assert await silent[0].read() == b""
            for _ in range(4):
                await asyncio.sleep(0.2)
                assert (await ask(*quiet, GOOD))["ok"]
            assert "no line for 0.5 s" in json.loads(await quiet[0].readline())["error"]
            assert await quiet[0].read() == b""

    serving(detector, talk, Limits(silent=0.2, idle=0.5))


def test_the_system_looks_whether_a_peer_is_still_there(detector: Detector) -> None:
    async def talk(server: Server, host: str, port: int) -> None:
        async with connected(host, port) as one:
            assert (await ask(*one, GOOD))["ok"]
            (client,) = server.clients
            assert client.transport is not None
            found = client.transport.get_extra_info("socket")
            assert found.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
            for name, value in KEEPALIVE:
                if hasattr(socket, name):
                    assert found.getsockopt(socket.IPPROTO_TCP, getattr(socket, name)) == value

    serving(detector, talk)


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_line_has_one_answer_and_changes_nothing_without_hello(data: st.DataObject, detector: Detector) -> None:
    link = Link(detector.locate(0.3, 0.2, 0.8).solutions[0].q)
    speaker = Speaker(detector, link)
    word = st.sampled_from([*WORDS, "", "HELLO", "nothing"]).filter(lambda w: w not in ("hello", "stop"))
    value = st.one_of(
        st.floats().map(repr), st.text(max_size=20), st.sampled_from(["free", "all", "1,2,3,4,5,6", "1e400"])
    )
    pair = st.tuples(st.sampled_from([k for keys in WORDS.values() for k in keys] or ["q"]), value).map("=".join)
    written = st.tuples(word, st.lists(pair, max_size=5)).map(
        lambda w: " ".join([w[0], *w[1]]).encode("utf-8", "replace")
    )
    line = data.draw(st.one_of(st.binary(max_size=200), written))
    answer = json.loads(speaker.answer(line.split(b"\n")[0], Session()))
    assert answer["ok"] in (True, False)
    assert answer["ok"] or answer["error"]
    assert speaker.detector is detector
    assert not link.sent
