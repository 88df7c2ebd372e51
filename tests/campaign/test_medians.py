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
@given(NUMBERS, NUMBERS, st.integers(1, 7), st.sampled_from([0, 5, 40, 1 << 20]))
def test_they_are_those_of_numpy(first: list[float], second: list[float], pieces: int, held: int) -> None:
    def stream() -> Iterator[list[np.ndarray]]:
        parts = zip(np.array_split(first, pieces), np.array_split(second, pieces), strict=True)
        yield from ([a, b] for a, b in parts)

    np.testing.assert_array_equal(medians(stream, held), [np.median(first), np.median(second)])


@pytest.mark.parametrize("held", [0, 1 << 20])
def test_nothing_has_no_median(held: int) -> None:
    found = medians(lambda: iter([[np.zeros(0), np.ones(3)]]), held)
    np.testing.assert_array_equal(found, [np.nan, 1.0])


@pytest.mark.parametrize("place", [0, 2, 4])
def test_what_is_held_has_no_median_where_a_number_is_missing(place: int) -> None:
    values = np.array([3.0, 1.0, 2.0, 5.0, 4.0])
    values[place] = np.nan
    assert np.isnan(medians(lambda: iter([[values]]))).all()


def test_a_long_stream_is_gone_through_twice() -> None:
    numbers, passes = np.random.default_rng(0).standard_normal((20, 1000, 2)), []

    def stream() -> Iterator[list[np.ndarray]]:
        passes.append(1)
        yield from ([np.abs(piece[:, 0]), piece[:, 1]] for piece in numbers)

    found = medians(stream, capacity=20_000)
    np.testing.assert_array_equal(found, [np.median(np.abs(numbers[..., 0])), np.median(numbers[..., 1])])
    assert len(passes) == 2


def test_numbers_that_are_all_alike_cannot_be_held_and_need_not_be() -> None:
    alike = np.full(1000, 0.004)
    np.testing.assert_array_equal(medians(lambda: iter([[alike, alike[:0]]]), capacity=10), [0.004, np.nan])
