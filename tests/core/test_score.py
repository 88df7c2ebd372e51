"""Calibration of the score test: p-values are as rare as they say, and penalties follow the freedom."""

from __future__ import annotations

from math import lgamma
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.special import gammaln, logsumexp

from clampid.diagnosis.candidate_scores import DICTIONARY_FALSE_ALARMS, CandidateScores
from clampid.evidence.candidates import Candidate
from clampid.evidence.columns import Columns
from clampid.evidence.flips import Flips, with_null
from clampid.evidence.score import canonical, explained_together, flip_moments, score, tail_of
from clampid.evidence.space import Space, unshrunk
from clampid.evidence.tails import log_tail
from clampid.slots import Slot


def candidate(columns: np.ndarray, name: str = "made") -> Candidate:
    slots = tuple(Slot(name, f"p{k}", "robot") for k in range(columns.shape[1]))
    return Candidate(name, name, (), slots, {}, Columns(((0, columns),), columns.shape[1]), (), ())


def space(J: np.ndarray, y: np.ndarray, unit: np.ndarray | None = None) -> Space:
    """The space of a linear fit without a prior."""
    Q, _ = np.linalg.qr(J)
    r = y - Q @ (Q.T @ y)
    freedom = len(y) - J.shape[1]
    units = np.arange(len(y)) if unit is None else unit
    return Space(r, Q, units, float(np.sqrt(r @ r / freedom)), freedom, len(y), np.zeros(0))


@pytest.mark.parametrize("entries", [3, 40])  # of a unit, fewer or more than the columns
@pytest.mark.parametrize("decades", [0.0, 20.0])
def test_a_residual_gets_back_what_the_fit_absorbed_of_its_unit(entries: int, decades: float):
    rng = np.random.default_rng(7)
    scales = 10.0 ** -np.linspace(0.0, decades, 9)
    Q, _ = np.linalg.qr(rng.standard_normal((80, 9)))
    Q *= scales
    unit = np.r_[np.zeros(entries, int), np.ones(80 - entries, int)]
    r = rng.standard_normal(80)
    own = Q[unit == 0]
    share, turn = np.linalg.eigh(np.eye(entries) - own @ own.T)
    expected = turn @ (turn.T @ r[unit == 0] / np.sqrt(share))
    np.testing.assert_allclose(unshrunk(r, Q, unit)[unit == 0], expected, rtol=1e-9, atol=1e-12)


def test_p_values_are_uniform_where_nothing_is_missing():
    rng, p = np.random.default_rng(0), []
    for _ in range(300):
        J, D, y = rng.standard_normal((150, 6)), rng.standard_normal((150, 2)), rng.standard_normal(150)
        p.append(np.exp(score(space(J, y), [candidate(D)])[0].log_p))
    assert stats.kstest(p, "uniform").pvalue > 1e-3


def test_score_is_the_fall_of_the_squares_when_refitted():
    rng = np.random.default_rng(1)
    J, D, y = rng.standard_normal((80, 5)), rng.standard_normal((80, 3)), rng.standard_normal(80)
    D = D @ rng.standard_normal((3, 3)) * 1e-6  # units do not matter
    found = score(space(J, y), [candidate(D)])[0]

    def squares(A: np.ndarray) -> float:
        return float(np.sum((y - A @ np.linalg.lstsq(A, y, rcond=None)[0]) ** 2))

    fall = squares(J) - squares(np.c_[J, D * 1e6])
    assert found.explained == pytest.approx(fall / (squares(J) / 75), rel=1e-9)
    assert found.freedom == 3


@pytest.mark.slow
def test_flips_hold_the_familywise_error():
    """Rows that share their unit's noise, and a dictionary of 40: 5 % of null data may alarm."""
    rng, alarms, runs = np.random.default_rng(2), 0, 200
    unit = np.repeat(np.arange(60), 3)
    for run in range(runs):
        y = rng.standard_normal(60)[unit] + 0.7 * rng.standard_normal(180)
        sp = space(rng.standard_normal((180, 5)), y, unit)
        scored = score(sp, [candidate(rng.standard_normal((180, 1 + k % 2))) for k in range(40)])
        scored, null = with_null(sp, scored, 99, run)
        alarms += min(null.p_familywise(s.log_p) for s in scored) <= 0.05
    assert alarms <= stats.binom.isf(1e-3, runs, 0.05)
    assert alarms >= stats.binom.ppf(1e-3, runs, 0.05)


