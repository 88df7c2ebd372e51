"""Medians of streams are numpy's, whether the numbers are held or only counted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.signals import medians

NUMBERS = st.lists(st.floats(-1e6, 1e6, allow_nan=False), min_size=1, max_size=60)


@settings(max_examples=60, deadline=None)
@given(NUMBERS, NUMBERS, st.integers(1, 7), st.sampled_from([0, 1 << 20]))
def test_they_are_those_of_numpy(first: list[float], second: list[float], pieces: int, held: int) -> None:
    def stream() -> Iterator[list[np.ndarray]]:
        parts = zip(np.array_split(first, pieces), np.array_split(second, pieces), strict=True)
        yield from ([a, b] for a, b in parts)

    np.testing.assert_array_equal(medians(stream, held), [np.median(first), np.median(second)])


@pytest.mark.parametrize("held", [0, 1 << 20])
def test_nothing_has_no_median(held: int) -> None:
    found = medians(lambda: iter([[np.zeros(0), np.ones(3)]]), held)
    np.testing.assert_array_equal(found, [np.nan, 1.0])
