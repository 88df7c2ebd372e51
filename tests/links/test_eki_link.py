"""The EthernetKRL client over sockets, against a small controller with faults."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest
from fake_controller import FakeController

from experiments.links import eki, eki_motion
from experiments.links.address import LinkAddress
from experiments.links.eki import EkiLink, connect
from experiments.links.protocol import (
    InterruptedProgramError,
    Link,
    LinkError,
    LinkLostError,
    Phase,
    Program,
    RefusedError,
    UnknownFateError,
)
from experiments.links.schema import RING, Kind, Mode

HOME = np.radians([0.0, -90.0, 90.0, 0.0, 45.0, 0.0])


def to(*a1: float) -> Program:
    """A program that turns axis 1 only, deg."""
    return Program(np.array([[np.radians(a), *HOME[1:]] for a in a1]), 0.2)


def until(holds: Callable[[], object], patience: float = 5.0) -> None:
    end = time.monotonic() + patience
    while not holds():
        assert time.monotonic() < end, "it never came to be"
        time.sleep(0.002)


def test_it_is_a_link_and_says_what_its_numbers_are(controller: FakeController, link: EkiLink) -> None:
    assert isinstance(link, Link)
    found = link.capabilities.to_json()
    assert found["executes"]
    assert {s["name"]: (s["unit"], s["side"]) for s in found["signals"]}["torque"] == ("unit unknown", "motor")
    settings = {"torque": "Nm", "current": "%"}
    controller.state.drop()
    link.close()
    told = connect(LinkAddress("eki", "127.0.0.1", controller.port, settings))
    units = {s.name: s.unit for s in told.capabilities.signals}
    told.close()
    assert (units["torque"], units["current"], units["joint"]) == ("Nm", "%", "rad")


def test_a_program_moves_and_its_points_are_reported(controller: FakeController, link: EkiLink) -> None:
    controller.point_s = 0.05
    number = link.execute(to(5, 10, 15))
    until(lambda: link.fate(number).phase is Phase.RUNNING)
    assert link.wait(number, 5.0).point == 3
    until(lambda: np.allclose(link.status().joints[0], np.radians(15), atol=1e-9))
    assert controller.executed == {(7, number): 1}
    assert link.status().age < 0.2


def test_a_request_reaches_the_socket_within_a_millisecond(controller: FakeController, link: EkiLink) -> None:
    times = []
    send = eki_motion.Connection.send

    def timed(self: object, data: bytes, patience: float = 0.0) -> None:
        send(self, data, patience)  # type: ignore[arg-type]
        if b"<Move>" in data:
            times.append(time.perf_counter())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(eki_motion.Connection, "send", timed)
        taken = []
        for k in range(30):
            begun = time.perf_counter()
            link.wait(link.execute(to(k)), 5.0)
            taken.append(times[-1] - begun)
    assert np.median(taken) < 1e-3


def test_a_stop_takes_less_than_10_ms_from_any_thread_and_holds(controller: FakeController, link: EkiLink) -> None:
    controller.point_s = 0.2
    number = link.execute(to(1, 2, 3, 4, 5))
    until(lambda: link.fate(number).phase is Phase.RUNNING)
    taken: list[float] = []

    def stop() -> None:
        begun = time.perf_counter()
        link.stop()
        taken.append(time.perf_counter() - begun)

    threads = [threading.Thread(target=stop) for _ in range(5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert np.median(taken) < 0.01  # not the longest: other processes use the processor as well
    with pytest.raises(InterruptedProgramError, match="the robot was stopped"):
        link.wait(number, 5.0)
    until(lambda: link.status().stopped and not link._state.stop_wanted)
    with pytest.raises(RefusedError, match="not released"):
        link.execute(to(1))
    link.release()
    until(lambda: not link.status().stopped)
    assert link.wait(link.execute(to(1)), 5.0).phase is Phase.FINISHED


def test_a_stop_without_a_connection_is_said_and_goes_first_afterwards(
    controller: FakeController, link: EkiLink
) -> None:
    with controller.lock:
        controller.state.deaf()
        controller.asks.clear()
    until(lambda: link._state.trouble)
    with pytest.raises(LinkLostError):
        link.stop()
    with pytest.raises(RefusedError, match="a stop is on its way"):
        link.execute(to(1))
    with controller.lock:
        controller.state.listen()
    until(lambda: controller.asks)
    assert controller.asks[0] == Kind.STOP
    until(lambda: link.status().stopped)


def test_what_was_wanted_before_a_stop_is_not_sent_after_it(controller: FakeController, link: EkiLink) -> None:
    status = link.status()
    fate = link._programs.begin(status, 1)
    link.stop()
    link._motion.queue(fate.id, b"<Move></Move>", link._motion.stops - 1)
    until(lambda: link.fate(fate.id).phase is Phase.NOT_EXECUTED)
    assert "stopped before it was sent" in link.fate(fate.id).reason


@pytest.mark.parametrize(
    ("change", "why"),
    [({"estop": True}, "emergency stop"), ({"mode": Mode.T1}, "mode is T1"), ({"drives": False}, "drives are off")],
)
def test_what_would_be_refused_is_refused_here(
    controller: FakeController, link: EkiLink, change: dict[str, object], why: str
) -> None:
    with controller.lock:
        for name, value in change.items():
            setattr(controller, name, value)
    time.sleep(0.1)
    with pytest.raises(RefusedError, match=why):
        link.execute(to(1))
    assert not controller.executed


def test_a_latch_that_the_status_does_not_show_yet_is_the_controllers_refusal(
    controller: FakeController, link: EkiLink
) -> None:
    controller.state.mute = True
    controller.stopped = True
    number = link.execute(to(1))
    with pytest.raises(RefusedError, match="program 1: refused: the robot was stopped"):
        link.wait(number, 5.0)


@pytest.mark.parametrize("program", [to(*range(61)), Program(np.zeros((1, 7)), 0.1)])
def test_a_program_that_the_controller_cannot_hold(link: EkiLink, program: Program) -> None:
    with pytest.raises(RefusedError, match="program: expected"):
        link.execute(program)


def test_sixty_points_go_in_one_program(controller: FakeController, link: EkiLink) -> None:
    assert link.wait(link.execute(to(*range(60))), 5.0).point == 60


def test_the_controller_is_started_again_in_the_middle_of_a_motion(controller: FakeController, link: EkiLink) -> None:
    controller.point_s = 0.2
    number = link.execute(to(1, 2, 3))
    until(lambda: link.fate(number).point == 1)
    connected = link._motion.attempts
    controller.restart()
    with pytest.raises(UnknownFateError, match="started again"):
        link.wait(number, 5.0)
    until(lambda: link.status().boot == 8)
    with pytest.raises(LinkError, match=r"confirm|motion channel"):
        link.execute(to(1))
    link.confirm()
    until(lambda: link._motion.attempts > connected)  # the end of the old connection has been noticed
    until(lambda: link._motion.ready and link.status().age < 0.1)
    again = link.execute(to(1))
    assert link.wait(again, 5.0).phase is Phase.FINISHED
    assert controller.executed == {(7, number): 1, (8, again): 1}


def test_a_program_that_runs_goes_on_while_the_motion_channel_is_gone(
    controller: FakeController, link: EkiLink
) -> None:
    controller.point_s = 0.1
    number = link.execute(to(1, 2, 3))
    until(lambda: link.fate(number).phase is Phase.RUNNING)
    with controller.lock:
        controller.motion.drop()
    assert link.wait(number, 5.0).phase is Phase.FINISHED
    assert link.open_question() is None


def test_a_controller_that_vanishes_makes_it_unknown(controller: FakeController) -> None:
    link = connect(LinkAddress("eki", "127.0.0.1", controller.port, {"patience": "0.5"}))
    try:
        controller.point_s = 10.0
        number = link.execute(to(1))
        until(lambda: link.fate(number).phase is Phase.RUNNING)
        controller.close()
        with pytest.raises(UnknownFateError, match=r"nothing was heard of it for 0\.5 s"):
            link.wait(number, 5.0)
        with pytest.raises(LinkLostError):
            link.execute(to(1))
        assert link.status().age > 0.4  # said with its age, not passed on as new
    finally:
        link.close()


def test_a_controller_that_says_nothing_of_a_program_is_asked_over_a_new_connection(
    controller: FakeController, link: EkiLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(eki_motion, "ACKNOWLEDGE", 0.2)
    controller.motion.mute = True  # as if its answers were lost
    number = link.execute(to(1))
    assert link.wait(number, 5.0).phase is Phase.FINISHED  # its state says so
    monkeypatch.setattr(FakeController, "_move", lambda self, texts: None)  # and now it takes nothing up
    until(lambda: link._motion.ready)
    number = link.execute(to(2))
    time.sleep(0.5)
    assert link.fate(number).phase is Phase.SENT  # silence proves nothing
    monkeypatch.undo()
    controller.motion.mute = False
    until(lambda: link.fate(number).phase is Phase.NOT_EXECUTED, 10.0)
    assert controller.executed == {(7, 1): 1}


def test_of_two_clients_one_has_the_robot_and_the_other_learns_it(
    controller: FakeController, link: EkiLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(eki, "FIRST_STATUS_TIMEOUT", 0.3)
    with pytest.raises(LinkLostError, match="closed the connection; another client may have the channel"):
        connect(LinkAddress("eki", "127.0.0.1", controller.port))
    assert link.wait(link.execute(to(1)), 5.0).phase is Phase.FINISHED


def test_nobody_there_is_said_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(eki, "FIRST_STATUS_TIMEOUT", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(LinkLostError, match="refused"):
        connect(LinkAddress("eki", "127.0.0.1", port))


@pytest.mark.parametrize("data", [b"rubbish", b"<Robot></Robot>", b'<?xml version="1.0"?>', b"<Moved/>", b"<a>" * 9])
@pytest.mark.parametrize("channel", ["motion", "state"])
def test_rubbish_of_the_controller_ends_a_connection_and_not_the_link(
    controller: FakeController, link: EkiLink, channel: str, data: bytes
) -> None:
    found = getattr(controller, channel)
    until(lambda: found.client is not None)
    before = found.connections
    with controller.lock:
        found.client.sendall(data)
    until(lambda: found.connections > before)
    until(lambda: link._motion.ready and link.status().age < 0.1)
    assert link.wait(link.execute(to(3)), 5.0).phase is Phase.FINISHED


def test_a_silent_controller_makes_the_status_old_and_nothing_moves(controller: FakeController, link: EkiLink) -> None:
    controller.state.mute = True
    time.sleep(0.7)
    assert link.status().age > 0.5
    with pytest.raises(LinkLostError, match="too old to move by"):
        link.execute(to(1))
    controller.state.mute = False
    until(lambda: link.status().age < 0.1)
    assert link.execute(to(1))


def test_the_watchdog_ends_a_program_of_a_client_that_is_gone_and_the_next_one_knows(
    controller: FakeController, link: EkiLink
) -> None:
    controller.watchdog, controller.point_s = 0.3, 5.0
    number = link.execute(to(1, 2))
    until(lambda: controller.running == number)
    link.close()
    until(lambda: controller.aborted == number)
    following = connect(LinkAddress("eki", "127.0.0.1", controller.port))
    try:
        assert following.status().aborted == number
        assert "had not been asked" in following.status().reason
        controller.point_s = 0.0
        assert following.wait(following.execute(to(1)), 5.0).id == number + 1
    finally:
        following.close()


def test_a_recording_survives_a_break_of_the_network(controller: FakeController, link: EkiLink) -> None:
    controller.record(30)
    first = link.recording(1)
    with controller.lock:
        controller.state.drop()
    controller.record(65)
    second = link.recording(31)
    numbers = [*first.number, *second.number]
    assert numbers == list(range(1, 66))
    assert (first.lost, second.lost, second.newest) == (None, None, 65)
    np.testing.assert_allclose(second.joints[:, 0], np.radians(0.001 * second.number))
    np.testing.assert_allclose(second.torque[:, 1], 2.0 * second.number)
    np.testing.assert_allclose(second.time, 0.012 * second.number)


def test_a_gap_of_a_recording_is_reported(controller: FakeController, link: EkiLink) -> None:
    controller.record(RING + 100)
    found = link.recording(1, most=8)
    assert found.lost == (1, 100)
    assert list(found.number) == list(range(101, 109))
    assert link.recording(RING + 101).number.size == 0


def test_three_hundred_statuses_leave_nothing_behind(
    controller: FakeController, link: EkiLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    import os
    import tracemalloc

    # A busy machine may answer late: that is not what is judged here.
    monkeypatch.setattr("experiments.links.eki_state.SILENCE", 60.0)

    def statuses(count: int) -> None:
        for _ in range(count):
            link._state.exchange(Kind.STATE, patience=60.0)

    before = len(os.listdir("/proc/self/fd"))
    statuses(50)
    tracemalloc.start()
    try:
        statuses(300)
        grown = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert grown < 300_000
    until(lambda: len(os.listdir("/proc/self/fd")) <= before + 1)
    assert not link._state._awaited
