"""Noise is not called motion, and motion is not called noise."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.instruments.still import MIN_READINGS, moved_by, summary


@pytest.mark.parametrize("noise", [6e-5, 1e-6, 0.0])
def test_a_resting_target_is_still(noise: float) -> None:
    rng = np.random.default_rng(3)
    assert not any(moved_by(rng.normal(0, noise, (MIN_READINGS, 3))) for _ in range(2000))


def test_motion_beyond_the_noise_is_found() -> None:
    rng = np.random.default_rng(4)
    way = 4 * 6e-5 * np.linspace(0, 1, MIN_READINGS)[:, None] * [0, 0, 1]
    found = np.mean([moved_by(rng.normal(0, 6e-5, (MIN_READINGS, 3)) + way) > 0 for _ in range(300)])
    assert found > 0.95


def test_single_wild_readings_change_little() -> None:
    rng = np.random.default_rng(5)
    readings = rng.normal(0, 2e-5, (200, 3))
    readings[::20] += 0.1
    median, scatter = summary(readings)
    assert np.abs(median).max() < 1e-5
    assert scatter == pytest.approx([2e-5] * 3, rel=0.3)
    assert moved_by(readings) == 0.0
