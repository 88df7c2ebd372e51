"""Dry friction with a state: the states along a log, and a model that knows the friction of a motor at rest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clampid.add import add
from clampid.compare import compare
from clampid.effect import PRESLIDING_LENGTHS, RELAXATION_TIMES
from clampid.identify import identify
from clampid.stages.presliding import dry_states, recurrence
from experiments.campaign import Campaign

STATES = [(s, t) for s in PRESLIDING_LENGTHS for t in RELAXATION_TIMES]


def _states(turned: list[float], step: float = 0.01) -> np.ndarray:
    """States ``(N, S x K)`` of one motor that turns by these angles, rad, one every ``step`` seconds."""
    moved = np.array(turned)[:, None]
    time = step * np.arange(len(turned))
    return dry_states(moved, time, np.zeros(len(turned), dtype=np.int64))[:, 0]


def test_long_motion_ends_at_its_sign():
    z = _states([0.0, *[1.0] * 5, *[-1.0] * 5])
    np.testing.assert_allclose(z[5], 1.0, atol=0.01)
    np.testing.assert_allclose(z[-1], -1.0, atol=0.01)


@pytest.mark.parametrize(("length", "time"), STATES)
def test_reversal_builds_up_as_dahl_has_it(length: float, time: float):
    travels = length * np.array([0.1, 0.5, 1.0, 3.0])
    column = STATES.index((length, time))
    for travel in travels:  # so fast that nothing relaxes
        z = _states([0.0, 1.0, -travel], step=1e-9)[-1, column]
        assert z == pytest.approx(-1.0 + 2.0 * np.exp(-travel / length), abs=1e-6)


@pytest.mark.parametrize(("length", "time"), STATES)
def test_rest_relaxes_exponentially(length: float, time: float):
    z = _states([0.0, 1e3, *[0.0] * 50], step=0.02)[:, STATES.index((length, time))]
    np.testing.assert_allclose(z[2:] / z[1], np.exp(-0.02 * np.arange(1, 51) / time), rtol=1e-12)


@settings(max_examples=60, deadline=None)
@given(
    turned=st.lists(st.floats(-0.05, 0.05), min_size=1, max_size=60),
    parts=st.integers(2, 5),
)
def test_states_are_bounded_odd_and_independent_of_the_sampling(turned: list[float], parts: int):
    z = _states([0.0, *turned])
    assert np.all(np.abs(z) <= 1.0)
    np.testing.assert_allclose(_states([0.0, *(-np.array(turned))]), -z, atol=1e-15)
    finer = _states([0.0, *np.repeat(np.array(turned) / parts, parts)], step=0.01 / parts)
    np.testing.assert_allclose(finer[::parts], z, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(count=st.integers(1, 200), seed=st.integers(0, 2**32 - 1))
def test_recurrence_in_blocks_is_the_recurrence(count: int, seed: int):
    rng = np.random.default_rng(seed)
    decay, gain = rng.uniform(0.0, 1.0, (count, 3)), rng.normal(size=(count, 3))
    expected, now = np.empty((count, 3)), np.zeros(3)
    for i in range(count):
        expected[i] = now = decay[i] * now + gain[i]
    np.testing.assert_allclose(recurrence(decay, gain), expected, rtol=1e-12, atol=1e-12)


def test_runs_know_nothing_of_each_other():
    turned = np.array([0.0, 1.0, 1.0, 5.0, 0.0])[:, None]
    z = dry_states(turned, np.arange(5.0), np.array([0, 0, 0, 1, 1]))
    np.testing.assert_array_equal(z[3:], 0.0)


def test_friction_that_creeps_at_rest_is_learned(simulated: Callable[..., Campaign]):
    """The hidden law is another one, of several contacts that slip: what is left beside noise must still be small."""
    campaign = simulated(seed=11, tables=("free_air",), hidden=("presliding_friction@joint2",))
    model = identify(campaign, holdout=0.2)
    mended, found = add(model, campaign, ["presliding_friction@joint2"])
    (addition,) = found.stages.values()
    # Judged by the same rows, those at rest among them, of which the old model takes the friction as held.
    assert addition.after.heldout_rms < 0.5 * addition.before.heldout_rms
    rows = [compare(m, campaign).tables["free_air"]["rows"] for m in (model, mended)]
    assert rows[1] > rows[0]
    values = {s.parameter: v for s, v in mended.stages["free_air"].values().items() if s.effect.startswith("presli")}
    assert 0.7 < values["c"] < 1.3
    assert RELAXATION_TIMES[0] < values["t"] < RELAXATION_TIMES[-1]
