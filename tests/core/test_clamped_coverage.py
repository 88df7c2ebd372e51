"""Do the clamped stage's intervals hold the truth, and is a clearance told from zero where its limit says so?

The study itself is benchmarks/clamped_coverage.py; the virtual robot shares no code with the effects.
"""

from __future__ import annotations

from functools import cache

import clamped_coverage
import numpy as np
import pytest

FEW, MANY = range(6), range(200)


@cache
def pairs(seeds: range) -> list:
    return [clamped_coverage.pair(seed) for seed in seeds]


@pytest.mark.slow
def test_intervals_hold_the_truth():
    first = [p[0] for p in pairs(FEW)]
    off = np.array([t.off[:12] for t in first])
    # 72 numbers, of which 95 % should be inside: fewer than 64 would be, were they independent, one case in 100.
    assert clamped_coverage.covered(first)[:12].mean() >= 0.88
    assert 0.75 < np.sqrt(np.mean(off**2)) < 1.25
    for t in first:  # and they tell something
        assert np.all(t.std[:6] < 0.02 * t.true[:6])


@pytest.mark.slow
def test_cross_terms_are_right_in_sign_and_size():
    for t, _ in pairs(FEW):
        assert np.all(np.sign(t.found[18:]) == np.sign(t.true[18:]))
        np.testing.assert_allclose(t.found[18:], t.true[18:], rtol=0.03)
        assert np.all(np.abs(t.off[18:]) < 4)


@pytest.mark.study
def test_the_naive_reading_of_the_transmission_fails_the_same_test():
    found = [clamped_coverage.trial(seed, naive=True) for seed in range(2)]
    assert clamped_coverage.covered(found)[18:].max() == 0.0
    for t in found:
        assert not np.any(np.isclose(t.found[18:], t.true[18:], rtol=0.5))


@pytest.mark.slow
def test_clearances_differ_from_zero_where_the_limit_says():
    small, large = clamped_coverage.told([p[1] for p in pairs(FEW)])
    assert small.size == large.size == 18
    assert small.sum() <= 2  # 5 % are 0.9
    assert large.sum() == 18


@pytest.mark.study
@pytest.mark.timeout(3600)
def test_two_hundred_seeds():
    first, second = ([p[k] for p in pairs(MANY)] for k in (0, 1))
    share = clamped_coverage.covered(first)
    assert 0.93 <= share[:12].mean() <= 0.97
    assert np.all((share[:12] >= 0.88) & (share[:12] <= 0.995)), share[:12]
    assert 0.90 <= share[12:18].mean() <= 0.97
    assert 0.90 <= share[18:].mean() <= 0.99
    small, large = clamped_coverage.told(second)
    assert small.mean() <= 0.05
    assert large.mean() >= 0.95
    assert np.all(np.abs(clamped_coverage.limit_ratio(second) - 1.0) < 0.3)
    wrist = np.degrees(np.median([t.drives.gap_limit[3:] for t in first], axis=0))
    assert np.all(wrist > 0.002)
