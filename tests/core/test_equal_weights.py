"""Weights of a log are chosen by what they predict, and the standard errors of equal ones know that noise lasts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import toeplitz

from clampid.catalogue import catalogue
from clampid.fitting.accuracy import predicted
from clampid.fitting.equal_weights import RINGING, Weights, gradient_power, informed
from clampid.fitting.fit_log import LogNoise, LogPrior, weighted
from clampid.fitting.moments import Moments
from clampid.fitting.prior_and_start import prior_of
from clampid.fitting.priors import description_priors
from clampid.fitting.solve import limits_of
from clampid.identification.fitted_stage import FittedStage, fit_stage
from clampid.identification.identify import effects_in, identify, stage_rows
from clampid.identification.identify_log import FittedLog, LogStage
from clampid.loop.add import add
from clampid.slots import Term
from clampid.stages.fit_problem import fit_problem
from clampid.stages.layout import layout_of
from clampid.stages.log_facts import log_parts
from clampid.stages.prewhitening import LONGEST_LAG, Grouping, Predictors
from experiments.campaign import Campaign, read_campaign
from experiments.simulate import measured_campaign
from experiments.virtual_robot import measure
from kinematics.description import load_robot

STANDARD = ("gravity", "coulomb_friction", "viscous_friction", "wrist_coupling_friction")
LASTING = 0.9 ** np.arange(LONGEST_LAG + 1)  # an autoregression of order one


@pytest.fixture(scope="module")
def right() -> Campaign:
    robot = load_robot("kuka_kr20_r1810")
    return measured_campaign(measure(robot, seed=1, tables=("free_air",)), robot)


@pytest.fixture(scope="module")
def patterned(right: Campaign) -> Campaign:
    """The torque of motor 2 has a pattern in its joint's angle that no standard effect has."""
    table = right.tables["free_air"].copy()
    table["tau2_Nm"] += 4.0 * np.sin(3.0 * table["q2_rad"])
    return replace(right, tables={"free_air": table})


def by_windows(campaign: Campaign, names: Sequence[str] = STANDARD) -> FittedLog:
    terms = [Term(n) for n in names]
    return LogStage(log_parts([campaign]), layout_of([campaign]), catalogue(), terms).fit(())


def held_whole(campaign: Campaign, names: Sequence[str] = STANDARD) -> FittedStage:
    layout = layout_of([campaign])
    return fit_stage(stage_rows([campaign], layout, "free_air"), catalogue(), [Term(n) for n in names], {})


def test_right_model_keeps_the_weights_of_its_noise(right: Campaign) -> None:
    found = by_windows(right)
    assert found.weights is not None
    assert not found.weights.equal
    assert found.model.theta == pytest.approx(held_whole(right).model.theta, rel=1e-6)


def test_lack_that_lasts_gives_rows_equal_weights(patterned: Campaign) -> None:
    found = by_windows(patterned)
    assert found.weights is not None
    assert found.weights.equal
    assert found.evidence["weights"]["gain"] == pytest.approx(found.weights.gain)


def test_log_by_windows_and_log_held_whole_choose_alike(patterned: Campaign) -> None:
    windows, whole = by_windows(patterned), held_whole(patterned).with_best_weights(0)
    assert windows.weights is not None
    assert whole.weights is not None
    assert whole.weights.gain == pytest.approx(windows.weights.gain, rel=1e-6)
    std = np.sqrt(np.diag(whole.model.covariance))
    assert np.abs((windows.model.theta - whole.model.theta) / std).max() < 0.05  # where searches end
    np.testing.assert_allclose(np.sqrt(np.diag(windows.model.covariance)) / std, 1.0, rtol=2e-3)


def test_equal_weights_claim_no_less_error_than_the_best_ones(patterned: Campaign) -> None:
    """Of all unbiased estimates weights by the correlation have the least error, if it is what they say."""
    whole = held_whole(patterned)
    best, equal = whole.model, whole.with_best_weights(0).model
    told = np.array(best.identified) & np.array(equal.identified)
    ratio = np.sqrt(np.diag(equal.covariance) / np.diag(best.covariance))[told]
    assert np.median(ratio) > 1.0
    white = whole.estimate  # equal weights that took the noise for white would claim this
    plain = replace(white.noise, autocorrelations=())
    J = plain.whiten(white.problem.rows, *white.problem.residual(white.theta)).jacobian
    naive = np.sqrt(1.0 / np.diag(J.T @ J + white.prior_precision))
    own = np.array([s.effect == "coulomb_friction" for s in equal.slots])
    assert np.all(
        np.sqrt(np.diag(equal.covariance))[own & np.array(equal.identified)]
        > naive[: len(own)][own & np.array(equal.identified)]
    )


def test_weights_are_recorded_in_the_ledger_and_kept_by_add(patterned: Campaign) -> None:
    model = identify(patterned, ("coulomb_friction", "viscous_friction"))
    assert "weights" in model.ledger[-1].evidence
    mended, _ = add(model, patterned, ("gravity",))
    found = mended.ledger[-1].evidence
    assert found["weights"]["parts"] == 2
    assert found["heldout_rms_after"] == mended.ledger[-1].heldout_rms


