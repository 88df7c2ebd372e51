"""Beamline clients, ``clampid serve``, EthernetKRL, the virtual controller: each in a process of its own.

What moved is counted by the controller's own journal.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from free_ports import free_port
from peers import free_udp_and_tcp, peer
from serving_thread import Serving

from offline_ik.inverse.detector import Detector
from offline_ik.verbs.serve import linked_robot

ACCEPTED, FINISHED = 1, 3
WATCHDOG = 2.0  # s


@contextlib.contextmanager
def program(lines: int, *arguments: str) -> Iterator[tuple[subprocess.Popen[str], list[str]]]:
    """A verb, and what it says when it is ready."""
    command = [sys.executable, "-m", "clampid", *arguments]
    with (
        tempfile.TemporaryFile("w+") as errors,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True) as process,
    ):
        try:
            assert process.stdout is not None
            said = [process.stdout.readline().strip() for _ in range(lines)]
            errors.seek(0)
            assert all(said), errors.read()
            yield process, said
        finally:
            process.kill()


@dataclass
class Controller:
    """The virtual controller, and the person at it."""

    address: str
    truth: Path
    operator: socket.socket

    def line(self, text: str) -> dict[str, Any]:
        self.operator.sendall(f"{text}\n".encode())
        found: dict[str, Any] = json.loads(self.operator.makefile().readline())
        return found

    def events(self, event: int) -> list[int]:
        """Numbers of the programs of which it tells that."""
        journal = self.truth.with_suffix(".journal.jsonl").read_text(encoding="utf-8").splitlines()
        return [found["id"] for found in map(json.loads, journal) if found.get("event") == event]


@pytest.fixture(scope="module")
def controller(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Controller]:
    truth = tmp_path_factory.mktemp("chain") / "truth.json"
    asked = ("--listen", "127.0.0.1:0", "--operator", "127.0.0.1:0", "--speed", "20", "--truth", str(truth))
    with program(2, "virtual-robot", *asked) as (_, said):
        motion, operator = (line.rpartition(" ")[2] for line in said)
        host, port = operator.rsplit(":", 1)
        with socket.create_connection((host, int(port)), 10) as person:
            yield Controller(motion, truth, person)


@dataclass
class Served:
    """The server with its sides."""

    process: subprocess.Popen[str]
    at: tuple[str, int]
    tango: str
    epics: int


@pytest.fixture(scope="module")
def served(controller: Controller, model_file: Path, cell_file: Path) -> Iterator[Served]:
    tango, epics = free_port(), free_udp_and_tcp()
    sides = ("--tango", "a/b", "--tango-listen", f"127.0.0.1:{tango}", "--epics", "BL:", "--epics-listen",
             f"127.0.0.1:{epics}")  # fmt: skip
    link = ("--cell", str(cell_file), "--link", f"eki://{controller.address}", "--listen", "127.0.0.1:0", "-q")
    with program(3, "serve", str(model_file), *link, *sides) as (process, said):
        words = {line.split()[0]: line.split() for line in said}
        host, port = words["listening"][2].rsplit(":", 1)
        yield Served(process, (host, int(port)), words["tango"][2], epics)


def ask(at: tuple[str, int], *lines: str) -> list[dict[str, Any]]:
    """Answers to lines of one connection that has said hello."""
    with socket.create_connection(at, 30) as found, found.makefile("rb") as answers:
        out = []
        for line in ("hello name=test", *lines):
            found.sendall(line.encode() + b"\n")
            out.append(json.loads(answers.readline()))
        return out[1:]


def until(holds: Callable[[], Any], patience: float = 20.0) -> None:
    end = time.monotonic() + patience
    while not holds():
        assert time.monotonic() < end, "it never came to be"
        time.sleep(0.01)


def test_a_run_engines_grid_makes_as_many_motions_as_it_has_points(controller: Controller, served: Served) -> None:
    pytest.importorskip("bluesky")
    with peer("bluesky_client.py", "{}:{}".format(*served.at)) as engine:
        start = {"gamma": 19.0, "delta": 10.0, "radius": 800.0}
        assert engine.ask(json.dumps({"do": "set", "value": start})) == []
        before = len(controller.events(ACCEPTED))
        grid = {"do": "grid", "gamma": [19.5, 20.5, 3], "delta": [10.5, 11.5, 3]}
        events = engine.ask(json.dumps(grid))
        assert len(controller.events(ACCEPTED)) == before + 9
        until(lambda: len(controller.events(FINISHED)) == before + 9)
        asked = [(g, d) for g in (19.5, 20.0, 20.5) for d in (10.5, 11.0, 11.5)]
        at = [(event["detector-gamma"], event["detector-delta"]) for event in events]
        assert [g for g, _ in at] == pytest.approx([g for g, _ in asked], abs=0.02)
        assert [d for _, d in at] == pytest.approx([d for _, d in asked], abs=0.02)
        refused = engine.ask(json.dumps({"do": "set", "value": {"radius": 2500.0}}))
        assert "within" in refused["failed"]
        assert len(controller.events(ACCEPTED)) == before + 9


def test_a_client_like_contrasts_moves_an_axis_at_a_time(controller: Controller, served: Served) -> None:
    pytest.importorskip("tango")
    with peer("contrast_client.py", served.tango) as client:
        client.ask("write 20 11 800")
        assert client.ask("wait")["ok"] == "ON"
        before = len(controller.events(ACCEPTED))
        for axis, value in ((0, 21.0), (1, 12.0), (2, 805.0)):
            assert client.ask(f"move {axis} {value}")["ok"]["again"] == 0
            assert client.ask("wait")["ok"] == "ON"
        assert client.ask("read position")["ok"] == pytest.approx([21.0, 12.0, 805.0], abs=1e-9)
        assert client.ask("read measured")["ok"] == pytest.approx([21.0, 12.0, 805.0], abs=0.05)
        assert client.ask("move 2 2500")["ok"]["again"] == 0
        assert client.ask("read last_refusal")["ok"]
        assert len(controller.events(ACCEPTED)) == before + 3


def test_a_caproto_client_puts_and_hears_of_the_end(controller: Controller, served: Served) -> None:
    pytest.importorskip("caproto")
    searching = {"EPICS_CA_ADDR_LIST": f"127.0.0.1:{served.epics}", "EPICS_CA_AUTO_ADDR_LIST": "NO"}
    with peer("epics_client.py", "BL:", **searching) as client:
        assert client.ask("put gamma 20 delta 11 radius 800") == {"ok": [True] * 3}
        before = len(controller.events(ACCEPTED))
        assert client.ask("put gamma 22 delta 12 radius 810") == {"ok": [True] * 3}
        assert len(controller.events(ACCEPTED)) == before + 1
        assert client.ask("read measured")["ok"] == pytest.approx([22, 12, 810], abs=0.05)
        assert client.ask("put radius 2500") == {"ok": [False]}
        assert len(controller.events(ACCEPTED)) == before + 1


def test_an_arm_that_brakes_after_an_emergency_stop_is_moving_still(controller: Controller, served: Served) -> None:
    controller.line("speed 1")
    ask(served.at, "confirm", "move gamma=0.8 delta=0.5 r=0.7")
    until(lambda: not controller.line("state")["standing"])
    time.sleep(0.6)
    controller.line("speed 0.1")  # so that it brakes for long enough to be seen
    controller.line("estop")
    until(lambda: ask(served.at, "state")[0]["link"]["running"] == 0)
    time.sleep(0.1)
    assert not controller.line("state")["standing"]
    (told,) = ask(served.at, "robot")
    assert told["moving"], told["link"]
    assert told["link"]["estop"]
    until(lambda: not ask(served.at, "robot")[0]["moving"])
    assert controller.line("state")["standing"]
    (told,) = ask(served.at, "robot")
    assert told["ended"]["outcome"] == "failed"
    assert "emergency stop" in told["ended"]["reason"]
    controller.line("estop off")
    controller.line("drives on")
    controller.line("speed 20")
    until(lambda: ask(served.at, "state")[0]["link"]["drives"])
    (there,) = ask(served.at, "move gamma=0.35 delta=0.2 r=0.8 wait=yes")
    assert there["ended"]["outcome"] == "arrived"


class Out:
    """What the verb's output does with warnings."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def warn(self, text: str) -> None:
        self.said.append(text)


