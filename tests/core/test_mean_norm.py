"""The universal model's cost: where it is least, its standard errors, and how it differs from least squares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.fitting.fit import fit
from clampid.fitting.mean_norm import CURVATURE_OF_NORM, compared, mean_norm
from clampid.fitting.noise import Noise
from clampid.fitting.solve import Estimate, FitError, solve
from clampid.identification.fitted_stage import active_slots
from clampid.identification.identify import identify, stage_rows
from clampid.slots import Term
from clampid.stages.fit_problem import fit_problem
from clampid.stages.layout import layout_of
from experiments.campaign import Campaign

Simulated = Callable[..., Campaign]
SIGMA = 5e-5


@pytest.fixture(scope="module")
def arm(simulated: Simulated) -> Campaign:
    return simulated(seed=1, poses=60, tables=("poses", "verification"), robot="kuka_kr16_2")


@pytest.fixture(scope="module")
def clean(arm: Campaign) -> Estimate:
    """Geometry fitted to points that are exactly where that geometry has them."""
    rows = stage_rows([arm], layout_of([arm]), "poses")
    effects = catalogue()
    first = fit(fit_problem(rows, effects, active_slots(rows, effects, [Term("geometry")])))
    exact = replace(rows, measured=rows.measured - first.problem.residual(first.theta)[0])
    return replace(first, problem=first.problem.with_rows(exact))


def refitted(clean: Estimate, noise: np.ndarray) -> Estimate:
    rows = clean.problem.rows
    noisy = clean.problem.with_rows(replace(rows, measured=rows.measured + noise))
    return fit(noisy, start=clean.values(), reject=False)


def norms(estimate: Estimate, theta: np.ndarray) -> np.ndarray:
    return np.linalg.norm(estimate.problem.residual(theta)[0][:, :3], axis=1)


def test_no_other_geometry_has_a_smaller_mean_norm(clean: Estimate) -> None:
    rng = np.random.default_rng(0)
    squares = refitted(clean, SIGMA * rng.standard_normal(clean.problem.rows.measured.shape))
    found = mean_norm(squares)
    least = norms(found, found.theta).mean()
    assert least < norms(squares, squares.theta).mean()
    for scale in (1e-3, 1e-2, 0.1):
        for _ in range(20):
            moved = found.theta + scale * found.std * rng.standard_normal(len(found.theta))
            assert norms(found, moved).mean() > least - 1e-6 * SIGMA


def test_slsqp_ends_where_reweighted_least_squares_does(clean: Estimate) -> None:
    """Weiszfeld's way to the same minimum: weights 1/|e|, again and again."""
    rng = np.random.default_rng(1)
    squares = refitted(clean, SIGMA * rng.standard_normal(clean.problem.rows.measured.shape))
    found = mean_norm(squares)
    kappa = CURVATURE_OF_NORM * np.sqrt(np.mean(squares.residual[:, :3] ** 2))
    other = squares
    for _ in range(60):
        weight = Noise(np.sqrt(kappa * norms(other, other.theta))[:, None] * np.ones((1, 3)))
        other = solve(squares.problem, other.theta, weight, squares.prior_precision, squares.prior_mean)
    assert np.abs((other.theta - found.theta) / found.std).max() < 0.02


def test_standard_errors_are_those_of_repeated_measurements(clean: Estimate) -> None:
    rng = np.random.default_rng(2)
    pulls, wider = [], []
    for _ in range(25):
        squares = refitted(clean, SIGMA * rng.standard_normal(clean.problem.rows.measured.shape))
        found = mean_norm(squares)
        pulls.append(((found.theta - clean.theta) / found.std)[squares.identified])
        wider.append(np.median((found.std / squares.std)[squares.identified]))
    assert np.sqrt(np.mean(np.square(pulls))) == pytest.approx(1.0, abs=0.12)
    # Of Gaussian errors in space the mean norm uses 85 % of what least squares does: errors grow by 8.5 %.
    assert 1.0 < np.mean(wider) < 1.25


def test_few_large_errors_pull_it_less(clean: Estimate) -> None:
    rng = np.random.default_rng(3)
    shape = clean.problem.rows.measured.shape
    off = {"squares": [], "norm": []}
    for _ in range(6):
        large = rng.random(shape[0])[:, None] < 0.08
        squares = refitted(clean, SIGMA * np.where(large, 12.0, 1.0) * rng.standard_normal(shape))
        found = mean_norm(squares)
        for name, estimate in (("squares", squares), ("norm", found)):
            off[name].append(np.mean(((estimate.theta - clean.theta) / found.std)[squares.identified] ** 2))
    assert np.mean(off["norm"]) < 0.5 * np.mean(off["squares"])


def test_identify_gives_the_tables_of_the_universal_model_beside_those_of_least_squares(arm: Campaign) -> None:
    squares, found = identify(arm), identify(arm, cost="mean-norm")
    figures = found.ledger[-1].evidence["universal"]
    ours, theirs = figures["mean-norm"], figures["least-squares"]
    assert ours["P_mean"] < theirs["P_mean"] < 1.05 * ours["P_mean"]
    assert ours["P_std"] > theirs["P_std"]
    assert found.ledger[-1].rms > squares.ledger[-1].rms
    assert squares.ledger[-1].rms == pytest.approx(np.hypot(theirs["P_mean"], theirs["P_std"]), rel=0.01)
    # Both are right: what the two say of a well-known parameter differs by a part of its standard error.
    a, b = squares.stages["poses"], found.stages["poses"]
    known = np.array(a.identified)
    assert np.sqrt(np.mean(((a.theta - b.theta) / b.std)[known] ** 2)) < 1.0
    assert found.ledger[-1].heldout_rms < 1.1 * squares.ledger[-1].heldout_rms
    assert "universal" not in squares.ledger[-1].evidence


def test_what_it_is_not_for_is_refused(arm: Campaign, tiny: Campaign) -> None:
    for campaign, more in ((arm, {"joint": True}), (arm, {"bootstrap": 3})):
        with pytest.raises(FitError, match="cost mean-norm: expected a table poses"):
            identify(campaign, cost="mean-norm", **more)
    logs = replace(tiny, tables={"free_air": tiny.tables["free_air"]})
    with pytest.raises(FitError, match="cost mean-norm: expected a table poses"):
        identify(logs, cost="mean-norm")


def test_figures_of_both_are_of_the_same_points(clean: Estimate) -> None:
    rng = np.random.default_rng(4)
    squares = refitted(clean, SIGMA * rng.standard_normal(clean.problem.rows.measured.shape))
    figures = compared(mean_norm(squares), squares)
    assert figures["least-squares"]["P_max"] == pytest.approx(norms(squares, squares.theta).max())
