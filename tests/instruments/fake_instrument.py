"""An instrument on a socket that says what a test wants, in a thread of its own."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import numpy as np

from experiments.instruments import Instrument, connect_instrument

Answer = Callable[[str, int], bytes | None]
"""From a line and its number, counted from 0, to what is sent; None: nothing, the line stays open."""


def points(count: int, *, middle: tuple[float, ...] = (1.0, 2.0, 3.0), drift: float = 0.0, seed: int = 0) -> bytes:
    """Readings around a place with 20 µm of noise, which move by ``drift`` (m) along x in their time."""
    rng = np.random.default_rng(seed)
    found = np.array(middle) + rng.normal(0.0, 2e-5, (count, len(middle)))
    found[:, 0] += drift * np.linspace(0.0, 1.0, count)
    key = "points_m" if len(middle) == 3 else "distances_m"
    return line({"target": "T1", "time_s": 7.25, key: (found if len(middle) == 3 else found[:, 0]).tolist()})


def line(content: object) -> bytes:
    """A line of JSON."""
    return json.dumps(content).encode() + b"\n"


def usual(text: str, _number: int) -> bytes:
    """A healthy instrument with two targets."""
    word, *rest = text.split()
    if word == "targets":
        return line({"targets_m": {"T1": [0, 0, 0], "T2": [0, 0, 0.1]}})
    if word == "temperatures":
        return line({"motor_C": [30.5, 31.0], "ambient_C": 21.25})
    return points(int(rest[0]))


@contextmanager
def serving(answer: Answer, targets: bytes | None = None) -> Iterator[int]:
    """The port of an instrument; ``targets`` is answered as usual or so, the other lines by ``answer``, counted."""
    server = socket.create_server(("127.0.0.1", 0))
    server.settimeout(0.05)
    ended = threading.Event()
    count = [0]

    def talk(client: socket.socket) -> None:
        with client, suppress(OSError):
            client.settimeout(0.05)
            rest = b""
            while not ended.is_set():
                try:
                    data = client.recv(4096)
                except TimeoutError:
                    continue
                if not data:
                    return
                rest += data
                while b"\n" in rest:
                    text, _, rest = rest.partition(b"\n")
                    if text == b"targets":
                        client.sendall(targets or usual("targets", 0))
                        continue
                    said = answer(text.decode(), count[0])
                    count[0] += 1
                    if said == b"HANG UP":
                        return
                    if said is not None:
                        client.sendall(said)

    def accept() -> None:
        while not ended.is_set():
            with suppress(TimeoutError):
                threading.Thread(target=talk, args=(server.accept()[0],), daemon=True).start()

    thread = threading.Thread(target=accept, daemon=True)
    thread.start()
    try:
        yield server.getsockname()[1]
    finally:
        ended.set()
        thread.join()
        server.close()


@contextmanager
def connected(answer: Answer) -> Iterator[Instrument]:
    """A client of an instrument that answers so."""
    with serving(answer) as port:
        instrument = connect_instrument(f"tcp://127.0.0.1:{port}")
        try:
            yield instrument
        finally:
            instrument.close()
