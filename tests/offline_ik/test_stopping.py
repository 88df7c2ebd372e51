"""``clampid serve`` ends when it is asked to, whatever its clients do."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from offline_ik.inverse.detector import Detector
from offline_ik.server.protocol import Speaker
from offline_ik.server.server import Server

CLAMPID = Path(sys.executable).parent / "clampid"


@contextmanager
def served(*args: str | Path) -> Iterator[tuple[subprocess.Popen[str], tuple[str, int]]]:
    """A server in a process of its own, and where it listens."""
    env = {**os.environ, "PYTHONUNBUFFERED": "1"}
    command = [str(CLAMPID), "serve", *map(str, args), "--listen", "127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env) as server:
        try:
            assert server.stdout is not None
            found = re.search(r"listening on (\S+):(\d+)", server.stdout.readline())
            assert found
            yield server, (found[1], int(found[2]))
        finally:
            server.kill()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_stop_with_clients_is_reported_and_ends_with_0_within_two_seconds(
    number: signal.Signals, model_file: Path, cell_file: Path
) -> None:
    with served(model_file, "--cell", cell_file) as (server, at):
        asking, silent, half = (socket.create_connection(at, timeout=10) for _ in range(3))
        with asking, silent, half, asking.makefile() as lines:
            asking.sendall(b"where gamma=0.3 delta=0.2 r=0.8\n")
            assert json.loads(lines.readline())["ok"]
            half.sendall(b"where gam")
            asking.sendall(b"where gamma=0.3 delta=0.2 r=3.0 roll=free\n" * 20)  # computations are under way
            time.sleep(0.1)
            begun = time.monotonic()
            server.send_signal(number)
            _, errors = server.communicate(timeout=10)
            took = time.monotonic() - begun
            told = [json.loads(line) for line in lines]
        assert server.returncode == 0, errors
        assert "Traceback" not in errors
        assert "Error" not in errors
        assert took < 2.0
        assert told[-1] == {"ok": False, "error": "the server stops"}


@pytest.mark.slow
def test_a_stop_while_the_server_is_made_ready_ends_with_0(model_file: Path, cell_file: Path) -> None:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        at = one.getsockname()
    command = [str(CLAMPID), "serve", str(model_file), "--cell", str(cell_file), "--listen", f"{at[0]}:{at[1]}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as server:
        end = time.monotonic() + 30.0
        while time.monotonic() < end:  # its port is taken before anything is compiled
            with suppress(OSError), socket.create_connection(at, timeout=1):
                break
        server.send_signal(signal.SIGTERM)
        said, errors = server.communicate(timeout=30)
    assert "listening" not in said
    assert server.returncode == 0, errors
    assert "Traceback" not in errors


class Arm:
    """A robot that counts what it is told."""

    def __init__(self, stop: Exception | float | None = None) -> None:
        self.stops, self._stop = 0, stop

    def posture(self) -> np.ndarray:
        return np.zeros(6)

    def move(self, postures: np.ndarray, speed: float) -> None:
        pass

    def state(self) -> Mapping[str, Any]:
        return {}

    def stop(self) -> None:
        self.stops += 1
        if isinstance(self._stop, Exception):
            raise self._stop
        if self._stop is not None:
            time.sleep(self._stop)


@pytest.mark.parametrize(
    ("stop", "moved", "says"),
    [
        (None, True, "the server stops; the robot was stopped"),
        (None, False, "the server stops"),
        (OSError("no route"), True, "the server stops; the robot could not be stopped: no route"),
        (5.0, True, "the server stops; the robot did not answer when it was to be stopped"),
    ],
)
def test_a_robot_that_was_sent_on_its_way_is_stopped(
    stop: Exception | float | None, moved: bool, says: str, detector: Detector
) -> None:
    arm = Arm(stop)

    async def run() -> dict[str, Any]:
        speaker = Speaker(detector, arm)
        if moved:
            assert speaker.robot is not None
            speaker.robot.begun = True
        server = Server(speaker)
        host, port = await server.start("127.0.0.1", 0)
        reader, writer = await asyncio.open_connection(host, port)
        while not server.clients:
            await asyncio.sleep(0.01)
        async with asyncio.timeout(2.0):
            assert await server.close()
        told: dict[str, Any] = json.loads(await reader.readline())
        assert await reader.read() == b""
        writer.close()
        return told

    assert asyncio.run(run()) == {"ok": False, "error": says}
    assert arm.stops == int(moved)


def test_a_port_in_use_is_said_before_anything_is_compiled(model_file: Path, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as holder:
        at = f"127.0.0.1:{holder.getsockname()[1]}"
        done = subprocess.run(
            [str(CLAMPID), "serve", str(model_file), "--listen", at],
            capture_output=True, text=True, check=False, timeout=60,
        )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr == f"clampid: cannot listen on {at}: Address already in use\n"
