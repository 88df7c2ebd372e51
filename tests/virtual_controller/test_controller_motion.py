"""Motion over the sockets: accepted whole or not at all, executed once, stopped when it should."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from controller_client import HOME, STEP, Controller, Process, angles, inside, move, process, same_place


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Controller]:
    with inside(tmp_path_factory.mktemp("truth") / "truth.json", speed=20.0) as one:
        yield one


@pytest.fixture
def robot(shared: Controller) -> Controller:
    return shared.fresh()


def test_program_is_executed_once_and_told(robot: Controller) -> None:
    points = [HOME + STEP, HOME - STEP, HOME + STEP]
    assert robot.run(1, points) == [1, 2, 2, 2, 3]
    state = robot.ask()
    assert [state[f"State.{k}"] for k in ("Accepted", "Running", "Finished", "Aborted", "Point")] == [1, 0, 1, 0, 3]
    assert same_place(angles(state), points[-1])
    assert robot.told(1) == [(1, 0)]
    assert robot.told(2) == [(1, 1), (1, 2), (1, 3)]
    reached = [e["at"] for e in robot.events() if e["event"] == 2][-3:]
    assert np.allclose(reached, points, atol=1e-4)


def test_nothing_moves_before_the_program_is_whole(robot: Controller) -> None:
    before = angles(robot.ask())
    documents = move(robot.boot, 1, [HOME + STEP, HOME - STEP])
    with robot.motion() as link:
        link.send(documents[0] + documents[1][:-1])
        time.sleep(0.2)
        assert same_place(angles(robot.ask()), before, readings=2)
    time.sleep(0.1)
    state = robot.ask()
    assert (state["State.Accepted"], state["State.Reason"]) == (0, 11)
    assert robot.told(1) == []
    assert robot.run(1, [HOME + STEP]) == [1, 2, 3]


@pytest.mark.parametrize(
    ("reason", "documents"),
    [
        (1, lambda boot: move(boot + 6, 1, [HOME])),
        (2, lambda boot: move(boot, 0, [HOME])),
        (3, lambda boot: move(boot, 1, [HOME] * 3)[::2]),
        (3, lambda boot: move(boot, 1, [HOME] * 61)[:1]),
        (4, lambda boot: move(boot, 1, [HOME, HOME + np.array([0, 200, 0, 0, 0, 0])])),
        (5, lambda boot: move(boot, 1, [HOME], 0.0)),
        (5, lambda boot: move(boot, 1, [HOME], 100.5)),
    ],
)
def test_refused_programs_say_why(robot: Controller, reason: int, documents: Callable[[int], list[bytes]]) -> None:
    with robot.motion() as link:
        link.send(b"".join(documents(robot.boot)))
        told = link.receive()
        assert (told["Event"], told["Reason"], told["Boot"]) == (4, reason, robot.boot)
        link.send(b"".join(move(robot.boot, 1, [HOME + STEP])))
        assert link.receive()["Event"] == 1
    assert robot.ask()["State.Accepted"] == 1


def test_running_program_refuses_another(robot: Controller) -> None:
    robot.line("operator", "speed 4")
    with robot.motion() as link:
        link.send(b"".join(move(robot.boot, 1, [HOME + STEP], 1.0)))
        assert link.receive()["Event"] == 1
        link.send(b"".join(move(robot.boot, 2, [HOME - STEP, HOME])))
        told = link.receive()
        assert (told["Event"], told["Reason"], told["Id"]) == (4, 12, 2)
        robot.ask(1)
        assert link.receive()["Event"] == 5
    assert robot.told(1) == [(1, 0)]


def test_stop_latches_until_released(robot: Controller) -> None:
    robot.line("operator", "speed 1")
    with robot.motion() as link:
        link.send(b"".join(move(robot.boot, 1, [HOME + STEP], 4.0)))
        assert link.receive()["Event"] == 1
        time.sleep(0.3)
        state = robot.ask(1)
        assert (state["State.Stopped"], state["State.Aborted"], state["State.Running"]) == (1, 1, 0)
        assert (told := link.receive())["Event"] == 5
        assert told["Reason"] == 6
        time.sleep(0.2)
        where = angles(robot.ask())
        assert 0.05 < (where - HOME)[5] / STEP[5] < 0.95
        link.send(b"".join(move(robot.boot, 2, [HOME])))
        assert link.receive()["Reason"] == 6
        assert robot.ask(2)["State.Stopped"] == 0
        link.send(b"".join(move(robot.boot, 3, [HOME])))
        robot.line("operator", "speed 100")
        assert [int(link.receive()["Event"]) for _ in range(3)] == [1, 2, 3]
    stood = [e["at"] for e in robot.events() if e["event"] == 5][-1]
    assert same_place(where, stood)


@pytest.mark.parametrize(("lines", "reason"), [(["estop"], 7), (["mode T1"], 8), (["mode T2"], 8), (["drives off"], 9)])
def test_safety_aborts_and_refuses(robot: Controller, lines: list[str], reason: int) -> None:
    robot.line("operator", "speed 4")
    with robot.motion() as link:
        link.send(b"".join(move(robot.boot, 1, [HOME + STEP], 1.0)))
        assert link.receive()["Event"] == 1
        for line in lines:
            assert "error" not in robot.line("operator", line)
        told = link.receive()
        assert (told["Event"], told["Reason"]) == (5, reason)
        link.send(b"".join(move(robot.boot, 2, [HOME])))
        assert link.receive()["Reason"] == reason
        state = robot.ask()
        assert state["State.Brakes"] == (0 if reason in (7, 9) else 1)
        assert np.all(angles(state, "Torque") == 0) == (reason in (7, 9))
        for line in ("estop off", "mode EXT", "drives on"):
            assert "error" not in robot.line("operator", line)
        link.send(b"".join(move(robot.boot, 3, [HOME])))
        assert link.receive()["Event"] == 1


def test_watchdog_stops_a_robot_that_nobody_asks(robot: Controller) -> None:
    robot.line("operator", "speed 1")
    with robot.motion() as link:
        link.send(b"".join(move(robot.boot, 1, [HOME + STEP], 1.0)))
        assert link.receive()["Event"] == 1
        begin = time.monotonic()
        told = link.receive(6.0)
        assert 1.8 < time.monotonic() - begin < 4.0
        assert (told["Event"], told["Reason"]) == (5, 10)
        state = robot.ask()
        assert (state["State.Stopped"], state["State.Aborted"]) == (0, 1)


def test_motion_goes_on_without_its_channel_while_state_is_asked(robot: Controller) -> None:
    robot.ask()
    with robot.motion() as link:
        link.send(b"".join(move(robot.boot, 1, [HOME + STEP], 20.0)))
        assert link.receive()["Event"] == 1
    until = time.monotonic() + 10
    while robot.ask()["State.Finished"] != 1:
        assert time.monotonic() < until
    assert robot.told(3) == [(1, 1)]


def test_restart_counts_up_and_begins_anew(robot: Controller) -> None:
    robot.line("operator", "speed 4")
    before = robot.boot
    with robot.motion() as link:
        link.send(b"".join(move(robot.boot, 5, [HOME + STEP], 1.0)))
        assert link.receive()["Event"] == 1
        robot.ask()
        robot.line("operator", "restart")
        assert link.closed()
    robot.lost_state()
    time.sleep(0.4)
    state = robot.ask()
    assert [state[f"State.{k}"] for k in ("Boot", "Accepted", "Running", "Aborted")] == [before + 1, 0, 0, 0]
    assert state["State.Newest"] < 20 * 1000
    assert robot.said(5)[-1] == (before, 5, 0)
    with robot.motion() as link:
        link.send(b"".join(move(before, 6, [HOME])))
        assert link.receive()["Reason"] == 1
    assert robot.run(1, [HOME]) == [1, 2, 3]


def test_killed_controller_goes_on_where_it_was_seen_last(tmp_path: Path) -> None:
    truth = tmp_path / "truth.json"
    first = Process("--speed", "100", truth=truth)
    try:
        assert first.run(1, [HOME + STEP]) == [1, 2, 3]
        first.line("operator", "speed 1")
        with first.motion() as link:
            link.send(b"".join(move(1, 2, [HOME], 5.0)))
            assert link.receive()["Event"] == 1
    finally:
        first.kill()
    with process("--speed", "100", truth=truth) as second:
        state = second.ask()
        assert (state["State.Boot"], state["State.Accepted"]) == (2, 0)
        assert same_place(angles(state), HOME + STEP)
        assert (second.said(1), second.said(3)) == ([(1, 1, 0), (1, 2, 0)], [(1, 1, 1)])
        with second.motion() as link:
            link.send(b"".join(move(1, 3, [HOME])))
            assert link.receive()["Reason"] == 1


def test_sixty_points_take_well_below_a_second(tmp_path: Path) -> None:
    with inside(tmp_path / "truth.json", speed=1000.0) as robot:
        robot.ask()
        begin = time.monotonic()
        points = [HOME + STEP * (-1) ** k for k in range(60)]
        assert robot.run(1, points) == [1, *[2] * 60, 3]
        assert time.monotonic() - begin < 0.8
        begin = time.monotonic()
        for _ in range(200):
            robot.ask()
        assert (time.monotonic() - begin) / 200 < 0.03


@pytest.mark.study
def test_six_simulated_hours_of_motion_leave_memory_and_files_as_they_were(tmp_path: Path) -> None:
    with process("--speed", "1000", truth=tmp_path / "truth.json") as robot:
        number, memory, files, begun = 0, [], [], 0.0
        while robot.line("operator", "state")["time_s"] < begun + 6 * 3600:
            number += 1
            assert robot.run(number, [HOME + STEP * (-1) ** k for k in range(60)], 50.0) == [1, *[2] * 60, 3]
            robot.line("tracker", "measure 10")
            for k in range(20):
                robot.ask(3, int(robot.ask()["State.Newest"]) - 80 + 4 * k)
            if number == 10:
                begun = robot.line("operator", "state")["time_s"]
            memory.append(robot.memory())
            files.append(robot.descriptors())
        print(f"{number} programs, memory {memory[10]:.1f} to {memory[-1]:.1f} MB")
        assert robot.told(3) == [(k, 60) for k in range(1, number + 1)]
        assert memory[-1] < memory[10] + 10.0
        assert max(files[10:]) <= files[10]
