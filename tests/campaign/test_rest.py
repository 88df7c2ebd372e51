"""The threshold of rest: six standard deviations of the speed's noise, however long a joint rests."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.signals import carried_sign, rest_threshold, speed_counts, speeds, threshold_of_counts

NOISE = 3e-5  # rad/s


def mostly_resting(share: float, rows: int = 40_000, seed: int = 0) -> np.ndarray:
    """Speeds ``(rows, 1)`` of a joint that rests for the given share, then moves at up to 1 rad/s."""
    rest = int(share * rows)
    motion = np.sin(np.linspace(0.0, 60.0, rows - rest))
    return (np.r_[np.zeros(rest), motion] + NOISE * np.random.default_rng(seed).standard_normal(rows))[:, None]


@pytest.mark.parametrize("share", [0.05, 0.2, 0.5, 0.9, 0.99])
def test_the_threshold_is_six_sigma_of_the_noise_whatever_the_share_of_rest(share: float) -> None:
    assert rest_threshold(mostly_resting(share))[0] == pytest.approx(6.0 * NOISE, rel=0.05)


def test_a_joint_that_never_rests_gets_two_per_cent_of_its_top_speed() -> None:
    speed = mostly_resting(0.0)
    assert rest_threshold(speed)[0] == pytest.approx(0.02 * np.abs(speed).max(), rel=1e-9)


def test_carried_signs_do_not_flip_at_rest() -> None:
    speed, time = np.flipud(mostly_resting(0.9)), 0.004 * np.arange(40_000)  # moves first, then rests
    position = np.cumsum(speed, axis=0) * 0.004
    sign = carried_sign(speed, rest_threshold(speed), np.zeros(len(speed), dtype=np.int64), position, time)
    assert len(np.unique(sign[-36_000:])) == 1


@pytest.mark.parametrize("step", [0.002, 0.012, 0.1])
def test_the_last_motion_is_not_what_a_smoothed_speed_overshoots_to(step: float) -> None:
    time = np.arange(0.0, 20.0, step)
    way = np.interp(time, [0.0, 3.0, 4.0, 8.0, 9.0, 13.0, 14.0, 20.0], [0.0, 0.0, 1.0, 1.0, -1.0, -1.0, 0.5, 0.5])
    counts = np.round(way / 1e-6 + 0.4 * np.random.default_rng(2).standard_normal(len(time))) * 1e-6  # an encoder's
    position, run = counts[:, None], np.zeros(len(time), dtype=np.int64)
    speed = speeds(position, time, run, max(0.02, 5 * step), step)
    sign = carried_sign(speed, rest_threshold(speed), run, position, time)[:, 0]
    margin = 2 * step
    for begin, end, moved in ((0.0, 3.0, 0), (3.0, 8.0, 1), (8.0, 13.0, -1), (13.0, 20.0, 1)):
        inside = (time > begin + margin) & (time < end - margin)
        assert set(sign[inside]) == {moved}
    assert (np.sign(speed[(time > 4.0) & (time < 8.0), 0]) < 0).any()  # or there was nothing to withstand


def test_an_encoder_that_seldom_moves_by_one_count_is_at_rest() -> None:
    rows, count = 20_000, 1e-5
    time = np.arange(rows) * 0.004
    q = count * (np.random.default_rng(1).random(rows) < 0.01)
    q[-4000:] += 1.0 - np.cos(np.linspace(0.0, 2.0 * np.pi, 4000))
    run = np.zeros(rows, dtype=np.int64)
    qd = speeds(q[:, None], time, run, 0.02)
    flicker = np.abs(qd[100:15_000]).max()
    assert flicker > 0.0
    assert rest_threshold(qd)[0] > flicker


def test_counts_of_parts_add_up_to_those_of_the_whole() -> None:
    speed = mostly_resting(0.7)
    parts = sum(speed_counts(part) for part in np.array_split(speed, 7))
    top = np.abs(speed).max(axis=0)
    np.testing.assert_array_equal(threshold_of_counts(np.asarray(parts), top), rest_threshold(speed))
