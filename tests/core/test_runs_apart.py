"""Runs of one motion are independent if they have nothing in common beside what explains most."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from clampid.diagnosis.runs_apart import LACKS, lack_of_fit, with_runs_apart
from clampid.evidence.space import Space, space_of
from clampid.fitting.fit import fit
from clampid.fitting.solve import Estimate
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.stages.repeats import first_of_repeated
from experiments.campaign import Campaign

ROWS, RUNS, ABSORBED = 150, 6, 12
FIRST = np.tile(np.arange(ROWS), RUNS)


def left_by_a_fit(error: np.ndarray) -> Space:
    """What a fit of twelve smooth columns, the same in every run, leaves of an error ``(RUNS * ROWS,)``."""
    time = np.linspace(0.0, 1.0, ROWS)
    columns = np.tile(np.cos(np.pi * np.arange(ABSORBED) * time[:, None]), (RUNS, 1))
    basis = np.linalg.qr(columns)[0]
    residual = error - basis @ (basis.T @ error)
    return Space(residual, basis, FIRST, 1.0, len(error) - ABSORBED, len(error), np.zeros(0))


def test_independent_runs_lack_nothing() -> None:
    rng = np.random.default_rng(0)
    p = np.array([lack_of_fit(left_by_a_fit(rng.standard_normal(RUNS * ROWS)), FIRST) for _ in range(400)])
    assert 8 <= np.sum(p < LACKS) <= 34  # of a binomial of 400 and 0.05: outside with a chance of 0.2 %
    assert abs(np.mean(p) - 0.5) < 0.05


def test_what_every_run_has_in_common_is_a_lack() -> None:
    """It has a fifth of the noise's variance, and no smooth column describes it."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        common = np.sqrt(0.2) * rng.standard_normal(ROWS)
        assert lack_of_fit(left_by_a_fit(np.tile(common, RUNS) + rng.standard_normal(RUNS * ROWS)), FIRST) < 1e-3


def test_a_log_without_repeated_runs_keeps_its_units(simulated: Callable[..., Campaign]) -> None:
    whole = fitted(simulated(seed=3, poses=40, tables=("free_air", "wrist", "poses")))
    rows = whole.problem.rows
    repeated = first_of_repeated(rows.series.run, rows.constants.time, rows.signals["q"])
    estimate = fit(whole.problem.with_rows(rows.take(repeated == np.arange(len(rows)))))
    space = space_of(estimate)
    assert with_runs_apart(estimate, space, []) is space


@pytest.mark.parametrize("size", [0.0, 1.0])
def test_runs_that_share_an_error_stay_together(simulated: Callable[..., Campaign], size: float) -> None:
    """A log, and its torques again with other noise as a second run; then with an error of the motion in both."""
    estimate = fitted(simulated(seed=3, poses=40, tables=("free_air", "wrist", "poses")))
    rows, rng = estimate.problem.rows, np.random.default_rng(2)
    predicted = rows.measured - estimate.residual
    error = size * rng.standard_normal(predicted.shape)
    half = len(rows) // 2
    twice = np.r_[np.arange(half), np.arange(half)].astype(np.int64)
    both = rows.take(twice)
    later = np.repeat([0, 1], half)
    run = both.series.run + later * (rows.series.run.max() + 1)
    noise = rng.standard_normal(both.measured.shape) + error[twice]
    constants = replace(both.series, run=run, time=both.constants.time + later * 1e4)
    both = replace(both, measured=predicted[twice] + noise * rows.sigma[twice], constants=constants)
    repeated = fit(estimate.problem.with_rows(both))
    space = space_of(repeated)
    assert np.all(first_of_repeated(run, constants.time, both.signals["q"]) == twice)
    apart = with_runs_apart(repeated, space, [])
    if size:
        assert apart is space
    else:
        assert len(np.unique(apart.unit)) > 1.8 * len(np.unique(space.unit[: space.rows]))


def fitted(campaign: Campaign) -> Estimate:
    opened = on_campaign(identify(campaign), campaign)
    return opened.refit("free_air", opened.rows("free_air")).estimate
