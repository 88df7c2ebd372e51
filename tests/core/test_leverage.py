"""Rows of large leverage: what their residuals hide, and that a wrong one is found, whole or in pieces."""

from __future__ import annotations

from pathlib import Path
from shutil import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clampid.fitting.leverage import root_of_inverse, share_left
from clampid.identification.identify import identify
from clampid.identification.identify_folder import identify_folder
from experiments.campaign import Campaign, read_campaign, write_campaign
from experiments.second_world import draw_robot, measure

SEED = 2320
SPOILT = 1507
"""A row at the end of a ramp of 0.4 s that is sampled every 0.1 s: its acceleration is wrong by metres a second
squared, and it alone decides an inertia."""


@given(st.integers(0, 10_000), st.floats(0.0, 10.0))
@settings(max_examples=60, deadline=None)
def test_share_left_leads_to_the_residual_without_the_row(seed: int, prior: float) -> None:
    rng = np.random.default_rng(seed)
    X, y = rng.standard_normal((12, 4)) * 10.0 ** rng.uniform(-3, 3, 4), rng.standard_normal(12)
    precision = prior * np.diag(np.sum(X**2, axis=0)) / 12

    def fitted(keep: np.ndarray) -> np.ndarray:
        A = X[keep].T @ X[keep] + precision
        return np.linalg.solve(A, X[keep].T @ y[keep])

    every = np.ones(12, dtype=bool)
    share = share_left(X, root_of_inverse(X.T @ X + precision))
    for row in range(12):
        without = every.copy()
        without[row] = False
        foreseen = y[row] - X[row] @ fitted(without)
        left = y[row] - X[row] @ fitted(every)
        assert left == pytest.approx(share[row] ** 2 * foreseen, rel=1e-6, abs=1e-9)


def test_directions_that_no_row_shows_have_no_leverage() -> None:
    X = np.array([[1.0, 0.0, 2.0], [2.0, 0.0, 4.0], [1.0, 0.0, 2.0]])
    share = share_left(X, root_of_inverse(X.T @ X))
    np.testing.assert_allclose(share**2, [1 - 1 / 6, 1 - 4 / 6, 1 - 1 / 6], atol=1e-9)


@pytest.fixture(scope="module")
def ramps(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """A log at 10 Hz of ramps of 0.4 s, of a robot of the second virtual world."""
    folder = tmp_path_factory.mktemp("ramps") / "arm"
    robot = draw_robot("uncoupled6", SEED, mounting="floor")
    measure(robot, folder, tables=("free_air",), log="trapezoids_10hz", noise="white", seed=SEED)
    return read_campaign(folder)


@pytest.mark.slow
@pytest.mark.usefixtures("of_another_shape")
def test_a_wrong_row_of_large_leverage_is_rejected(ramps: Campaign, tmp_path: Path) -> None:
    """It was kept: its residual was one standard deviation, and without it the fit mispredicts it by a hundred."""
    whole = identify(ramps)
    stage = whole.stages["free_air"]
    assert SPOILT in [row for _, _, row in stage.outliers]
    assert len(stage.outliers) <= 5  # of 2 036
    assert whole.ledger[-1].heldout_rms < 1.2
    assert ramps.path is not None
    copy(ramps.path / "robot.urdf", tmp_path)
    header = {**ramps.header, "robot": "../robot.urdf"}
    pieces = identify_folder(write_campaign(tmp_path / "arm", header, {"free_air": ramps.tables["free_air"]}))
    assert pieces.stages["free_air"].outliers == stage.outliers
