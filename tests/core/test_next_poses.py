"""Poses to measure next: chosen where look-alikes differ, worth what they say, and a plan that the runner accepts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clampid.catalogue import catalogue
from clampid.diagnosis.next_measurement import ENOUGH, NextPlan
from clampid.diagnosis.next_poses import next_poses, plan_of, poses_of
from clampid.diagnosis.parting import part
from clampid.diagnosis.refit_signals import Normal, Rivals
from clampid.evidence.candidates import named_candidates
from clampid.evidence.score import score
from clampid.evidence.space import space_of
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from experiments.campaign import Campaign
from experiments.plans.limits import limits_of
from experiments.plans.read import read_plan
from experiments.plans.write import write_plan


def _left(X: np.ndarray, y: np.ndarray) -> float:
    return float(np.sum((y - X @ np.linalg.lstsq(X, y, rcond=None)[0]) ** 2))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_evidence_is_what_a_refit_of_the_other_leaves(seed: int):
    rng = np.random.default_rng(seed)
    J, pool_J = rng.standard_normal((60, 4)), rng.standard_normal((30, 3, 4))
    a, b = rng.standard_normal((2, 60, 2))
    pool_a, pool_b = rng.standard_normal((2, 30, 3, 2))
    values = [np.array([0.3, -0.2]), np.array([0.1, 0.4])]
    found = part(
        Rivals(J, [a, b], values, 1e-9 * np.eye(4)), pool_J, [pool_a, pool_b], enough=1e9, batch=5, most=10
    )  # fmt: skip
    assert len(set(found.chosen)) == 10

    def closest(chosen: list[int]) -> float:
        wide = [np.concatenate([D, P[chosen].reshape(-1, D.shape[1])]) for D, P in ((a, pool_a), (b, pool_b))]
        base = np.concatenate([J, pool_J[chosen].reshape(-1, 4)])
        return min(_left(np.c_[base, wide[1]], wide[0] @ values[0]), _left(np.c_[base, wide[0]], wide[1] @ values[1]))

    assert found.before == pytest.approx(closest([]), rel=1e-5)
    assert found.after == pytest.approx(closest(list(found.chosen)), rel=1e-5)
    assert found.after >= found.before


def test_measurements_that_distinguish_candidates_are_chosen():
    rng = np.random.default_rng(0)
    J, a = rng.standard_normal((80, 3)), rng.standard_normal((80, 1))
    pool_J, pool_a = rng.standard_normal((40, 3, 3)), rng.standard_normal((40, 3, 1))
    pool_b = pool_a.copy()
    pool_b[7::10] *= -1.0  # only there do they differ
    found = part(Rivals(J, [a, a], [np.ones(1)] * 2, np.eye(3)), pool_J, [pool_a, pool_b], enough=1e9, batch=2, most=4)
    assert sorted(found.chosen) == [7, 17, 27, 37]
    assert found.before == pytest.approx(0.0, abs=1e-6)
    same = part(Rivals(J, [a, a], [np.ones(1)] * 2, np.eye(3)), pool_J, [pool_a, pool_a], enough=1.0, batch=2, most=10)
    assert same.after == pytest.approx(0.0, abs=1e-6)  # nothing parts what is the same everywhere


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_the_spread_of_predictions_is_the_same_whether_updated_or_found_anew(seed: int):
    rng = np.random.default_rng(seed)
    X, pool_X = rng.standard_normal((20, 6)), rng.standard_normal((15, 3, 6))
    X[:, 5] = 1e-9 * X[:, 4]  # the rows so far say nothing of it, the pool does
    updated = Normal(X, np.zeros((6, 6)), pool_X)
    assert updated.spread.shape == (15, 3, 3)
    for k in (4, 9, 2):
        updated.add(k)
    anew = Normal(np.vstack([X, *pool_X[[4, 9, 2]]]), np.zeros((6, 6)), pool_X)
    np.testing.assert_allclose(updated.spread, anew.spread, rtol=1e-6, atol=1e-6)


def test_candidates_lie_inside_the_ranges_and_some_at_their_ends(simulated: Callable[..., Campaign]):
    campaign = simulated(seed=7, poses=60, tables=("poses",))
    everything = NextPlan("parting", tuple(range(1000)), 1000, "warm", ("pose", "poses"), "", None)
    q = poses_of(campaign, everything, seed=0).q
    limits, _ = limits_of(campaign.robot)
    lower, upper = q.min(axis=0), q.max(axis=0)
    assert np.all(lower > limits.lower)
    assert np.all(upper < limits.upper)
    at_end = (q == lower) | (q == upper)
    assert 0.1 < at_end.any(axis=1).mean() < 0.6
    assert np.all(at_end.mean(axis=0) > 0.02)  # of every joint
    assert len(np.unique(q, axis=0)) == len(q)


def test_poses_part_an_eccentric_gear_from_a_wrong_ratio(simulated: Callable[..., Campaign], tmp_path: Path):
    campaign = simulated(seed=7, poses=60, tables=("poses",))
    estimate = on_campaign(identify(campaign), campaign).refit("poses").estimate
    space = space_of(estimate)
    effects = {n: catalogue()[n] for n in ("gear_eccentricity", "coupling_ratio_error")}
    scored = [s for s in score(space, named_candidates(estimate, effects)) if s.candidate.places == ("joint2",)]
    assert len(scored) == 2
    # As large as is just told from noise.
    weak = [replace(s, amplitude=np.full(s.freedom, 4.0 * space.scale / s.freedom**0.5)) for s in scored]
    found = next_poses(campaign, estimate, weak, space.scale, seed=0)
    assert found is not None
    assert found.before < ENOUGH <= found.after
    assert len(found.q) % 5 == 0
    path = write_plan(plan_of(campaign, found), tmp_path / "next.toml")
    plan = read_plan(path)
    assert plan.kind == "poses"
    assert len(plan.visits) == len(found.q)
    for visit in plan.visits:
        k = int(np.argmin(np.abs(found.q - visit.q).max(axis=1)))
        np.testing.assert_array_equal(np.sign(visit.q - visit.via), found.direction[k])


def test_no_plan_without_candidates_to_distinguish(simulated: Callable[..., Campaign]):
    campaign = simulated(seed=7, poses=60, tables=("poses",))
    estimate = on_campaign(identify(campaign), campaign).refit("poses").estimate
    assert next_poses(campaign, estimate, [], 1.0, seed=0) is None
