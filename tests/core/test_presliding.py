"""Dry friction with a state: the states along a log, and a model that knows the friction of a motor at rest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clampid.catalogue import catalogue
from clampid.comparison.compare import compare
from clampid.effect import PRESLIDING_LENGTHS, RELAXATION_TIMES
from clampid.fitting.accuracy import noise_floor
from clampid.identification.fitted_stage import fit_stage
from clampid.identification.identify import identify, stage_rows, standard_effects
from clampid.loop.add import add
from clampid.slots import Term
from clampid.stages.fit_problem import fit_problem
from clampid.stages.layout import layout_of
from clampid.stages.presliding import dry_states, friction_states, recurrence, with_play
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


@settings(max_examples=40, deadline=None)
@given(count=st.integers(1, 200), seed=st.integers(0, 2**32 - 1))
def test_a_play_follows_only_what_leaves_it(count: int, seed: int):
    rng = np.random.default_rng(seed)
    x, run, play = (
        np.cumsum(rng.normal(size=(count, 2)), axis=0),
        np.sort(rng.integers(0, 3, count)),
        np.array([0.0, 0.8]),
    )
    expected = x.copy()
    for i in range(1, count):
        if run[i] == run[i - 1]:
            expected[i] = np.clip(expected[i - 1], x[i] - play, x[i] + play)
    np.testing.assert_array_equal(with_play(x, play, run), expected)


@pytest.mark.parametrize("jitter", ["none", "noise", "count"])
def test_jitter_of_the_positions_does_not_wear_the_friction_down_at_rest(jitter: str):
    """A move of 0.1 rad, and then ten seconds of rest at 250 Hz."""
    rng, time = np.random.default_rng(1), 0.004 * np.arange(2750)
    angle, still = np.minimum(0.4 * np.maximum(time - 0.5, 0.0), 0.1), (time > 0.8) | (time < 0.45)
    shown = angle.copy()
    if jitter == "noise":
        shown += 1e-5 * rng.normal(size=len(time))
    elif jitter == "count":
        shown = 1e-5 * np.round((angle + 2e-6 * rng.normal(size=len(time)) + 4e-6) / 1e-5)
    run, shape = np.zeros(len(time), dtype=np.int64), (len(time), 1)
    found = friction_states(shown.reshape(shape), still.reshape(shape), time, run)[:, 0]
    true = dry_states(np.diff(angle, prepend=0.0).reshape(shape), time, run)[:, 0]
    after = time > 0.8
    once = 0.0 if jitter == "none" else 1e-5 / PRESLIDING_LENGTHS[0]  # by the jitter, when the motion ends
    assert np.abs(found - true)[after].max() < 2.0 * once + 1e-9
    if jitter != "none":  # without a play little is left of the states of short lengths
        worn = dry_states(np.diff(shown, prepend=0.0).reshape(shape), time, run)[:, 0]
        assert np.abs(worn - true)[after].max() > 0.5


def test_friction_state_of_a_run_ignores_other_runs():
    turned = np.array([0.0, 1.0, 1.0, 5.0, 0.0])[:, None]
    z = dry_states(turned, np.arange(5.0), np.array([0, 0, 0, 1, 1]))
    np.testing.assert_array_equal(z[3:], 0.0)


@pytest.mark.slow
def test_friction_that_creeps_at_rest_is_learned(simulated: Callable[..., Campaign]):
    """The hidden law is another one, of several contacts that slip; judged by a run that no fit has seen."""
    campaign = simulated(seed=11, tables=("free_air",), hidden=("presliding_friction@joint2",))
    effects, layout = catalogue(), layout_of([campaign])
    rows = stage_rows([campaign], layout, "free_air", active=[effects["presliding_friction"]])
    standard = standard_effects([campaign])["free_air"]
    seen = (rows.fold == 1) & rows.used[:, 1]
    excess = []
    for terms in (standard, (*standard, Term("presliding_friction", "joint2"))):
        fitted = fit_stage(rows, effects, terms, {}, held_out=((1,),))
        residual, _ = fit_problem(rows, effects, fitted.model.slots).residual(fitted.model.theta)
        sigma = noise_floor(rows, residual).sigma[1]
        excess.append(np.mean(residual[seen, 1] ** 2) / sigma**2 - 1.0)
    assert excess[0] > 1.0  # friction held at rest: as much error again as there is noise
    assert excess[1] < 0.2 * excess[0]
    values = {s.parameter: v for s, v in fitted.model.values().items() if s.effect == "presliding_friction"}
    assert values["c"] == pytest.approx(1.0, abs=0.2)
    assert 0.4 < 1.0 / values["r"] < 4.0  # contacts that creep at 0.8 to 1.6 /s, the wider ones slower


@pytest.mark.slow
def test_added_effect_lets_rows_at_rest_count(simulated: Callable[..., Campaign]):
    campaign = simulated(seed=11, tables=("free_air",), hidden=("presliding_friction@joint2",))
    model = identify(campaign)
    mended, found = add(model, campaign, ["presliding_friction@joint2"])
    assert found.stages["free_air"].after.rms < found.stages["free_air"].before.rms
    rows = [compare(m, campaign).tables["free_air"]["rows"] for m in (model, mended)]
    assert rows[1] > 1.2 * rows[0]
