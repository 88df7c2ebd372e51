"""Whether a robot turns, by two statuses."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.links.turning import Turning
from experiments.links.values import Status


def seen(turning: Turning, clock: float, joint: float, boot: int = 1) -> bool | None:
    return turning.seen(Status(np.array([0.0, joint]), boot=boot, clock=clock)).moves


def test_it_turns_while_it_brakes_and_stands_then() -> None:
    turning, found = Turning(), []
    for k, joint in enumerate((0.0, 0.02, 0.03, 0.035, 0.035, 0.035)):
        found.append(seen(turning, 0.02 * k, joint))
    assert found == [None, True, True, True, False, False]


def test_what_comes_too_soon_is_not_judged_by_its_noise() -> None:
    turning = Turning()
    seen(turning, 0.0, 0.0)
    assert seen(turning, 0.02, 1e-5) is False
    assert seen(turning, 0.021, 4e-5) is False  # 30 mrad/s over a millisecond, of an encoder that flickers
    assert seen(turning, 0.04, 3e-5) is False


@pytest.mark.parametrize(("clock", "boot"), [(0.04, 2), (0.01, 1)])
def test_after_a_restart_it_is_not_known(clock: float, boot: int) -> None:
    turning = Turning()
    seen(turning, 0.0, 0.0)
    assert seen(turning, 0.02, 0.5) is True
    assert seen(turning, clock, 0.9, boot) is None


def test_without_a_clock_the_time_of_arrival_counts() -> None:
    turning = Turning()
    assert turning.seen(Status(np.zeros(6), received=1.0)).moves is None
    assert turning.seen(Status(np.full(6, 0.01), received=1.1)).moves is True
    assert turning.seen(Status(np.full(6, 0.01), received=1.2)).moves is False
