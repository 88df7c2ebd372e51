"""The EthernetKRL client against the virtual controller, over sockets, each in a process of its own."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from experiments.links.address import LinkAddress
from experiments.links.eki import EkiLink, connect
from experiments.links.eki_motion import documents_of
from experiments.links.protocol import (
    InterruptedProgramError,
    LinkError,
    LinkLostError,
    Phase,
    Program,
    RefusedError,
    UnknownFateError,
)
from experiments.links.weight import check_torque_unit
from kinematics.description import load_robot


class Operator:
    """The person at the virtual controller."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), 10)
        self._lines = self._socket.makefile("r", encoding="utf-8")

    def __call__(self, line: str) -> dict:
        self._socket.sendall(f"{line}\n".encode())
        found = json.loads(self._lines.readline())
        assert found.get("ok", True), found
        return found

    def close(self) -> None:
        self._lines.close()
        self._socket.close()


@pytest.fixture(scope="module")
def process() -> Iterator[tuple[int, int]]:
    """Ports of the motion channel and of the operator."""
    command = [sys.executable, "-m", "clampid", "virtual-robot", "--listen", "127.0.0.1:0", "--operator", "127.0.0.1:0"]
    with subprocess.Popen([*command, "--speed", "20"], stdout=subprocess.PIPE, text=True) as running:
        ports: dict[str, int] = {}
        while len(ports) < 2:
            line = running.stdout.readline()
            assert line, "the virtual controller ended"
            if found := re.match(r"(\w+).* 127\.0\.0\.1:(\d+)", line):
                ports[found[1]] = int(found[2])
        yield ports["listening"], next(port for word, port in ports.items() if word != "listening")
        running.send_signal(signal.SIGINT)
        running.wait(20)


@pytest.fixture
def operator(process: tuple[int, int]) -> Iterator[Operator]:
    found = Operator(process[1])
    found("speed 20")
    yield found
    for name in ("split", "coalesce", "padding"):
        found(f"fault {name}=0")
    found.close()


@pytest.fixture
def link(process: tuple[int, int]) -> Iterator[EkiLink]:
    end = time.monotonic() + 10.0
    while True:
        try:
            found = connect(LinkAddress("eki", "127.0.0.1", process[0]))
            break
        except LinkLostError:
            assert time.monotonic() < end
    until(lambda: found._motion.ready)
    released(found)
    yield found
    found.close()


def until(holds: Callable[[], object], patience: float = 10.0) -> None:
    end = time.monotonic() + patience
    while not holds():
        assert time.monotonic() < end, "it never came to be"
        time.sleep(0.002)


def released(link: EkiLink) -> None:
    """Lift a stop; the controller does not while the robot still brakes."""
    end = time.monotonic() + 10.0
    while link.status().stopped:
        assert time.monotonic() < end
        link.release()
        time.sleep(0.05)


def turned(link: EkiLink, *a1: float) -> Program:
    """Axis 1 by so many degrees from where it is."""
    here = link.status().joints
    return Program(np.array([[here[0] + np.radians(a), *here[1:]] for a in a1]), 1.0)


def test_a_move_ends_where_it_was_to_and_the_status_is_of_then(operator: Operator, link: EkiLink) -> None:
    program = turned(link, 5.0, -3.0)
    assert link.wait(link.execute(program), 20.0).point == 2
    np.testing.assert_allclose(link.status().joints, program.postures[-1], atol=2e-5)
    assert link.status().brakes_open
    link.wait(link.execute(turned(link, 3.0)), 20.0)


def test_a_stop_brakes_and_a_release_lets_it_go(operator: Operator, link: EkiLink) -> None:
    operator("speed 1")
    program = turned(link, 40.0)
    number = link.execute(program)
    until(lambda: link.fate(number).phase is Phase.RUNNING)
    time.sleep(0.2)
    link.stop()
    with pytest.raises(InterruptedProgramError, match="stopped"):
        link.wait(number, 5.0)
    time.sleep(0.5)
    there = link.status().joints[0]
    time.sleep(0.1)
    assert abs(link.status().joints[0] - there) < 1e-5
    assert 0.001 < abs(there - program.postures[0, 0]) < np.radians(40.0)
    until(lambda: not link._state.stop_wanted)
    with pytest.raises(RefusedError, match="not released"):
        link.execute(program)
    released(link)


