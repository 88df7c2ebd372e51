"""A real log of motor currents: its last fifth is predicted by what the first four fifths say.

The study itself is benchmarks/tx40.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tx40


def test_currents_of_a_real_robot_are_predicted(shared_folder: Path):
    log = tx40.read(shared_folder / "real" / "tx40_current_log")
    _, chosen = tx40.judged(log)
    unseen = ~log.fitted
    assert unseen.sum() == pytest.approx(0.2 * len(unseen), rel=0.01)
    assert np.all(tx40.r_squared(log.smooth[unseen], chosen.predicted[unseen]) > tx40.BAR)


def test_mean_of_laws_is_the_mean_of_what_they_predict_left_out():
    rng = np.random.default_rng(0)
    currents, fitted = rng.normal(size=(40, 2)), np.arange(40) < 30
    log = tx40.Log(currents, currents, rng.normal(size=(40, 2, 1)), None, fitted)
    off = [
        tx40.Result("", np.zeros(tx40.BLOCKS), currents + shift, np.where(fitted[:, None], currents + shift, 0.0))
        for shift in (0.3, -0.1)
    ]
    mean = tx40.averaged(log, "", off)
    np.testing.assert_allclose(mean.predicted - currents, 0.1)
    scale = currents[fitted].std(axis=0)
    np.testing.assert_allclose(mean.blocks, np.mean((0.1 / scale) ** 2))
