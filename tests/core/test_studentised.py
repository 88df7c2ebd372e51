"""The statistic where units are few: what the fit with a candidate leaves is its measure, and flips calibrate it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from clampid.diagnosis.candidate_scores import DICTIONARY_FALSE_ALARMS
from clampid.evidence.candidates import Candidate
from clampid.evidence.columns import Columns
from clampid.evidence.flips import with_null
from clampid.evidence.score import score
from clampid.evidence.space import Space
from clampid.evidence.tails import log_tail_of_f
from clampid.slots import Slot

Array = np.ndarray


def candidate(columns: Array, name: str = "made") -> Candidate:
    slots = tuple(Slot(name, f"p{k}", "robot") for k in range(columns.shape[1]))
    return Candidate(name, name, (), slots, {}, Columns(((0, columns),), columns.shape[1]), (), ())


def space(J: Array, y: Array, unit: Array) -> Space:
    """The space of a linear fit without a prior."""
    Q, _ = np.linalg.qr(J)
    r = y - Q @ (Q.T @ y)
    freedom = len(y) - J.shape[1]
    return Space(r, Q, unit, float(np.sqrt(r @ r / freedom)), freedom, len(y), np.zeros(0))


def drawn(rng: np.random.Generator, unit: Array, columns: int) -> tuple[Space, list[Candidate]]:
    """Noise that rows of a unit share, and candidates; units differ in size and in how much a candidate acts there."""
    y = rng.standard_normal(unit.max() + 1)[unit] + 0.5 * rng.standard_normal(len(unit))
    reach = rng.exponential(size=(40, unit.max() + 1))[:, unit, None]
    sp = space(rng.standard_normal((len(unit), 4)), y, unit)
    return sp, [candidate(r * rng.standard_normal((len(unit), columns))) for r in reach]


@pytest.mark.parametrize("columns", [1, 3])
def test_the_denominator_is_what_the_fit_with_the_candidate_leaves(columns: int):
    rng = np.random.default_rng(4)
    unit = np.repeat(np.arange(12), 5)
    sp, (c, *_) = drawn(rng, unit, columns)
    s = score(sp, [c])[0]
    assert s.studentised is not None
    Z = s.directions(sp.basis)
    for signs in (np.ones(12), rng.choice([-1.0, 1.0], size=12)):
        parts = signs[:, None] * s.parts
        a, left = parts.sum(axis=0), 0.0
        for u in range(12):
            H = Z[unit == u].T @ Z[unit == u]
            e = parts[u] - H @ a
            left += float(e @ np.linalg.solve(np.eye(columns) - H, e))
        first, second = s.studentised.freedom
        expected = stats.f.logsf(float(a @ a) / left, first, second)
        assert float(s.studentised.log_p(a, signs)) == pytest.approx(expected, rel=0.01)
    assert first == pytest.approx(columns)


def test_tails_of_f_do_not_underflow():
    ratio, first, second = np.array([0.1, 1.0, 30.0]), 3.0, 17.0
    np.testing.assert_allclose(log_tail_of_f(ratio, first, second), stats.f.logsf(ratio, first, second))
    a, b = 1000.0, 1.5  # halves of the degrees of freedom; beyond the smallest number, the leading term
    far = float(log_tail_of_f(np.array(1e6), 2 * b, 2 * a))
    x = 2 * a / (2 * a + 2 * b * 1e6)
    assert far == pytest.approx(a * np.log(x) + b * np.log1p(-x) - np.log(a) + 0.5 * np.log(a**3) - 0.12, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("columns", [1, 3])
def test_flips_hold_the_familywise_error_where_units_are_few_and_unlike(columns: int):
    rng, alarms, runs = np.random.default_rng(5), 0, 200
    unit = np.repeat(np.arange(20), rng.integers(2, 9, 20))
    for run in range(runs):
        sp, candidates = drawn(rng, unit, columns)
        scored = score(sp, candidates)
        scored, null = with_null(sp, scored, 99, run)
        alarms += min(null.p_familywise(s.log_p) for s in scored) <= 0.05
    assert stats.binom.ppf(1e-3, runs, 0.05) <= alarms <= stats.binom.isf(1e-3, runs, 0.05)


@pytest.mark.parametrize(("units", "shown"), [(30, 6), (300, 12)])
def test_an_effect_that_shows_in_a_few_units_is_significant(units: int, shown: int):
    """By its square over that of all flips it was not: of six units one pattern of signs in 32 gives as much."""
    rng, count = np.random.default_rng(6), 6 * units
    unit = np.repeat(np.arange(units), 6)
    D = np.where(unit < shown, 1.0, 0.02)[:, None] * rng.standard_normal((count, 1))
    sp = space(rng.standard_normal((count, 4)), rng.standard_normal(count) + 4.0 * D[:, 0], unit)
    others = [candidate(rng.standard_normal((count, 2))) for _ in range(40)]
    scored = score(sp, [candidate(D, "true"), *others])
    raw = scored
    scored, null = with_null(sp, raw, 199, 0)
    assert null.p_familywise(scored[0].log_p) <= DICTIONARY_FALSE_ALARMS
    scored, null = with_null(sp, [replace(s, studentised=None) for s in raw], 199, 0)
    assert null.p_familywise(scored[0].log_p) > 2.0 * DICTIONARY_FALSE_ALARMS


def test_what_a_prior_knows_needs_no_degrees_of_freedom():
    """A candidate that shows by the pull of the fit on its prior: the variance of that is known, not estimated."""
    rng, count = np.random.default_rng(8), 40
    J, root = rng.standard_normal((count, 1)), 6.0
    Q, _ = np.linalg.qr(np.vstack([J, [[root]]]))
    y = np.r_[rng.standard_normal(count), 0.0]
    unit = np.r_[np.repeat(np.arange(4), 10), 4]
    sp = Space(y - Q @ (Q.T @ y), Q, unit, 1.0, count - 1, count, np.ones(1))
    s = score(sp, [candidate(J + 0.05 * rng.standard_normal((count, 1)))])[0]
    Z = s.directions(sp.basis)[:, 0]
    share = np.bincount(unit, Z**2)
    assert share[4] > 0.3  # of it shows in the prior's row
    assert s.studentised is not None
    assert s.studentised.freedom[1] == pytest.approx(1.0 / np.sum(share[:4] ** 2) - 1.0)


@pytest.mark.parametrize(("shown", "few"), [(400, False), (12, True)])
def test_what_shows_in_many_units_has_one_statistic(shown: int, few: bool):
    rng, count = np.random.default_rng(7), 400
    sp = space(rng.standard_normal((count, 3)), rng.standard_normal(count), np.arange(count))
    D = np.where(np.arange(count) < shown, 1.0, 0.01)[:, None] * rng.standard_normal((count, 1))
    assert (score(sp, [candidate(D)])[0].studentised is not None) is few
