"""Slipping elements: held between −1 and 1, wound up by motion, and forgetful only where they are told to be."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from experiments.signals import slip_states

paths = arrays.arrays(float, (40, 2), elements=st.floats(-1.0, 1.0))
WIDTHS = np.array([[0.1, 0.5], [0.2, 3.0]])
ONE = np.zeros(40, dtype=np.int64)


@given(paths)
def test_states_stay_between_their_limits(path):
    assert np.abs(slip_states(path, WIDTHS, ONE)).max() <= 1.0


@given(paths)
def test_an_element_that_never_slips_is_a_spring(path):
    wide = np.full((2, 1), 100.0)
    np.testing.assert_allclose(slip_states(path, wide, ONE)[:, :, 0], (path - path[0]) / 100.0, atol=1e-12)


@given(paths)
def test_motion_the_other_way_gives_the_opposite(path):
    np.testing.assert_array_equal(slip_states(-path, WIDTHS, ONE), -slip_states(path, WIDTHS, ONE))


@given(paths, st.floats(0.1, 10.0))
def test_only_motion_over_width_counts(path, factor):
    a, b = slip_states(path, WIDTHS, ONE), slip_states(factor * path, factor * WIDTHS, ONE)
    np.testing.assert_allclose(a, b, atol=1e-9)


@given(paths)
def test_smaller_motions_in_between_are_forgotten(path):
    """A closed excursion leaves a state as it was (Madelung's rule), unless it went beyond what came before."""
    there = np.vstack([[[0.0, 0.0], [2.0, 2.0]], 2.0 - 0.3 * (path + 1.0), [[2.0, 2.0]]])
    states = slip_states(there, WIDTHS, np.zeros(len(there), dtype=np.int64))
    np.testing.assert_allclose(states[-1], np.minimum(states[1], 1.0), atol=1e-9)


def test_after_a_reversal_twice_the_width_turns_it_over():
    up = np.linspace(0.0, 1.0, 21)
    path = np.r_[up, up[-2::-1]][:, None]
    z = slip_states(path, np.array([[0.25]]), np.zeros(len(path), dtype=np.int64))[:, 0, 0]
    np.testing.assert_allclose(z[5:21], 1.0)
    np.testing.assert_allclose(z[21:31], 1.0 - np.arange(1, 11) / 5.0, atol=1e-12)
    np.testing.assert_allclose(z[31:], -1.0)


def test_a_new_stretch_starts_from_nothing():
    path = np.linspace(0.0, 1.0, 10)[:, None]
    stretch = np.repeat([0, 1], 5)
    z = slip_states(path, np.array([[0.2]]), stretch)[:, 0, 0]
    assert z[5] == 0.0
    assert z[4] == 1.0