@pytest.mark.parametrize("gap", [0, 3, 40])
def test_power_of_a_gradient_under_noise_that_lasts(gap: int) -> None:
    """J'RJ, R dense, with rows that do not count and two stretches that remember nothing of each other."""
    rng = np.random.default_rng(gap)
    row = np.concatenate([np.arange(100), 100 + gap + np.arange(150), 250 + gap + np.arange(80)])
    stretch = np.repeat([0, 0, 1], [100, 150, 80])
    columns = rng.normal(size=(len(row), 3)).cumsum(axis=0) / 10.0
    R = 0.9 ** np.abs(np.subtract.outer(row, row)) * (stretch[:, None] == stretch)
    found = gradient_power(columns, Grouping(1, np.arange(len(row)), row, stretch), Predictors(LASTING))
    np.testing.assert_allclose(found, columns.T @ R @ columns, rtol=1e-6)
    assert 0.9**RINGING < 1e-9


def test_standard_errors_of_equal_weights_are_the_sandwich() -> None:
    rng = np.random.default_rng(5)
    J = rng.normal(size=(400, 3)).cumsum(axis=0) / 20.0
    R = toeplitz(0.9 ** np.arange(400))
    N, M = J.T @ J, J.T @ R @ J
    plain = Moments(np.zeros(3), N, np.zeros(3), 400.0, 400)
    none, free = np.zeros((3, 3)), np.ones(3, dtype=bool)
    found = informed(plain, M, none, np.zeros(3), np.ones(3), free)
    expected = np.linalg.inv(N) @ M @ np.linalg.inv(N)
    np.testing.assert_allclose(np.linalg.inv(found.normal), expected, rtol=1e-9)
    least = np.linalg.inv(J.T @ np.linalg.solve(R, J))  # Gauss and Markov: nothing unbiased has less
    assert np.linalg.eigvalsh(expected - least).min() > -1e-12


def test_a_difference_within_its_error_changes_no_weight() -> None:
    assert not Weights(gain=0.02, error=0.03, parts=5).equal
    assert not Weights(gain=-0.02, error=0.01, parts=5).equal
    assert Weights(gain=0.04, error=0.03, parts=5).equal
    assert not Weights(gain=0.04, error=0.03, parts=2).equal  # of two parts the error itself is hardly known


def worse_than_least_squares(fitted: Campaign, unseen: Campaign) -> tuple[float, float]:
    """By how much `identify` is worse on raw rows that nothing has seen, and the standard error of that.

    Least squares has the same columns, and no weights. The mean square of a motor counts in units of what least squares
    leaves; the error is from pieces of rows that follow each other.
    """
    model = identify(fitted).stages["free_air"]
    effects = catalogue()
    active = effects_in(model.terms, effects)
    log = LogStage(log_parts([fitted]), layout_of([fitted]), effects, model.terms)
    every, none = np.ones(len(log.folds), dtype=bool), np.zeros(0, dtype=np.int64)
    precision, mean = prior_of(log.problem, description_priors(log.folds))
    prior = LogPrior(precision, mean, limits_of(log.problem))
    ordinary, _ = weighted(log.design, every, prior, none, LogNoise(np.ones(log.design.n)), mean)
    rows = stage_rows([unseen], layout_of([unseen]), "free_air", active=active)
    trial = fit_problem(rows, effects, model.slots)
    own, other = (predicted(trial, theta) ** 2 for theta in (model.theta, ordinary.at[: len(model.slots)]))
    scale = np.mean(other, axis=0, where=rows.used)
    worse = np.sum((own - other) * rows.used / scale, axis=1)
    pieces = np.array([piece.sum() for piece in np.array_split(worse, 20)]) / len(worse)
    return float(pieces.sum()), float(np.sqrt(len(pieces)) * pieces.std(ddof=1))


def test_kept_fit_of_a_lacking_model_predicts_as_least_squares_does(patterned: Campaign) -> None:
    table = patterned.tables["free_air"]
    first, last = (
        replace(patterned, tables={"free_air": table[table["run"] == run].reset_index(drop=True)}) for run in (1, 2)
    )
    worse, error = worse_than_least_squares(first, last)
    assert worse < error, (worse, error)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["panda_log", "tx40_current_log"])
def test_kept_fit_of_a_real_log_predicts_as_least_squares_does(shared_folder: Path, name: str) -> None:
    whole = read_campaign(shared_folder / "real" / name)
    table = whole.tables["free_air"]
    cut = round(0.8 * len(table))
    first, last = (
        replace(whole, tables={"free_air": part.reset_index(drop=True)}, fingerprint=str(k))
        for k, part in enumerate((table.iloc[:cut], table.iloc[cut:]))
    )
    worse, error = worse_than_least_squares(first, last)
    assert worse < error, (worse, error)
