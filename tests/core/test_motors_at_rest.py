"""What friction held motors kept beside a block that yields: which clearances are crossed, and the springs."""

from __future__ import annotations

import clamped_hidden
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from clampid.catalogue import catalogue
from clampid.fitting.motors_at_rest import _middle, other_crossings
from clampid.fitting.noise import initial_noise
from clampid.fitting.prior_and_start import prior_of
from clampid.identification.fitted_stage import active_slots
from clampid.identification.identify import identify
from clampid.slots import parse_term
from clampid.stages.clamped_rows import clamped_rows
from clampid.stages.fit_problem import FitProblem, fit_problem
from clampid.stages.layout import layout_of
from experiments.virtual_robot import Hidden, Measured, measure
from kinematics.description import load_robot

SEEDS = (4, 5, 6)
TERMS = (*clamped_hidden.STANDARD, "fixture_compliance")


def measured_with_block(seed: int) -> Measured:
    return measure(load_robot("kuka_kr20_r1810"), [Hidden.parse("fixture_compliance")], seed=seed, tables=("clamped",))


@pytest.fixture(scope="module")
def measured() -> Measured:
    return measured_with_block(SEEDS[0])


@pytest.fixture(scope="module")
def trial(measured: Measured) -> FitProblem:
    campaign = clamped_hidden.campaign_of(measured, watched=False)
    layout = layout_of([campaign])
    rows = clamped_rows([campaign], layout)
    terms = [parse_term(name, catalogue(), layout) for name in TERMS]
    return fit_problem(rows, catalogue(), active_slots(rows, catalogue(), terms))


def test_every_held_motor_keeps_some_friction(trial: FitProblem):
    rows, n = trial.rows, trial.rows.robot.n
    run, motion = rows.series.run, rows.signals["motor_motion"]
    held = {(s, n + i) for s in np.unique(run) for i in range(n) if not motion[run == s, i].any()}
    assert held == {(s, k) for s, k in rows.series.offset_keys if k >= n}


def test_a_motor_that_stands_still_keeps_its_friction(trial: FitProblem):
    precision, mean = prior_of(trial, ())
    keys, n, count = trial.rows.series.offset_keys, trial.rows.robot.n, len(trial.slots)
    covariance = np.linalg.inv(precision[count:, count:])
    driven = {s: int(trial.rows.sweep.driven[trial.rows.series.run == s][0]) for s in np.unique(keys[:, 0])}
    at = {(int(s), int(k)): i for i, (s, k) in enumerate(keys)}
    # Joint 1 is driven first, and last upwards: its friction is known in the sweeps of the same clamping that follow.
    first = next(s for s in sorted(driven) if driven[s] == 0)
    after = [at[s, n] for s in range(first + 1, first + n)]
    friction = trial.rows.sweep.loop_friction[0]
    np.testing.assert_allclose(mean[count:][after], friction)
    assert np.sqrt(np.diag(covariance)[after]).max() < 0.5 * friction
    # The wrist waits: its friction is unknown as a friction is, but the same in all sweeps before.
    before = [at[s, 2 * n - 1] for s in range(first, first + 3)]
    np.testing.assert_allclose(mean[count:][before], 0.0)
    spread = covariance[np.ix_(before, before)] / trial.rows.sweep.loop_friction[n - 1] ** 2
    assert np.all(np.abs(spread - 1.0) < 0.02)


@given(st.integers(0, 2**31))
def test_the_angle_nearest_to_intervals_is_inside_all_where_it_can_be(seed: int):
    rng = np.random.default_rng(seed)
    inside = rng.normal(size=3)
    low, high = inside - rng.uniform(0.0, 1.0, (20, 3)), inside + rng.uniform(0.0, 1.0, (20, 3))
    far = np.maximum(_middle(low, high) - high.min(axis=0), low.max(axis=0) - _middle(low, high))
    alone = np.maximum(
        0.5 * (low + high).mean(axis=0) - high.min(axis=0), low.max(axis=0) - 0.5 * (low + high).mean(axis=0)
    )
    assert np.all(np.maximum(far, 0.0) <= np.maximum(alone, 0.0) + 1e-12)


def test_without_clearances_nothing_is_crossed(trial: FitProblem):
    bare = trial.with_slots([slot for slot in trial.slots if slot.effect != "backlash"])
    precision, mean = prior_of(bare, ())
    assert other_crossings(bare, initial_noise(bare.rows), bare.start(), precision, mean) is None


@pytest.mark.study
def test_springs_beside_a_rocking_block_are_known_as_well_as_is_said():
    off = []
    for seed in SEEDS:
        measured = measured_with_block(seed)
        model = identify(clamped_hidden.campaign_of(measured, watched=False), {"clamped": TERMS})
        off.append(clamped_hidden.springs_off(model, measured))
    # So large a sum of squares comes once in a thousand where the errors are as stated; it was 52 of 18.
    assert np.sum(np.square(off)) < stats.chi2.isf(1e-3, np.size(off))
