"""The state machine of programs: only what the controller says moves one on."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from experiments.links.programs import Programs
from experiments.links.protocol import (
    InterruptedProgramError,
    LinkLostError,
    NotExecutedError,
    Phase,
    Program,
    RefusedError,
    Status,
    UnknownFateError,
)

STANDING = Status(np.zeros(6), boot=7, accepted=4, running=0, finished=4, aborted=2, mode="EXT", drives=True)


def now(**changes: object) -> Status:
    return replace(STANDING, received=time.monotonic(), **changes)


def begun(patience: float = 10.0) -> tuple[Programs, int]:
    programs = Programs(patience)
    programs.seen(now())
    return programs, programs.begin(now(), 3).id


def test_a_number_is_new_to_the_controller_and_to_the_link() -> None:
    programs, number = begun()
    assert number == 5
    programs.not_sent(5, "no")
    assert programs.begin(now(), 1).id == 6
    programs.seen(now(accepted=6, finished=6))
    assert programs.begin(now(accepted=20), 1).id == 21


def test_the_usual_way() -> None:
    programs, number = begun()
    assert programs.fate(number).phase is Phase.SENT
    programs.accepted(7, number)
    programs.reached(7, number, 1)
    assert (programs.fate(number).phase, programs.fate(number).point) == (Phase.RUNNING, 1)
    programs.ended(7, number, Phase.FINISHED, 3, "")
    programs.seen(now(accepted=5, running=5, point=2))  # this status was on its way
    assert programs.fate(number).phase is Phase.RUNNING
    programs.seen(now(accepted=5, finished=5, point=3))  # with the posture at rest
    assert programs.wait(number, 0).point == 3
    assert programs.question is None


def test_what_an_event_says_counts_alone_where_no_status_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("experiments.links.programs.CONFIRMED", 0.01)
    for phase, boot in ((Phase.FINISHED, None), (Phase.INTERRUPTED, None), (Phase.FINISHED, 8)):
        programs, number = begun()
        programs.ended(7, number, phase, 3, "why")
        assert not programs.fate(number).phase.final
        if boot is None:
            time.sleep(0.02)
            programs.tick()
        else:
            programs.seen(now(boot=boot))
        assert (programs.fate(number).phase, programs.fate(number).point) == (phase, 3)


def test_a_status_alone_moves_it_on_as_well() -> None:
    programs, number = begun()
    programs.seen(now(accepted=5, running=5, point=1))
    assert programs.fate(number).phase is Phase.RUNNING
    programs.seen(now(accepted=5, finished=5, point=3))
    assert programs.fate(number).phase is Phase.FINISHED


def test_silence_is_no_evidence() -> None:
    programs, number = begun(0.05)
    programs.seen(now())
    assert programs.fate(number).phase is Phase.SENT  # the controller may still take it up
    programs.tick()
    assert programs.fate(number).phase is Phase.SENT
    time.sleep(0.06)
    programs.tick()
    with pytest.raises(UnknownFateError, match="its fate is unknown"):
        programs.wait(number, 0)
    assert "look at the robot" in str(programs.question)


def test_only_a_status_after_the_fence_says_not_executed() -> None:
    programs, number = begun()
    programs.fenced(number, now())
    with pytest.raises(NotExecutedError):
        programs.wait(number, 0)
    with pytest.raises(RefusedError, match="a person has to look"):
        programs.begin(now(), 1)
    programs.confirm()
    assert programs.begin(now(), 1).id == number + 1


def test_a_fence_does_not_undo_an_acceptance() -> None:
    programs, number = begun()
    programs.accepted(7, number)
    programs.fenced(number, now())
    assert programs.fate(number).phase is Phase.RUNNING
    programs.ended(7, number, Phase.REFUSED, 0, "another one is running")
    assert programs.fate(number).phase is Phase.RUNNING


def test_another_boot_makes_it_unknown_and_asks_a_person() -> None:
    programs, number = begun()
    programs.accepted(7, number)
    programs.seen(now(boot=8, accepted=0, finished=0, aborted=0))
    with pytest.raises(UnknownFateError, match="started again"):
        programs.wait(number, 0)
    assert programs.question is not None


def test_another_boot_without_a_program_asks_a_person_too() -> None:
    programs = Programs(10.0)
    programs.seen(now())
    programs.seen(now(boot=8))
    with pytest.raises(RefusedError, match="started again"):
        programs.begin(now(boot=8), 1)
    programs.confirm()
    assert programs.begin(now(boot=8), 1)


def test_events_of_another_boot_or_number_are_not_believed() -> None:
    programs, number = begun()
    programs.accepted(6, number)
    programs.accepted(7, number + 1)
    programs.ended(6, number, Phase.FINISHED, 3, "")
    programs.ended(7, number - 1, Phase.FINISHED, 3, "")
    assert programs.fate(number).phase is Phase.SENT


def test_an_abort_tells_the_point_and_the_reason() -> None:
    programs, number = begun()
    programs.reached(7, number, 2)
    programs.ended(7, number, Phase.INTERRUPTED, 2, "emergency stop")
    programs.seen(now(accepted=5, aborted=5, point=2, reason="emergency stop"))
    with pytest.raises(InterruptedProgramError, match="program 5: interrupted after point 2: emergency stop"):
        programs.wait(number, 0)


def test_a_later_program_of_another_client_makes_it_unknown() -> None:
    programs, number = begun()
    programs.seen(now(accepted=9, finished=9))
    assert programs.fate(number).phase is Phase.UNKNOWN


def test_a_program_of_another_client_that_runs_at_the_start_asks_a_person() -> None:
    programs = Programs(10.0)
    programs.seen(now(running=5, accepted=5))
    programs.seen(now(accepted=5, finished=5))
    with pytest.raises(RefusedError, match="program 5 of another client"):
        programs.begin(now(accepted=5), 1)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"stopped": True}, "stopped, and not released"),
        ({"estop": True}, "emergency stop"),
        ({"running": 9}, "program 9 is running"),
        ({"mode": "T1"}, "operating mode is T1"),
        ({"drives": False}, "drives are off"),
    ],
)
def test_what_the_controller_would_refuse_is_not_sent(changes: dict[str, object], why: str) -> None:
    with pytest.raises(RefusedError, match=why):
        Programs(10.0).begin(now(**changes), 1)


def test_an_old_status_is_not_moved_by() -> None:
    with pytest.raises(LinkLostError, match="too old"):
        Programs(10.0).begin(replace(STANDING, received=time.monotonic() - 1.0), 1)


def test_two_at_once_are_not_taken() -> None:
    programs, number = begun()
    with pytest.raises(RefusedError, match="program 5 is on its way"):
        programs.begin(now(), 1)
    with pytest.raises(RefusedError, match="nothing to confirm yet"):
        programs.confirm()
    assert programs.fate(number).phase is Phase.SENT


def test_wait_ends_when_it_ends_and_says_when_it_does_not() -> None:
    programs, number = begun()
    with pytest.raises(LinkLostError, match=r"still sent after 0\.01 s"):
        programs.wait(number, 0.01)
    threading.Timer(0.02, programs.seen, (now(accepted=5, finished=5),)).start()
    assert programs.wait(number, 5.0).phase is Phase.FINISHED
    with pytest.raises(RefusedError, match="has sent none"):
        programs.fate(99)


@pytest.mark.parametrize(
    ("postures", "speed"), [([[np.nan] * 6], 0.1), (np.zeros((0, 6)), 0.1), ([[0.0] * 6], 0.0), ([[0.0] * 6], 1.1)]
)
def test_a_program_that_is_none(postures: object, speed: float) -> None:
    with pytest.raises(RefusedError, match="program: expected"):
        Program(postures, speed)