def test_flips_find_what_is_there():
    rng = np.random.default_rng(3)
    J, D = rng.standard_normal((200, 5)), rng.standard_normal((200, 1))
    sp = space(J, rng.standard_normal(200) + 0.5 * D[:, 0])
    scored = score(sp, [candidate(D, "true"), *(candidate(rng.standard_normal((200, 1))) for _ in range(30))])
    raw = scored
    scored, null = with_null(sp, raw, 199, 0)
    assert max(scored, key=lambda s: s.bic).candidate.name == "true"
    assert null.p_familywise(scored[0].log_p) == pytest.approx(1 / 200)
    assert np.array_equal(null.maxima, with_null(sp, raw, 199, 0)[1].maxima)


def test_familywise_p_counts_the_flips_beyond():
    null = Flips(np.array([1.0, 2.0, 3.0, 4.0]))
    assert null.p_familywise(-2.5) == pytest.approx(3 / 5)
    assert null.p_familywise(-10.0) == pytest.approx(1 / 5)
    assert null.p_familywise(0.0) == 1.0


@pytest.mark.parametrize("freedom", [1, 2, 3, 4, 7, 12, 30])
def test_log_tail(freedom: int):
    x = np.array([0.0, 1e-3, 0.5, 3.0, 40.0, 300.0, 900.0])
    np.testing.assert_allclose(log_tail(x, freedom), stats.chi2.logsf(x, freedom), rtol=1e-10, atol=1e-100)
    # Far out the tail itself is too small for a number.
    for far in (1.5e3, 1e4, 1e6):
        assert log_tail(far, freedom) == pytest.approx(_log_tail_by_series(far, freedom), rel=2e-4)
    grid = np.linspace(900.0, 1100.0, 400)
    assert np.all(np.diff(log_tail(grid, freedom)) < 0)  # no step where the formulas meet


@pytest.mark.parametrize("freedom", [2, 300, 1100, 5000])
def test_log_tail_of_hundreds_of_directions(freedom: int):
    """For even freedom the tail is a Poisson distribution's, whose terms have logarithms at any distance."""
    k = np.arange(freedom // 2)
    for x in freedom * np.array([0.9, 1.0, 1.05, 1.3, 2.0, 5.0, 30.0]):
        exact = -x / 2 + logsumexp(k * np.log(x / 2) - gammaln(k + 1.0))
        assert log_tail(float(x), freedom) == pytest.approx(exact, rel=1e-3)


def _log_tail_by_series(x: float, freedom: int) -> float:
    """Upper incomplete gamma function by its asymptotic series, DLMF 8.11.2."""
    a, h = freedom / 2, x / 2
    term = total = 1.0
    for k in range(1, 15):
        term *= (a - k) / h
        total += term
    return float((a - 1) * np.log(h) - h - lgamma(a) + np.log(total))


def test_states():
    rng = np.random.default_rng(5)
    J = rng.standard_normal((100, 4))
    fresh = rng.standard_normal((100, 1))
    sp = space(J, rng.standard_normal(100))
    weak = J[:, :1] + 0.05 * fresh
    made: dict[str, Any] = {
        "absent": np.zeros((100, 1)),
        "absorbed": J[:, :2] @ rng.standard_normal((2, 2)),
        "weak": weak,
        "testable": fresh,
    }
    for state, columns in made.items():
        found = score(sp, [candidate(columns)])[0]
        assert found.state == state
        assert found.freedom == (0 if state in ("absent", "absorbed") else 1)
    partly = score(sp, [candidate(np.c_[J[:, :1], fresh])])[0]
    assert partly.freedom == 1
    assert partly.retained == pytest.approx(0.5, abs=0.05)


def test_the_same_space_is_one_explanation():
    rng = np.random.default_rng(6)
    J, D = rng.standard_normal((120, 4)), rng.standard_normal((120, 2))
    sp = space(J, rng.standard_normal(120) + D[:, 0])
    turned = D @ rng.standard_normal((2, 2)) + J[:, :2]  # what the model absorbs makes no difference
    a, b, c = score(sp, [candidate(D), candidate(turned), candidate(rng.standard_normal((120, 2)))])
    assert canonical(a, b) == pytest.approx(1.0, abs=1e-9)
    assert canonical(a, c) < 0.3
    assert explained_together(sp, a, b) == pytest.approx(a.explained, rel=1e-6)
    assert explained_together(sp, a, c) > a.explained


def test_flips_are_as_large_as_the_noise_that_a_fit_took_a_share_of():
    """Sixty parameters take a fifth of the noise of fifty units; what many columns explain is not large."""
    rng, ratio = np.random.default_rng(12), []
    unit = np.repeat(np.arange(50), 6)
    for _ in range(40):
        J, D = rng.standard_normal((300, 60)), rng.standard_normal((300, 150))
        sp = space(J, rng.standard_normal(300), unit)
        (found,) = score(sp, [candidate(D)])
        ratio.append(found.explained / flip_moments(found.parts, found.kept, sp.scale, sp.drawn)[0])
    assert np.mean(ratio) == pytest.approx(1.0, abs=3 * np.std(ratio) / np.sqrt(len(ratio)))
    assert np.std(ratio) / np.sqrt(len(ratio)) < 0.03


def test_moments_are_those_of_all_flips():
    rng = np.random.default_rng(8)
    parts, kept = rng.standard_normal((9, 3)), np.array([1.0, 0.7, 0.2])
    signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 9)).reshape(9, -1).T
    explained = ((signs @ parts) ** 2) @ kept / 1.3**2
    signed = np.zeros(9, dtype=bool)
    mean, variance = flip_moments(parts, kept, 1.3, signed)
    assert mean == pytest.approx(explained.mean())
    assert variance == pytest.approx(explained.var())
    one = flip_moments(parts * (np.arange(9) == 4)[:, None], kept, 1.0, signed)  # one unit holds all: no evidence
    assert tail_of(one, 1e6) == 0.0


