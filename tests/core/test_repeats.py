"""Runs that repeat a motion: their stretches are one unit of evidence."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clampid.stages.repeats import with_repeats

BLOCK_S = 2.0


def log(programs: list[int], step: float = 0.1, late: float = 0.0) -> tuple[np.ndarray, ...]:
    """Unit, run, time and angles of runs of 10 s, each of one of some programs and later than the last by ``late``."""
    units, runs, times, angles = [], [], [], []
    for number, program in enumerate(programs):
        t = np.arange(0.0, 10.0, step)
        moved = np.random.default_rng(program).uniform(-1.0, 1.0, (2, 3))
        q = moved[0] * np.sin(t + late * number)[:, None] + moved[1] * np.cos(0.7 * (t + late * number))[:, None]
        units.append(np.floor(t / BLOCK_S).astype(np.int64) + 100 * number)
        runs.append(np.full(len(t), number))
        times.append(t + 37.0 * number)
        angles.append(q)
    return tuple(map(np.concatenate, (units, runs, times, angles)))


@given(st.lists(st.integers(0, 3), min_size=1, max_size=6))
@settings(max_examples=50, deadline=None)
def test_runs_of_one_program_share_the_units_of_the_first(programs: list[int]) -> None:
    unit, run, time, q = log(programs)
    found = with_repeats(unit, run, time, q)
    for number, program in enumerate(programs):
        first = programs.index(program)
        np.testing.assert_array_equal(found[run == number], unit[run == first])


@pytest.mark.parametrize(("late", "alike"), [(0.004, True), (0.3, False)])
def test_a_program_repeats_within_milliseconds(late: float, alike: bool) -> None:
    unit, run, time, q = log([1, 1], late=late)
    found = with_repeats(unit, run, time, q)
    assert np.array_equal(found[run == 1], unit[run == 0]) == alike
    if not alike:
        np.testing.assert_array_equal(found, unit)


def test_a_run_sampled_otherwise_is_the_same_motion() -> None:
    unit, run, time, q = log([2])
    more, _, faster, finer = log([2], step=0.05)
    both = with_repeats(
        np.r_[unit, more + 100], np.r_[run, np.ones_like(more)], np.r_[time, faster + 60.0], np.vstack([q, finer])
    )
    np.testing.assert_array_equal(both[len(unit) :][::2], unit)


def test_runs_of_a_resting_arm_are_not_said_to_repeat() -> None:
    unit, run = np.arange(10), np.repeat([0, 1], 5)
    found = with_repeats(unit, run, np.arange(10.0), np.zeros((10, 3)))
    np.testing.assert_array_equal(found, unit)
