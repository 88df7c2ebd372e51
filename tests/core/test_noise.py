"""Whitening of torque logs: no autocorrelation is left, and rows that do not count change nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.ndimage import gaussian_filter1d

from clampid.effect import Stage
from clampid.fitting.noise import initial_noise, learn_noise
from clampid.stages.prewhitening import Grouping, Predictors, Whitener, autocorrelation, lag_products, settled
from clampid.stages.rows import Rows

LAGS = 20


def log_of(rows: Rows, residual: np.ndarray, run: np.ndarray) -> Rows:
    """A torque log of one motor's numbers, evenly sampled, in the given runs."""
    count = len(residual)
    first = rows.take(np.zeros(count, dtype=int))
    constants = replace(first.series, run=run, time=0.1 * np.arange(count), offset_keys=np.zeros((0, 2), int))
    return Rows(
        **{
            **vars(first),
            "measured": residual,
            "sigma": np.ones_like(residual),
            "used": np.ones_like(residual, dtype=bool),
            "constants": constants,
        }
    )


def coloured(rng: np.random.Generator, count: int, share: float = 0.6, memory: float = 0.9) -> np.ndarray:
    """White noise and an AR(1) process, of unit variance together."""
    slow = np.zeros(count)
    steps = rng.standard_normal(count) * np.sqrt(1 - memory**2)
    for i in range(1, count):
        slow[i] = memory * slow[i - 1] + steps[i]
    return np.sqrt(share) * slow + np.sqrt(1 - share) * rng.standard_normal(count)


def portmanteau(x: np.ndarray) -> float:
    """Ljung and Box's statistic, chi-square with about LAGS degrees of freedom for white x."""
    n, x = len(x), x - x.mean()
    rho = np.array([x[k:] @ x[:-k] for k in range(1, LAGS + 1)]) / (x @ x)
    return float(n * (n + 2) * np.sum(rho**2 / (n - np.arange(1, LAGS + 1))))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_whitener_leaves_no_autocorrelation(few_rows: dict[Stage, Rows], seed: int):
    rng, count = np.random.default_rng(seed), 4000
    residual = 0.3 * np.c_[[coloured(rng, count) for _ in range(6)]].T
    rows = log_of(few_rows["free_air"], residual, np.zeros(count, dtype=np.int64))
    white = learn_noise(rows, residual).whiten(rows, residual, np.zeros((count, 6, 0)))
    limit = stats.chi2.isf(1e-4, LAGS)
    for channel in range(6):
        x = white.residual[white.channel == channel]
        assert portmanteau(residual[:, channel]) > 10 * limit
        assert portmanteau(x) < limit
        assert np.std(x) == pytest.approx(1.0, abs=0.05)