def test_an_emergency_stop_is_reported(operator: Operator, link: EkiLink) -> None:
    operator("speed 1")
    number = link.execute(turned(link, 20.0))
    until(lambda: link.fate(number).phase is Phase.RUNNING)
    operator("estop")
    with pytest.raises(InterruptedProgramError, match="emergency stop"):
        link.wait(number, 5.0)
    with pytest.raises(RefusedError):
        link.execute(turned(link, 0.0))
    operator("estop off")
    operator("drives on")
    until(lambda: link.status().drives and not link.status().estop)
    operator("speed 20")
    assert link.wait(link.execute(turned(link, 1.0)), 20.0).phase is Phase.FINISHED


def test_the_controllers_programs_are_started_again_in_the_middle_of_a_motion(
    operator: Operator, link: EkiLink
) -> None:
    operator("speed 1")
    boot = link.status().boot
    operator("fault restart-at=point:2")
    number = link.execute(turned(link, 1.0, 10.0, 2.0))
    with pytest.raises(UnknownFateError, match="started again"):
        link.wait(number, 10.0)
    until(lambda: link.status().boot != boot and link.status().age < 0.1)
    assert link.open_question()
    link.confirm()
    until(lambda: link._motion.ready)
    operator("speed 20")
    assert link.wait(link.execute(turned(link, 1.0)), 20.0).phase is Phase.FINISHED


def test_a_recording_has_no_hole_after_a_cut_of_both_channels(operator: Operator, link: EkiLink) -> None:
    newest = link.status().newest
    first = link.recording(newest, most=50)
    operator("kill-link")
    time.sleep(0.2)
    second = link.recording(int(first.number[-1]) + 1, most=50)
    numbers = np.concatenate([first.number, second.number])
    assert (np.diff(numbers) == 1).all()
    np.testing.assert_allclose(np.diff(np.concatenate([first.time, second.time])), 0.012, atol=1.1e-3)
    assert second.lost is None


def test_the_unit_of_its_torques_follows_from_the_robots_weight(operator: Operator, link: EkiLink) -> None:
    joints, torques = [], []
    for a2, a3 in ((-90, 90), (-60, 60), (-30, 90), (-110, 60), (-45, 20), (-80, 120), (-20, 30), (-90, 40)):
        link.wait(link.execute(Program(np.radians([[0.0, a2, a3, 0.0, 30.0, 0.0]]), 0.5)), 20.0)
        found = link.recording(link.status().newest + 1, most=8)
        joints.append(found.joints.mean(axis=0))
        torques.append(found.torque.mean(axis=0))
    robot = load_robot("kuka_kr20_r1810")
    told = check_torque_unit(robot, joints, torques)
    assert (told.unit, told.side) == ("Nm", "motor"), told.words
    assert check_torque_unit(robot, joints, 10.0 * np.array(torques)).unit is None


CLIENT = """
import sys, time, numpy as np
from experiments.links.address import open_link
from experiments.links.protocol import Program
link = open_link(f"eki://127.0.0.1:{sys.argv[1]}")
here = link.status().joints
number = link.execute(Program(np.array([here + [1.5, 0, 0, 0, 0, 0], here]), 0.05))
while link.fate(number).phase != "running":
    time.sleep(0.001)
print(number, flush=True)
time.sleep(60)
"""


