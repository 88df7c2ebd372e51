"""Numbers of joints in the figure of the error budget: none covers another."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from clampid.report.budget_section import RING_HEIGHTS, RING_WIDTH, _apart

SPREAD = st.lists(st.floats(0.0, 1.0), min_size=1, max_size=7)


def test_rings_that_would_cover_each_other_are_drawn_at_different_heights():
    at = np.array([0.50, 0.51, 0.515, 0.90, 0.51])
    row = np.array([0, 0, 0, 0, 1])
    assert set(_apart(at, row)[:3]) == set(RING_HEIGHTS)
    np.testing.assert_array_equal(_apart(at, row)[3:], 0.0)


@given(SPREAD)
def test_two_rings_cover_each_other_only_where_three_others_are_as_near(places: list[float]):
    at = np.array(places)
    height = _apart(at, np.zeros(len(at), dtype=np.int64))
    for a, b in combinations(range(len(at)), 2):
        if abs(at[a] - at[b]) < RING_WIDTH and height[a] == height[b]:
            near = np.sum(np.abs(at - max(at[a], at[b])) < RING_WIDTH)
            assert near > len(RING_HEIGHTS)
