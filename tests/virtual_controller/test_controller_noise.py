"""Noise that can be asked for again is that of the simulated campaigns."""

from __future__ import annotations

import numpy as np

from experiments.virtual_controller.noise import BLOCK, Noise
from experiments.virtual_robot.instrument import CORRELATION_TIME, torque_noise

STEP = 0.012


def correlation(rows: np.ndarray, lag: int) -> float:
    return float(np.mean(rows[:-lag] * rows[lag:]) / np.mean(rows**2))


def test_noise_is_correlated_as_in_simulated_logs() -> None:
    count = 60 * BLOCK
    mine = Noise((1, 2), 6, STEP).torque(list(range(count)))
    theirs = torque_noise(np.ones(6), count, STEP, np.random.default_rng(1))
    assert abs(mine.std() - 1.0) < 0.03
    for lag in (1, round(CORRELATION_TIME / STEP), 8 * round(CORRELATION_TIME / STEP)):
        assert abs(correlation(mine, lag) - correlation(theirs, lag)) < 0.04


def test_rows_are_the_same_in_any_order_and_blocks_fit() -> None:
    rows = list(range(5 * BLOCK))
    noise = Noise((3, 4), 6, STEP)
    whole = noise.torque(rows)
    again = Noise((3, 4), 6, STEP)
    order = np.random.default_rng(0).permutation(rows)[:2000]
    assert np.array_equal(again.torque([int(row) for row in order]), whole[order])
    slow = np.array([noise._block(row // BLOCK)[1][row % BLOCK] for row in rows])
    jump = np.abs(np.diff(slow, axis=0))
    at_edges = jump[BLOCK - 1 :: BLOCK]
    assert at_edges.max() < 1.5 * jump.max()
    assert not np.array_equal(Noise((3, 5), 6, STEP).torque(rows[:9]), whole[:9])
