"""Trapezoidal moves: within limits, as fast as they can be, and continuous."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.plans import Cell, Course, Limits, PlanError, limits_of
from experiments.plans.limits import course_of, motion_faults
from experiments.plans.motion import peak_rates, shortest

seeds = st.integers(0, 10_000)


@given(seeds, st.floats(0.01, 1.0))
@settings(max_examples=40, deadline=None)
def test_moves_keep_speed_and_acceleration_and_one_of_them_is_reached(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    travel = rng.uniform(-3, 3, (5, 6)) * rng.choice([1e-3, 1.0], (5, 1))
    speed, acceleration = share * rng.uniform(0.5, 8, 6), rng.uniform(0.5, 20, 6)
    duration, ramp = shortest(travel, speed, acceleration)
    top, gain = peak_rates(travel, duration, ramp)
    assert np.all(top <= speed * (1 + 1e-9))
    assert np.all(gain <= acceleration * (1 + 1e-9))
    assert np.all(2 * ramp <= duration * (1 + 1e-12))
    used = np.maximum((top / speed).max(axis=1), (gain / acceleration).max(axis=1))
    assert np.all((used > 1 - 1e-9) | (duration <= 0.1 + 1e-12))


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_positions_integrate_speeds_and_speeds_accelerations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    knots = rng.uniform(-2, 2, (4, 6))
    duration, ramp = shortest(np.diff(knots, axis=0), np.full(6, 1.0), np.full(6, 2.0))
    course = Course(knots, duration, ramp, 0.5)
    time = np.linspace(0.0, course.length, 20_001)
    q, qd, qdd = course.at(time)
    step = time[1]
    assert np.allclose(np.cumsum((qd[1:] + qd[:-1]) / 2 * step, axis=0), q[1:] - q[0], atol=1e-3)
    assert np.allclose(np.cumsum((qdd[1:] + qdd[:-1]) / 2 * step, axis=0), qd[1:], atol=1e-2)
    for k, knot in enumerate(knots):
        there = 0.25 + (course.starts[k - 1] + duration[k - 1] if k else 0.0)
        assert np.allclose(course.at(np.array([there]))[0], knot, atol=1e-12)
    assert np.allclose(course.length, duration.sum() + 4 * 0.5)


@given(seeds, st.floats(0.02, 1.0))
@settings(max_examples=20, deadline=None)
def test_a_course_is_never_refused_by_the_limits_it_was_made_for(
    cell: Cell, limits: Limits, seed: int, share: float
) -> None:
    rng = np.random.default_rng(seed)
    knots = rng.uniform(limits.lower, limits.upper, (6, 6))
    course = course_of(cell.robot, limits, knots, speed_share=share)
    assert motion_faults(cell.robot, limits, course) is None
    motors = course.at(np.linspace(0, course.length, 500))[1] @ np.linalg.inv(np.asarray(cell.robot.transmission))
    assert np.all(np.abs(motors) <= limits.speed / np.abs(np.diag(cell.robot.transmission)) * (1 + 1e-9))


def test_what_is_too_fast_or_out_of_range_is_named(cell: Cell, limits: Limits) -> None:
    knots = np.zeros((2, 6))
    knots[1, 2] = 2.5
    good = course_of(cell.robot, limits, knots)
    hasty = Course(knots, good.duration * 0.9, good.ramp * 0.9, 1.0)
    assert "move 1: joint 3: expected at most 3.31613 rad/s" in str(motion_faults(cell.robot, limits, hasty))
    jerky = Course(knots, good.duration, good.duration * 0.7, 1.0)
    assert "expected a ramp above 0 s and at most half" in str(motion_faults(cell.robot, limits, jerky))
    far = Course(knots * 4, good.duration * 9, good.ramp, 1.0)
    assert "stop 1: joint 3: expected" in str(motion_faults(cell.robot, limits, far))


def test_limits_that_allow_nothing_are_refused(cell: Cell) -> None:
    with pytest.raises(PlanError, match="share of the joint ranges: expected above 0"):
        limits_of(cell.robot, share=0.0)
    with pytest.raises(PlanError, match="acceleration: expected numbers above 0"):
        limits_of(cell.robot, acceleration=-1.0)
