"""The link is cut at every byte of a command and of its reply: each motion once, or not at all; and the link knows."""

from __future__ import annotations

import contextlib
import time
from collections import Counter

import numpy as np
import pytest
from fake_controller import FakeController

from experiments.links.eki import EkiLink
from experiments.links.eki_motion import documents_of
from experiments.links.protocol import LinkError, Phase, Program

HOME = np.radians([0.0, -90.0, 90.0, 0.0, 45.0, 0.0])


def program(points: int) -> Program:
    return Program(np.tile(HOME, (points, 1)), 0.2)


def cut_each(controller: FakeController, link: EkiLink, channel: str, side: str, bytes_: range, points: int) -> Counter:
    """Send a program for each byte, with the cut there; what became of it by what the controller did."""
    found: Counter[tuple[Phase, int]] = Counter()
    faulty = getattr(controller, channel)
    for at in bytes_:
        end = time.monotonic() + 10.0
        while True:
            assert time.monotonic() < end
            if link.open_question() is not None:
                link.confirm()
            with controller.lock:
                faulty.taken = faulty.given = 0
                setattr(faulty, side, at)
                before = controller.begun
            try:
                number = link.execute(program(points))
                break
            except LinkError:
                with controller.lock:
                    faulty.cut_in = faulty.cut_out = None
                time.sleep(0.002)
        with contextlib.suppress(LinkError):
            link.wait(number, 10.0)
        with controller.lock:
            faulty.cut_in = faulty.cut_out = None
            found[link.fate(number).phase, controller.begun - before] += 1
    assert set(controller.executed.values()) <= {1}, "a program was executed twice"
    return found


def test_cut_at_every_byte_of_a_command(controller: FakeController, link: EkiLink) -> None:
    length = len(documents_of(program(2), 7, 100))
    found = cut_each(controller, link, "motion", "cut_in", range(1, length + 1), 2)
    assert set(found) == {(Phase.NOT_EXECUTED, 0), (Phase.FINISHED, 1)}
    assert found[Phase.NOT_EXECUTED, 0] >= length - 8  # the last bytes: numbers of three digits come with the cuts
    assert found[Phase.FINISHED, 1] >= 1


@pytest.mark.slow
def test_cut_at_every_byte_of_its_reply(controller: FakeController, link: EkiLink) -> None:
    found = cut_each(controller, link, "motion", "cut_out", range(1, 430), 2)
    # Where the next program went out before the link had noticed the cut of the last one, it was not executed.
    assert set(found) <= {(Phase.FINISHED, 1), (Phase.NOT_EXECUTED, 0)}
    assert found[Phase.FINISHED, 1] > 400


@pytest.mark.parametrize("side", ["cut_in", pytest.param("cut_out", marks=pytest.mark.slow)])
def test_cut_at_every_byte_of_the_state_channel(controller: FakeController, link: EkiLink, side: str) -> None:
    controller.point_s = 0.01
    found = cut_each(controller, link, "state", side, range(1, 75 if side == "cut_in" else 2100), 1)
    assert set(found) == {(Phase.FINISHED, 1)}
