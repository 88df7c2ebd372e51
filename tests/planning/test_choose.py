"""D-optimal choice: what the updates say is what the determinant does, and the choice beats chance."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clampid.planning import choose, exchange, greedy, log_det, observability
from clampid.planning.choose import _Design, factor, factors_of

seeds = st.integers(0, 10_000)


def candidates(seed: int, count: int = 60, P: int = 7, r: int = 2) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((count, P, r)) * rng.lognormal(0, 1, (count, 1, 1))


def value(factors: np.ndarray, prior: np.ndarray, chosen: list[int]) -> float:
    return log_det(prior + sum(factors[k] @ factors[k].T for k in chosen))


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_gains_and_updates_are_what_the_determinant_does(seed: int) -> None:
    F, prior = candidates(seed), 0.1 * np.eye(7)
    state = _Design(prior)
    gains = state.gains(F)
    for k in (0, 5, 9):
        assert gains[k] == pytest.approx(value(F, prior, [k]) - log_det(prior), abs=1e-9)
    for k in range(8):
        state.change(F[k], 1.0)
    state.change(F[3], -1.0)
    kept = [k for k in range(8) if k != 3]
    A = prior + sum(F[k] @ F[k].T for k in kept)
    assert np.allclose(state.inverse @ A, np.eye(7), atol=1e-7)


def test_factors_of_different_rank_give_their_matrices_back() -> None:
    rng = np.random.default_rng(0)
    wide, narrow = rng.standard_normal((5, 4)), rng.standard_normal((5, 1))
    informations = [wide @ wide.T, narrow @ narrow.T]
    F = factors_of(informations)
    assert F.shape == (2, 5, 4)
    assert not F[1, :, 1:].any()
    assert np.allclose(np.einsum("cpr,cqr->cpq", F, F), informations)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_the_choice_beats_random_ones_of_the_same_size_and_exchange_never_loses(seed: int) -> None:
    F, prior = candidates(seed), 1e-3 * np.eye(7)
    first = greedy(F, prior, count=10)
    better = exchange(F, prior, first)
    assert len(set(better)) == len(first) == 10
    assert value(F, prior, better) >= value(F, prior, first) - 1e-9
    rng = np.random.default_rng(seed)
    chance = [value(F, prior, list(rng.choice(60, 10, replace=False))) for _ in range(50)]
    assert value(F, prior, better) > max(chance)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_a_budget_is_kept_and_what_is_fixed_stays(seed: int) -> None:
    F, prior = candidates(seed), 1e-3 * np.eye(7)
    cost = np.random.default_rng(seed).uniform(1.0, 5.0, len(F))
    picked = greedy(F, prior, cost=cost, budget=20.0, start=[7])
    swapped = exchange(F, prior, picked, cost=cost, budget=20.0, fixed=[7])
    for chosen in (picked, swapped):
        assert cost[chosen].sum() <= 20.0 + 1e-9
        assert chosen[0] == 7


def test_the_choice_of_few_is_the_best_of_all() -> None:
    from itertools import combinations

    F, prior = candidates(3, count=12, P=3, r=1), 1e-3 * np.eye(3)
    best = max(value(F, prior, list(some)) for some in combinations(range(12), 4))
    assert value(F, prior, choose(F, prior, 4)) == pytest.approx(best, abs=0.2)


def test_a_factor_gives_its_matrix_back_and_is_as_narrow_as_its_rank() -> None:
    B = np.random.default_rng(0).standard_normal((6, 2))
    F = factor(B @ B.T)
    assert F.shape == (6, 2)
    assert np.allclose(F @ F.T, B @ B.T)


def test_indices_are_what_their_sources_define() -> None:
    s = np.array([8.0, 4.0, 2.0])
    found = observability(np.diag(s**2), rows=16)
    assert found["O1"] == pytest.approx(4.0 / 4.0)
    assert found["O2"] == pytest.approx(0.25)
    assert found["O3"] == pytest.approx(2.0)
    assert found["O4"] == pytest.approx(0.5)
    assert found["O5"] == pytest.approx(1 / (1 / 8 + 1 / 4 + 1 / 2))
    assert found["parameters"] == 3


def test_directions_below_a_usual_size_are_not_counted() -> None:
    found = observability(np.diag([9.0, 4.0, 0.5, 0.0]), rows=4)
    assert (found["parameters"], found["O3"]) == (2, 2.0)
    assert observability(np.zeros((2, 2)), 0)["O1"] == 0.0