def test_moments_are_those_of_flips_and_draws():
    rng = np.random.default_rng(8)
    parts, kept = rng.standard_normal((9, 3)), np.array([1.0, 0.7, 0.2])
    drawn = np.arange(9) >= 6
    times = np.where(drawn, rng.standard_normal((400_000, 9)), rng.choice([-1.0, 1.0], (400_000, 9)))
    explained = ((times @ parts) ** 2) @ kept
    mean, variance = flip_moments(parts, kept, 1.0, drawn)
    assert mean == pytest.approx(explained.mean(), rel=0.02)
    assert variance == pytest.approx(explained.var(), rel=0.05)


def test_a_pull_on_a_prior_is_evidence():
    """A number known to within one was fitted eight off: what explains it has little in the rows themselves."""
    rng = np.random.default_rng(10)
    J = rng.standard_normal((200, 2))
    rows, known = np.vstack([J, [[1.0, 0.0]]]), np.r_[np.zeros(200), 1.0]
    for pull, sure in ((8.0, True), (0.5, False)):
        y = J[:, 0] * pull + rng.standard_normal(200)
        r, basis = np.r_[y, 0.0] - rows @ np.linalg.solve(rows.T @ rows, rows.T @ np.r_[y, 0.0]), np.linalg.qr(rows)[0]
        sp = Space(r, basis, np.arange(201), 1.0, 199, 200, known[200:])
        (found,) = score(sp, [candidate(J[:, :1])])
        assert found.retained < 0.05
        (found,), null = with_null(sp, [found], 199, 0)
        p = null.p_familywise(found.log_p)
        assert (p == pytest.approx(1 / 200)) if sure else (p > 0.05)


def test_a_wide_candidate_does_not_hide_a_narrow_one():
    """Entries share their unit's noise, so that hundreds of columns explain far more of it than chi-square says."""
    rng = np.random.default_rng(9)
    unit = np.repeat(np.arange(120), 4)
    D, wide = rng.standard_normal((480, 1)), rng.standard_normal((480, 200))
    y = rng.standard_normal(120)[unit] + 0.3 * rng.standard_normal(480) + 0.35 * D[:, 0]
    sp = space(rng.standard_normal((480, 5)), y, unit)
    wide = np.cumsum(wide, axis=1)  # smooth along a unit's entries as the noise is
    wide[:] = wide.reshape(120, 4, 200).mean(axis=1)[unit]
    scored = score(sp, [candidate(D, "true"), candidate(wide, "wide")])
    raw = scored
    scored, null = with_null(sp, raw, 199, 0)
    assert null.p_familywise(scored[0].log_p) == pytest.approx(1 / 200)
    assert null.p_familywise(scored[1].log_p) > 0.05


def test_insignificant_candidates_rank_after_significant_ones():
    """Ten times the noise in a few units: what acts there explains much of it, and its own flips do so, too."""
    rng = np.random.default_rng(11)
    unit = np.repeat(np.arange(100), 4)
    loud = unit < 10
    y = np.where(loud, 10.0 * rng.standard_normal(100)[unit], rng.standard_normal(400))
    D = np.where(loud, 0.0, rng.standard_normal(400))[:, None]
    there = np.where(loud, rng.standard_normal(100)[unit] + y / 10, 0.0)[:, None]
    sp = space(rng.standard_normal((400, 5)), y + 2.0 * D[:, 0], unit)
    scored = score(sp, [candidate(D, "true"), candidate(there, "loud")])
    raw = scored
    scored, null = with_null(sp, raw, 199, 0)
    assert max(scored, key=lambda s: s.bic).candidate.name == "loud"
    assert null.p_familywise(scored[1].log_p) > DICTIONARY_FALSE_ALARMS
    best = CandidateScores(sp, scored, [], null, null, None, unit).best()
    assert best is not None
    assert best.candidate.name == "true"
    assert CandidateScores(sp, scored[1:], [], null, null, None, unit).best() is None
