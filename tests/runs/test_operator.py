"""The virtual operator's answer: one line, bounded in length and time; anything else stops the run in a sentence."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from experiments.runs import people
from experiments.runs.errors import RunStopped
from experiments.runs.people import VirtualOperator, Yes

Answer = Callable[[socket.socket], None]


@contextlib.contextmanager
def operator(answer: Answer) -> Iterator[VirtualOperator]:
    """Somebody who listens and answers in a way of his own."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            peer, _ = server.accept()
            with peer, contextlib.suppress(OSError):
                peer.recv(1024)
                answer(peer)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield VirtualOperator(f"127.0.0.1:{server.getsockname()[1]}", Yes(lambda _: None))
        thread.join(10)
        assert not thread.is_alive()


def flood(peer: socket.socket) -> None:
    for _ in range(10_000):
        peer.sendall(b"x" * 65536)


def drip(peer: socket.socket) -> None:
    for _ in range(300):
        peer.sendall(b" ")
        time.sleep(0.02)


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (flood, "at most 65536 bytes"),
        (drip, "does not answer: timed out|no whole line"),
        (lambda peer: None, "it hung up"),
        (lambda peer: peer.sendall(b"[" * 50_000 + b"\n"), "does not answer"),
        (lambda peer: peer.sendall(b"[1]\n"), "expected a JSON object"),
        (lambda peer: peer.sendall(b"\xff\xfe\n"), "does not answer"),
        (lambda peer: peer.sendall(b'{"error": "' + b"n" * 60_000 + b'"}\n'), "cannot clamp: nnn"),
    ],
)
def test_what_is_no_answer_stops_the_run_in_a_sentence(
    answer: Answer, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(people, "PATIENCE", 0.5)
    begun = time.monotonic()
    with operator(answer) as found, pytest.raises(RunStopped, match=says) as raised:
        found.clamp("here")
    assert time.monotonic() - begun < 8
    assert len(str(raised.value)) < 500


def test_an_answer_in_pieces_is_taken() -> None:
    def pieces(peer: socket.socket) -> None:
        for part in (b'{"ok"', b": true}", b"\n"):
            peer.sendall(part)
            time.sleep(0.02)

    with operator(pieces) as found:
        found.clamp("here")
