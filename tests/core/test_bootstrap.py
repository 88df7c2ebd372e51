"""Bootstrap by pose: one step is a refit, noise gives what the formula gives, and shared misfit gives more."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.fitting.bootstrap import bootstrap, draws, one_step
from clampid.fitting.solve import Estimate, solve
from clampid.identification.fitted_stage import fit_stage
from clampid.identification.identify import identify
from clampid.models.model import Model, load_model, save_model
from clampid.slots import Term
from clampid.stages.layout import layout_of
from clampid.stages.pose_rows import pose_rows
from experiments.campaign import Campaign

Simulated = Callable[..., Campaign]
TERMS = tuple(Term(name) for name in ("geometry", "joint_compliance", "backlash"))


@pytest.fixture(scope="module")
def campaign(simulated: Simulated) -> Campaign:
    return simulated(seed=21, poses=100, tables=("poses",))


@pytest.fixture(scope="module")
def estimate(campaign: Campaign) -> Estimate:
    rows = pose_rows([campaign], layout_of([campaign]), "poses")
    return fit_stage(rows, catalogue(), TERMS, {}).estimate


def refit(estimate: Estimate, weight: np.ndarray) -> np.ndarray:
    """Fit a draw in full: rows repeated as often as their pose was drawn."""
    rows = estimate.problem.rows
    _, fold = np.unique(rows.fold, return_inverse=True)
    chosen = np.repeat(np.arange(len(rows)), weight[fold].astype(int))
    again = estimate.problem.with_rows(rows.take(chosen))
    noise = estimate.noise.at(chosen)
    return solve(again, estimate.theta, noise, estimate.prior_precision, estimate.prior_mean).theta


def test_all_poses_once_give_the_fit_itself(estimate: Estimate) -> None:
    weights = np.ones((1, len(np.unique(estimate.problem.rows.fold))))
    moved = (one_step(estimate, weights)[0] - estimate.theta) / estimate.std
    assert np.abs(moved).max() < 0.05  # what the search left


def test_one_step_is_a_refit_within_the_error_of_the_draws(estimate: Estimate) -> None:
    weights = draws(estimate, 60, np.random.default_rng(0))
    short = one_step(estimate, weights)
    full = np.array([refit(estimate, w) for w in weights])
    known = estimate.identified[: len(estimate.slots)]
    short, full = short[:, : len(known)][:, known], full[:, : len(known)][:, known]
    spread = full.std(axis=0, ddof=1)
    # Draw by draw the two are the same but for a small share of the spread ...
    assert np.median(np.sqrt(np.mean((short - full) ** 2, axis=0)) / spread) < 0.1
    # ... and their standard errors differ by less than 60 draws can tell (9 %), parameter by parameter.
    ratio = short.std(axis=0, ddof=1) / spread
    assert np.abs(np.median(ratio) - 1) < 0.03
    assert np.abs(ratio - 1).max() < 3 / np.sqrt(2 * 60)


def test_for_noise_alone_it_says_what_the_formula_says(estimate: Estimate) -> None:
    rows, rng = estimate.problem.rows, np.random.default_rng(1)
    white = estimate.whitened

    noise = replace(estimate, whitened=replace(white, residual=rng.standard_normal(len(white.residual))))
    A = white.jacobian.T @ white.jacobian + estimate.prior_precision
    formula = np.sqrt(np.diag(np.linalg.inv(A)))[: len(estimate.slots)]
    known = estimate.identified[: len(estimate.slots)]
    ratio = (bootstrap(noise, 600, seed=2).std / formula)[known]
    assert np.exp(np.mean(np.log(ratio))) == pytest.approx(1.0, abs=0.15)
    # The same error in all rows of a pose is worth fewer rows; drawing rows one by one would not see that.
    pose = rng.standard_normal((int(rows.fold.max()) + 1, 3))[rows.fold[white.entry], white.channel]
    shared = replace(estimate, whitened=replace(white, residual=pose))
    wide = (bootstrap(shared, 600, seed=2).std / formula)[known]
    assert np.exp(np.mean(np.log(wide))) > 1.2


def test_a_thousand_fits_take_far_less_than_ten_seconds(estimate: Estimate) -> None:
    begin = time.process_time()
    bootstrap(estimate, 1000)
    assert time.process_time() - begin < 5.0


def test_it_is_kept_in_the_model_and_does_not_change_the_fit(campaign: Campaign, tmp_path) -> None:
    effects = [t.effect for t in TERMS]
    plain, drawn = identify(campaign, effects), identify(campaign, effects, bootstrap=50, seed=0)
    stage = drawn.stages["poses"]
    assert np.array_equal(plain.stages["poses"].theta, stage.theta)
    assert stage.bootstrap is not None
    save_model(drawn, tmp_path / "m.json")
    back: Model = load_model(tmp_path / "m.json")
    found = back.stages["poses"].bootstrap
    assert found is not None
    assert np.array_equal(found.std, stage.bootstrap.std)
    assert np.all(found.low <= found.high)


def test_too_little_to_draw_from_is_refused(estimate: Estimate) -> None:
    with pytest.raises(ValueError, match="expected two or more draws, found 1"):
        bootstrap(estimate, 1)
    rows = estimate.problem.rows

    one = replace(estimate, problem=estimate.problem.with_rows(rows.take(rows.fold == 0)))
    with pytest.raises(ValueError, match="two or more poses in session 1, found 1"):
        bootstrap(one, 10)