def test_whitener_starts_anew_at_every_run(few_rows: dict[Stage, Rows]):
    rng, count = np.random.default_rng(3), 600
    residual = np.tile(coloured(rng, count)[:, None], (1, 6))
    run = np.repeat(np.arange(3), count // 3).astype(np.int64)
    rows = log_of(few_rows["free_air"], residual, run)
    noise = learn_noise(rows, residual)
    joined = noise.whiten(rows, residual, np.zeros((count, 6, 0))).residual
    changed = residual.copy()
    changed[run == 0] += 5.0  # a run may not leak into the next one
    other = noise.whiten(rows, changed, np.zeros((count, 6, 0))).residual
    later = np.tile(run > 0, 6)
    np.testing.assert_array_equal(other[later], joined[later])
    assert np.all(other[~later] != joined[~later])


def test_residual_and_columns_pass_one_filter(few_rows: dict[Stage, Rows]):
    """Whitening is linear: a residual that is a column is whitened to that whitened column."""
    rng, count = np.random.default_rng(4), 500
    residual = np.c_[[coloured(rng, count) for _ in range(6)]].T
    rows = log_of(few_rows["free_air"], residual, np.zeros(count, dtype=np.int64))
    column = rng.standard_normal((count, 6))
    white = learn_noise(rows, residual).whiten(rows, column, column[:, :, None])
    np.testing.assert_allclose(white.residual, white.jacobian[:, 0], atol=1e-13)


def test_numbers_not_used_do_not_count(few_rows: dict[Stage, Rows]):
    rows = few_rows["free_air"]
    residual = np.random.default_rng(5).standard_normal(rows.measured.shape)
    white = initial_noise(rows).whiten(rows, residual, np.zeros((*residual.shape, 0)))
    assert len(white.residual) == rows.used.sum()
    spoilt = np.where(rows.used, residual, 1e6)
    again = initial_noise(rows).whiten(rows, spoilt, np.zeros((*residual.shape, 0)))
    np.testing.assert_array_equal(again.residual, white.residual)


@settings(max_examples=100, deadline=None)
@given(
    counts=st.lists(st.booleans(), min_size=1, max_size=80),
    together=st.integers(1, 6),
    cut=st.integers(0, 80),
    broken=st.integers(0, 80),
)
def test_groups_are_whole_and_the_same_in_every_window(counts: list[bool], together: int, cut: int, broken: int):
    """A group has all its rows, in one stretch; of two windows that overlap each has those that end in it."""
    row = np.flatnonzero(counts)
    stretch = (row >= broken).astype(np.int64)
    groups = Grouping.of(row, stretch, together)
    expected = [
        start
        for start in range(0, len(counts), together)
        if all(counts[start : start + together])
        and start + together <= len(counts)
        and not start < broken < start + together
    ]
    np.testing.assert_array_equal(row[groups.first], expected)
    np.testing.assert_allclose(groups.mean(row + 0.0), np.array(expected) + 0.5 * (together - 1), atol=1e-12)
    before = row < cut
    earlier = Grouping.of(row[before], stretch[before], together)
    own = groups.own(int(np.count_nonzero(before)))
    np.testing.assert_array_equal(np.r_[earlier.row, groups.row[own:]], groups.row)


def test_noise_is_settled_where_it_changes_by_less_than_it_is_known_to():
    """Two logs of the same noise differ by its error, and are not taken for one; one log and nearly itself are."""
    rng, count = np.random.default_rng(4), 20_000

    def learned(x: np.ndarray) -> tuple[float, np.ndarray, float]:
        products, pairs = lag_products(x, np.arange(count), np.zeros(count, dtype=np.int64))
        return float(np.sqrt(products[0] / pairs[0])), autocorrelation(products, pairs), float(pairs[0])

    first = coloured(rng, count)
    one, other = learned(first), learned(coloured(rng, count))
    nearly = learned(first + 1e-3 * rng.standard_normal(count))
    assert settled(nearly[0] / one[0], one[1], nearly[1], one[2])
    assert not settled(other[0] / one[0], one[1], other[1], one[2])
    assert not settled(1.0 + 1.0 / np.sqrt(count), one[1], one[1], one[2])


def test_dense_log_is_weighted_by_what_its_design_can_follow():
    """5 kHz: the motion is slow, and so is what the model leaves; the design has a little quick error of its own.

    By the noise of single rows, quick changes weigh most, of which the design has only its error: the slope comes out
    a tenth too small, at least. By that of means over 10 ms it is right.
    """
    rng, count, slope = np.random.default_rng(3), 50_000, 2.0
    motion = gaussian_filter1d(rng.standard_normal(count), 200)
    motion /= motion.std()
    left = gaussian_filter1d(rng.standard_normal(count), 300)
    torque = slope * motion + 0.1 * left / left.std() + 1e-4 * rng.standard_normal(count)
    both = np.c_[motion + 1e-2 * rng.standard_normal(count), torque]
    found = []
    for together in (1, 50):
        groups = Grouping.of(np.arange(count), np.zeros(count, dtype=np.int64), together)
        values = groups.mean(both)
        residual = values @ np.array([-slope, 1.0])
        noise = Predictors(autocorrelation(*lag_products(residual, groups.row, groups.stretch)))
        white = Whitener(groups.row, groups.stretch)(values, noise)
        found.append(float(white[:, 0] @ white[:, 1] / (white[:, 0] @ white[:, 0])))
    assert slope - found[0] > 0.1 * slope
    assert abs(found[1] - slope) < 0.02 * slope
