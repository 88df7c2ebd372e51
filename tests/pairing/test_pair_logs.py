"""Pairs of two logs with unknown clocks, against a generator that knows the truth."""

from __future__ import annotations

import log_maker
import numpy as np
import pytest

from experiments.pairing import Pairing, pair_logs


def judged(logs: log_maker.Logs, found: Pairing) -> tuple[set[int], int]:
    """True stops that were found, and how many pairs are false."""
    right, false = set(), 0
    for pair in found.pairs:
        inside = np.flatnonzero((logs.stops[:, 0] <= pair.time_s) & (pair.time_s <= logs.stops[:, 1]))
        same = len(inside) == 1 and np.abs(pair.joints - logs.postures[inside[0]]).max() < 2e-5
        if same and int(inside[0]) not in right:
            right.add(int(inside[0]))
        else:
            false += 1
    return right, false


def check(logs: log_maker.Logs, noise: float) -> None:
    found = pair_logs(logs.time, logs.points, logs.robot_time, logs.joints)
    right, false = judged(logs, found)
    assert false == 0
    missing = set(np.flatnonzero(logs.seen).tolist()) - right
    assert not missing, f"{sorted(missing)}: {found.left_out}"
    assert not right & set(np.flatnonzero(logs.unseen).tolist())
    clock = found.clock
    truth = logs.offset + logs.drift * clock.middle_s
    assert abs(clock.offset_s - truth) < 4 * clock.offset_std_s < 0.4
    assert abs(clock.drift - logs.drift) < 5 * clock.drift_std
    for pair in found.pairs:
        k = int(np.argmin(np.abs(logs.stops.mean(axis=1) - pair.time_s)))
        # A median of m samples scatters by 1.25 sigma / sqrt(m); 6 of these in some thousand numbers.
        limit = 6 * 1.2533 * noise / np.sqrt(len(pair.rows))
        assert np.abs(pair.point - logs.true_points[k]).max() < limit
    assert np.median([pair.scatter for pair in found.pairs]) == pytest.approx(noise, rel=0.1)


def test_all_pairs_of_400_poses() -> None:
    check(log_maker.make_logs(1, rate=250.0), 20e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 14))
def test_all_pairs_of_400_poses_seeds(seed: int) -> None:
    check(log_maker.make_logs(seed, lost=0.15), 20e-6)


def test_cycles_that_repeat_exactly_are_ambiguous_until_an_offset_is_given() -> None:
    rng = np.random.default_rng(4)
    # Stops of 3 s every 5 s, between two postures in turn; the instrument began two cycles late.
    knots = np.cumsum(np.r_[0.0, np.tile([3.0, 2.0], 60)])
    angle = np.r_[0.0, np.repeat(np.arange(60) % 2, 2)[1:], 0.0]

    def log(start: float, step: float, noise: float, count: int) -> tuple[np.ndarray, np.ndarray]:
        t = np.arange(start, knots[-2], step)
        return t, np.interp(t, knots, angle)[:, None] * np.ones(count) + noise * rng.standard_normal((len(t), count))

    time, points = log(11.0, 0.01, 2e-5, 3)
    robot_time, joints = log(0.05, 0.1, 2e-6, 6)
    with pytest.raises(ValueError, match=r"expected one offset of the clocks, found .* and .*state it as offset"):
        pair_logs(time, points, robot_time + 100.0, joints)
    found = pair_logs(time, points, robot_time + 100.0, joints, near_s=101.0)
    assert found.clock.offset_s == pytest.approx(100.0, abs=0.15)