@pytest.mark.slow
def test_kill_9_of_the_server_while_the_robot_moves_and_the_next_ones(
    controller: Controller, served: Served, detector: Detector, model_file: Path, cell_file: Path
) -> None:
    """The next server within the watchdog's time stops what moves for nobody; one after it is told who did."""
    controller.line("speed 1")
    (far,) = ask(served.at, "move gamma=0.8 delta=0.5 r=0.7")
    assert far["moving"]
    until(lambda: controller.line("state")["running"])
    first = controller.line("state")["running"]
    controller.line("speed 0.05")  # it would take a minute from now on
    os.kill(served.process.pid, signal.SIGKILL)
    assert served.process.wait(10) == -signal.SIGKILL
    killed, out = time.monotonic(), Out()
    robot = linked_robot(f"eki://{controller.address}", out)  # as the verb does it
    try:
        (warning,) = out.said
        assert f"program {first} of another client was running" in warning
        assert "it was stopped" in warning
        until(lambda: controller.line("state")["running"] == 0)
        assert time.monotonic() - killed < WATCHDOG
        assert controller.line("state")["stopped"]  # by the server, not by the watchdog
        controller.line("speed 20")
        with Serving(detector, robot) as second:
            until(lambda: not ask(second.at, "robot")[0]["moving"])
            refused, told = ask(second.at, "move gamma=0.35 delta=0.2 r=0.8", "robot")
            assert f"program {first} of another client" in refused["error"]
            assert (told["link"]["aborted"], told["link"]["reason"]) == (first, "the robot was stopped")
            assert told["link"]["stopped"]  # what was refused has lifted nothing
            confirmed, moved = ask(second.at, "confirm", "move gamma=0.35 delta=0.2 r=0.8 wait=yes")
            assert confirmed["ok"]
            assert moved["ended"]["outcome"] == "arrived"
        assert controller.events(ACCEPTED)[-1] == first + 1  # what was interrupted was not sent again
    finally:
        robot.close()

    # Once more, with nobody there for longer than the watchdog waits.
    controller.line("speed 1")
    link = ("--cell", str(cell_file), "--link", f"eki://{controller.address}", "--listen", "127.0.0.1:0", "-q")
    with program(1, "serve", str(model_file), *link) as (process, said):
        host, port = said[0].split()[-1].rsplit(":", 1)
        ask((host, int(port)), "move gamma=0.8 delta=0.5 r=0.7")
        until(lambda: controller.line("state")["running"])
        second_program = controller.line("state")["running"]
        controller.line("speed 0.05")
        os.kill(process.pid, signal.SIGKILL)
        process.wait(10)
        killed = time.monotonic()
    until(lambda: controller.line("state")["running"] == 0)
    assert WATCHDOG - 0.2 < time.monotonic() - killed < WATCHDOG + 1.0
    controller.line("speed 20")
    until(lambda: controller.line("state")["standing"])
    out = Out()
    robot = linked_robot(f"eki://{controller.address}", out)
    try:
        assert out.said == []  # it stands, and nobody has to look
        with Serving(detector, robot) as third:
            told, moved = ask(third.at, "robot", "move gamma=0.35 delta=0.2 r=0.8 wait=yes")
            assert told["link"]["aborted"] == second_program
            assert "had not been asked" in told["link"]["reason"]
            assert moved["ended"]["outcome"] == "arrived"
    finally:
        robot.close()
    assert controller.events(ACCEPTED)[-3:] == [first + 1, second_program, second_program + 1]