def test_kill_9_of_the_client_while_the_robot_moves(process: tuple[int, int], operator: Operator) -> None:
    operator("speed 1")
    with subprocess.Popen([sys.executable, "-c", CLIENT, str(process[0])], stdout=subprocess.PIPE, text=True) as client:
        number = int(client.stdout.readline())
        os.kill(client.pid, signal.SIGKILL)
    following = connect(LinkAddress("eki", "127.0.0.1", process[0]))
    try:
        # The next one knows: it runs still (and a person is asked), or the watchdog has ended it.
        status = following.status()
        assert number in (status.running, status.aborted)
        if status.running:
            assert f"program {number} of another client" in str(following.open_question())
        following.stop()
        until(lambda: following.status().running == 0)
        assert following.status().aborted == number
        released(following)
    finally:
        following.close()


def test_nobody_asks_for_two_seconds_and_the_watchdog_ends_the_motion(
    process: tuple[int, int], operator: Operator, link: EkiLink
) -> None:
    operator("speed 1")
    here = link.status().joints
    number = link.execute(Program(here + np.eye(6)[:1] * 1.5, 0.05))
    until(lambda: link.fate(number).phase is Phase.RUNNING)
    link.close()
    time.sleep(2.3)
    following = connect(LinkAddress("eki", "127.0.0.1", process[0]))
    try:
        assert (following.status().running, following.status().aborted) == (0, number)
        assert "had not been asked" in following.status().reason
    finally:
        following.close()


@pytest.mark.parametrize(
    "fault",
    ["split=97", "split=700", "coalesce=3", "padding=100", "stall=motion:0.5", "stall=state:1.5", "stall=motion:3.0"],
)  # fmt: skip
def test_programs_are_executed_once_or_not_at_all_whatever_goes_wrong(
    operator: Operator, link: EkiLink, fault: str
) -> None:
    before = link._fresh().accepted
    operator(f"fault {fault}")
    done = 0
    for _ in range(3):
        end = time.monotonic() + 20.0
        while True:
            assert time.monotonic() < end
            try:
                number = link.execute(turned(link, 0.02, -0.02))
                break
            except LinkError:
                if link.open_question() is not None:
                    link.confirm()
                time.sleep(0.02)
        with contextlib.suppress(LinkError):
            link.wait(number, 20.0)
        assert link.fate(number).phase in (Phase.FINISHED, Phase.NOT_EXECUTED)
        done += link.fate(number).phase is Phase.FINISHED
        until(lambda: link.status().age < 0.1)
        assert (link.status().finished == number) == (link.fate(number).phase is Phase.FINISHED)
    assert done >= 1
    assert link.status().accepted > before


def cut_each(operator: Operator, link: EkiLink, way: str, bytes_: range) -> Counter:
    """A program for each byte, with the cut there: what became of it, and what the controller accepted."""
    found: Counter[tuple[Phase, bool]] = Counter()
    for at in bytes_:
        end = time.monotonic() + 20.0
        while True:
            assert time.monotonic() < end
            if link.open_question() is not None:
                link.confirm()
            until(lambda: link._motion.ready)
            time.sleep(0.01)
            if not link._motion.ready:
                continue
            operator(f"fault drop-after=motion:{way}{at}")
            try:
                number = link.execute(turned(link, 0.01))
                break
            except LinkError:
                time.sleep(0.005)
        with contextlib.suppress(LinkError):
            link.wait(number, 20.0)
        found[link.fate(number).phase, link._fresh().accepted == number] += 1
    return found


@pytest.mark.parametrize("way", ["", "sent:"])
@pytest.mark.parametrize("step", [7, pytest.param(1, marks=pytest.mark.slow)])
def test_cut_at_every_byte_against_the_virtual_controller(
    operator: Operator, link: EkiLink, way: str, step: int
) -> None:
    length = len(documents_of(turned(link, 0.01), 7, 100))
    found = cut_each(operator, link, way, range(1, length + 60, step))
    assert set(found) <= {(Phase.FINISHED, True), (Phase.NOT_EXECUTED, False)}
    assert found[Phase.FINISHED, True] > 0
    if not way:
        assert found[Phase.NOT_EXECUTED, False] >= 0.8 * length / step  # numbers of fewer digits make it shorter
