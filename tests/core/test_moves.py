"""Moves between rests are recognised in samples that are too sparse for differences of neighbours."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.plans.motion import Course
from experiments.signals import accelerations, motion_of_moves

Array = npt.NDArray[np.float64]
STEP = 0.1  # s


def log(ways: Array, ramp: float, duration: float, offset: float, rest: float = 0.4) -> tuple[Array, ...]:
    """Moves by ``ways`` ``(m, n)``, rad, as plans drive them: positions, speeds, accelerations, stamps."""
    knots = np.concatenate([np.zeros((1, ways.shape[1])), np.cumsum(ways, axis=0)])
    course = Course(knots, np.full(len(ways), duration), np.full(len(ways), ramp), rest)
    time = offset + STEP * np.arange(int(course.length / STEP))
    return *course.at(time), time


@settings(deadline=None, max_examples=25)
@given(
    ramp=st.floats(0.15, 0.45),
    duration=st.floats(1.0, 3.0),
    offset=st.floats(0.0, 0.1),
    seed=st.integers(0, 1000),
)
def test_accelerations_of_a_trapezoid_sampled_two_or_three_times_a_ramp(
    ramp: float, duration: float, offset: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    q, qd, qdd, time = log(rng.uniform(-1.5, 1.5, (4, 6)), ramp, duration, offset)
    noise = 1e-6
    found = motion_of_moves(q + noise * rng.standard_normal(q.shape), time, np.ones(len(q), dtype=np.int64))
    known = np.isfinite(found.error)
    moving = np.abs(qd) > 0.05 * np.abs(qd).max()
    assert known[moving].mean() > 0.95
    assert np.all(np.abs(found.acceleration - qdd)[known] <= 6.0 * found.error[known])
    assert np.sqrt(np.mean((found.speed - qd)[known] ** 2)) < 1e-3
    neighbours = accelerations(q, time, np.ones(len(q), dtype=np.int64), 0.02)
    assert np.sqrt(np.mean((neighbours - qdd)[known] ** 2)) > 100 * np.median(found.error[known])


def test_a_slow_move_of_many_samples_is_recognised_among_quick_ones() -> None:
    q, qd, qdd, time = log(np.array([[1.0, -0.5]]), 0.25, 60.0, 0.03)
    quick, quick_speed, quick_acceleration, later = log(np.array([[0.8, 0.3]]), 0.25, 1.5, 0.03)
    both = np.r_[q, q[-1] + quick]
    noisy = both + 1e-6 * np.random.default_rng(4).standard_normal(both.shape)
    found = motion_of_moves(noisy, np.r_[time, time[-1] + STEP + later], np.ones(len(both), dtype=np.int64))
    known = np.isfinite(found.error)
    assert known[np.any(np.r_[qd, quick_speed] != 0.0, axis=1)].mean() > 0.99
    assert np.all(np.abs(found.acceleration - np.r_[qdd, quick_acceleration])[known] <= 6.0 * found.error[known])


@pytest.mark.parametrize("samples", [150, 300, 1500])
def test_a_sine_is_not_taken_for_moves(samples: int) -> None:
    time = STEP * np.arange(samples)
    q = np.sin(np.outer(time, [0.7, 0.9, 1.3]))
    assert np.all(np.isinf(motion_of_moves(q, time, np.ones(len(time), dtype=np.int64)).error))


@pytest.mark.parametrize("late", [0.05, 0.1])
def test_joints_that_do_not_move_in_step_are_not_taken_for_one_move(late: float) -> None:
    q, _, _, time = log(np.array([[1.0, 0.0], [0.7, 0.0]]), 0.25, 1.5, 0.03)
    other, _, _, _ = log(np.array([[0.0, 1.0], [0.0, 0.7]]), 0.25, 1.5, 0.03 - late)
    assert np.all(np.isinf(motion_of_moves(q + other, time, np.ones(len(time), dtype=np.int64)).error))


def test_a_log_that_stands_still_has_no_moves() -> None:
    found = motion_of_moves(np.zeros((30, 6), dtype=np.float64), STEP * np.arange(30), np.ones(30, dtype=np.int64))
    assert np.all(np.isinf(found.error))
    assert not found.acceleration.any()


def test_a_move_does_not_go_on_in_the_next_run() -> None:
    q, _, qdd, time = log(np.array([[1.0, -0.5], [0.4, 0.9]]), 0.3, 1.2, 0.02)
    run = np.where(np.arange(len(q)) < len(q) // 4, 1, 2).astype(np.int64)  # cut in the middle of the first move
    found = motion_of_moves(q, time, run)
    known = np.isfinite(found.error)
    assert np.all(np.abs(found.acceleration - qdd)[known] <= 1e-6 + 6.0 * found.error[known])


def test_a_sample_beside_a_change_of_acceleration_has_its_step_as_error() -> None:
    ramp, rest = 0.2, 0.4
    q, _, qdd, time = log(np.array([[1.0, -0.5, 0.8]]), ramp, 1.2, 0.0, rest)  # samples where ramps begin and end
    q = q + 1e-6 * np.random.default_rng(2).standard_normal(q.shape)
    found = motion_of_moves(q, time, np.ones(len(q), dtype=np.int64))
    change = int(np.argmin(np.abs(time - (rest + ramp))))
    assert found.error[change, 0] > 0.9 * np.abs(qdd).max()
    assert found.error[change + 2, 0] < 1e-3


def test_a_log_of_one_row_has_no_moves() -> None:
    found = motion_of_moves(np.zeros((1, 6), dtype=np.float64), np.zeros(1), np.ones(1, dtype=np.int64))
    assert np.all(np.isinf(found.error))
