"""Channels behave as EthernetKRL's do, and go wrong on demand."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
from controller_client import HOME, STEP, Controller, Inside, Link, angles, inside, move, numbers, same_place

from experiments.virtual_controller.errors import ControllerError
from experiments.virtual_controller.faults import Fault, parse_faults


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Inside]:
    with inside(tmp_path_factory.mktemp("truth") / "truth.json", speed=20.0) as one:
        yield one


@pytest.fixture
def robot(shared: Inside) -> Inside:
    shared.fresh(200.0)
    return shared


def told(link: Link, count: int) -> list[int]:
    return [int(link.receive()["Event"]) for _ in range(count)]


def test_second_client_is_hung_up_on(robot: Controller) -> None:
    with robot.motion() as first:
        time.sleep(0.05)
        with robot.motion() as second:
            assert second.closed()
        first.send(b"".join(move(robot.boot, 1, [HOME + STEP])))
        assert told(first, 3) == [1, 2, 3]
    with robot.motion() as third:
        third.send(b"".join(move(robot.boot, 2, [HOME])))
        assert told(third, 3) == [1, 2, 3]


def test_documents_come_in_bytes_and_all_at_once(robot: Controller) -> None:
    boot = robot.boot
    with robot.motion() as link:
        for byte in b"\0\n ".join(move(boot, 1, [HOME + STEP, HOME])):
            link.send(bytes([byte]))
        assert told(link, 4) == [1, 2, 2, 3]
        link.send(b"\0".join(move(boot, 2, [HOME + STEP, HOME])))
        assert told(link, 4) == [1, 2, 2, 3]


def test_document_without_an_element_leaves_the_record_incomplete(robot: Inside) -> None:
    first, second = move(robot.boot, 1, [HOME + STEP, HOME])
    with robot.motion() as link:
        link.send(first.replace(b"<Speed>100.0</Speed>", b"") + second)
        time.sleep(0.2)
        assert robot.robot.motion.fifos.stored == 1  # the second point waits for a speed
        assert robot.told(1) == []
        link.send(move(robot.boot, 1, [HOME])[0])  # brings it: the record is point 2, as it was sent
        assert link.receive()["Event"] == 1
        assert robot.robot.motion.fifos.stored == 1  # and is itself without one now


def test_overflow_closes_at_once_and_nothing_moves(robot: Inside) -> None:
    limit = robot.robot.motion.config.limit
    point = move(robot.boot, 1, [HOME + STEP, HOME])[0].replace(b"<Speed>100.0</Speed>", b"")
    with robot.motion() as link:
        link.send(point * limit)
        time.sleep(0.2)
        assert robot.robot.motion.fifos.stored == limit
        link.send(point)
        assert link.closed()
    assert robot.robot.motion.fifos.stored == 0
    assert robot.told(1) == []
    assert robot.run(1, [HOME]) == [1, 2, 3]


def test_overflow_on_demand(robot: Inside) -> None:
    limit = robot.robot.motion.config.limit
    robot.line("operator", "fault overflow=motion")
    with robot.motion() as link:
        for document in move(robot.boot, 1, [HOME] * 60) + move(robot.boot, 2, [HOME] * (limit - 60)):
            link.send(document)
        time.sleep(0.2)
        assert robot.robot.motion.fifos.stored == limit
        link.send(move(robot.boot, 3, [HOME])[0])
        assert link.closed()
    assert robot.told(1) == []
    assert robot.run(1, [HOME]) == [1, 2, 3]


@pytest.mark.parametrize(
    "bad",
    [
        b'<!DOCTYPE a [<!ENTITY b "c">]><Move></Move>', b"<?go?>", b"<Move><Move><a><a><a><a><a><a><a>", b"go",
        b"<Go></Go>",
        b"<Move><Boot>x</Boot></Move>", b"<Move><Boot>99999999999</Boot></Move>", b"<Move><Speed>nan</Speed></Move>",
        b"<Move><Speed>1e300</Speed></Move>", b"<Move>&boot;</Move>", b"<Move>" + b"x" * 40000, b"<Move></Mova>",
        b"<Move>\0</Move>", b"\xff\xfe<\0M\0", b"<Move a='" + b">" * 40000,
    ],
)  # fmt: skip
def test_what_is_no_document_closes_the_channel(robot: Inside, bad: bytes) -> None:
    with robot.motion() as link:
        link.send(bad)
        assert link.closed()
    assert robot.run(1, [HOME]) == [1, 2, 3]


def test_connection_is_cut_after_any_byte_received(robot: Controller) -> None:
    program = b"".join(move(robot.boot, 1, [HOME + STEP, HOME]))
    first = len(move(robot.boot, 1, [HOME + STEP, HOME])[0])
    for cut in (1, first - 1, first, first + 1, len(program) - 1):
        robot.line("operator", f"fault drop-after={cut}")
        with robot.motion() as link:
            link.send(program)
            assert link.closed()
    assert robot.told(1) == []
    robot.line("operator", f"fault drop-after={len(program)}")
    with robot.motion() as link:
        link.send(program)
        assert link.closed()
    assert robot.told(1) == [(1, 0)]


def test_connection_is_cut_after_any_byte_sent(robot: Controller) -> None:
    whole = None
    for number, cut in enumerate((0, 1, 40, 75, 110), 1):
        robot.line("operator", f"fault drop-after=motion:sent:{cut}")
        with robot.motion() as link:
            link.send(b"".join(move(robot.boot, number, [HOME + STEP, HOME])))
            received = b""
            while piece := link.sock.recv(1000):
                received += piece
        assert len(received) == cut
        whole = received
        while robot.ask()["State.Finished"] != number:
            time.sleep(0.01)
    assert numbers(whole or b"")["Event"] == 1
    assert robot.told(3) == [(k, 2) for k in range(1, 6)]


def test_state_channel_is_cut_too(robot: Controller) -> None:
    robot.line("operator", "fault drop-after=state:sent:100")
    with pytest.raises(ConnectionError):
        robot.ask()
    robot.lost_state()
    assert robot.ask()["State.Mode"] == 4


def test_stall_on_either_channel(robot: Controller) -> None:
    robot.ask()
    robot.line("operator", "fault stall=state:0.4")
    begin = time.monotonic()
    robot.ask()
    assert 0.35 < time.monotonic() - begin < 2
    robot.line("operator", "fault stall=0.3")
    with robot.motion() as link:
        begin = time.monotonic()
        link.send(b"".join(move(robot.boot, 1, [HOME])))
        link.receive()
        assert 0.25 < time.monotonic() - begin < 2


def test_stalled_state_channel_starves_the_watchdog(robot: Controller) -> None:
    robot.line("operator", "speed 1")
    with robot.motion() as link:
        link.send(b"".join(move(robot.boot, 1, [HOME + STEP], 1.0)))
        link.receive()
        robot.ask()
        robot.line("operator", "fault stall=state:2.3")
        answer = robot.ask()
        assert (answer["State.Aborted"], answer["State.Reason"]) == (1, 10)


def test_answers_are_split_coalesced_and_padded(robot: Controller) -> None:
    for fault in ("split=7", "coalesce=3", "padding=5"):
        robot.line("operator", f"fault {fault}")
    assert robot.run(1, [HOME + STEP, HOME]) == [1, 2, 2, 3]
    assert same_place(angles(robot.ask()), HOME)
    with robot.motion() as link:
        link.send(b"".join(move(robot.boot, 2, [HOME])))
        first = link.sock.recv(1000)
        assert len(first) <= 7
        assert first.startswith(b"\0\r\n\0\r")


def test_restart_in_the_middle_of_a_move(robot: Controller) -> None:
    boot = robot.boot
    robot.line("operator", "speed 2")
    robot.line("operator", "fault restart-at=point:2")
    with robot.motion() as link:
        link.send(b"".join(move(boot, 1, [HOME + STEP, HOME, HOME + STEP], 5.0)))
        assert link.closed(10.0)
    robot.lost_state()
    while not (state := robot.try_ask()):
        time.sleep(0.05)
    assert (state["State.Boot"], state["State.Accepted"]) == (boot + 1, 0)
    share = ((angles(state) - HOME) / STEP).mean()
    assert 0.1 < share < 0.8
    assert robot.said(5)[-1] == (boot, 1, 1)


def test_faults_are_read_and_refused() -> None:
    assert parse_faults(["drop-after=12, stall=state:1.5", "restart-at=point:3,drop-after=state:sent:0"]) == [
        Fault("drop-after", "motion", 12.0),
        Fault("stall", "state", 1.5),
        Fault("restart-at", "motion", 3.0, point=True),
        Fault("drop-after", "state", 0.0, sent=True),
    ]
    for wrong in (
        "drop-after",
        "drop-after=",
        "drop-after=-1",
        "stall=nan",
        "overflow=all",
        "go=1",
        "restart-at=point:x",
    ):
        with pytest.raises(ControllerError, match="expected"):
            parse_faults([wrong])


def test_descriptors_and_queues_stay_after_many_clients(robot: Inside) -> None:
    for _ in range(300):
        with robot.motion() as link:
            link.send(move(robot.boot, 1, [HOME, HOME])[0])
    until = time.monotonic() + 5
    while robot.robot.motion.alive:
        assert time.monotonic() < until
        time.sleep(0.01)
    assert robot.robot.motion.fifos.stored == 0
    assert robot.run(1, [HOME]) == [1, 2, 3]
