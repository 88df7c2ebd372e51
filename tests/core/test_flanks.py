"""Flanks: where a gear rests is decided by loads and by friction that is not negative; a fit follows them and ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clampid.catalogue import catalogue
from clampid.fitting.flanks import mirrored, settled
from clampid.identification.fitted_stage import active_slots
from clampid.identification.identify import identify, stage_rows
from clampid.slots import Term
from clampid.stages.fit_problem import FitProblem, fit_problem
from clampid.stages.layout import layout_of
from experiments.campaign import Campaign

Simulated = Callable[..., Campaign]
STANDARD = ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction")


@pytest.fixture(scope="module")
def poses(simulated: Simulated) -> FitProblem:
    campaign = simulated(seed=4, poses=12, tables=("poses",))
    rows = stage_rows([campaign], layout_of([campaign]), "poses")
    return fit_problem(rows, catalogue(), active_slots(rows, catalogue(), [Term(name) for name in STANDARD]))


def friction_at(trial: FitProblem, size: float) -> np.ndarray:
    """Parameters at their start, dry friction at all joints ``size``, Nm."""
    theta = trial.start()
    theta[[s.effect == "wrist_coupling_friction" for s in trial.slots]] = size
    return theta


@settings(max_examples=20, deadline=None)
@given(size=st.floats(-50.0, 0.0))
def test_an_estimate_below_zero_decides_as_no_friction_does(poses: FitProblem, size: float):
    none, below = (poses.with_flanks(friction_at(poses, f)).rows.signals["flank"] for f in (0.0, size))
    np.testing.assert_array_equal(none, below)


def test_joint_1_of_an_arm_on_the_floor_rests_where_it_came_from(poses: FitProblem):
    for size in (-5.0, 0.0, 5.0):
        flank = poses.with_flanks(friction_at(poses, size)).rows.signals["flank"]
        np.testing.assert_array_equal(flank[:, 0], poses.rows.signals["direction"][:, 0])


def test_friction_above_zero_decides(poses: FitProblem):
    small, large = (poses.with_flanks(friction_at(poses, f)).rows.signals["flank"] for f in (0.0, 1e3))
    assert (small != large).any()
    np.testing.assert_array_equal(large, poses.rows.signals["direction"])


@dataclass(frozen=True)
class Point:
    theta: np.ndarray


def flanks_of(side: float) -> Sequence[Any]:
    return [SimpleNamespace(rows=SimpleNamespace(signals={"flank": np.array([side])}))]


def side_of(held: Sequence[Any]) -> float:
    return float(held[0].rows.signals["flank"][0])


@pytest.mark.parametrize("start", [-2.0, 2.0])
def test_flanks_that_come_round_end_at_the_lower_of_the_two(start: float):
    """Held on either side the load comes out on the other; what counts is the cost on the flanks that it has there."""
    tried = []

    def search(held: Sequence[Any], theta: np.ndarray) -> Point:
        tried.append(side_of(held))
        return Point(np.array([-side_of(held)]))

    found = settled(
        np.array([start]),
        lambda theta: flanks_of(np.sign(theta[0])),
        search,
        lambda held, theta: 3.0 + side_of(held),
    )
    assert found.theta[0] == -1.0
    assert set(tried) == {-1.0, 1.0}
    assert len(tried) <= 3  # each side, and the lower one again from where it has ended


def test_flanks_that_stay_end_the_search():
    found = settled(
        np.array([-0.5]),
        lambda theta: flanks_of(np.sign(theta[0])),
        lambda held, theta: Point(theta + 1.0 if theta[0] < 2.0 else theta),
        lambda held, theta: 0.0,
    )
    assert found.theta[0] == 1.5


def test_a_spring_and_a_friction_below_zero_are_a_mirror_image(poses: FitProblem):
    theta = friction_at(poses, 2.0)
    at = {s.label: k for k, s in enumerate(poses.slots)}
    spring, friction = at["joint_compliance.c@joint6"], at["wrist_coupling_friction.F@joint6"]
    theta[[at[f"joint_compliance.c@joint{j + 1}"] for j in range(6)]] = 0.5
    assert mirrored(poses, theta) is None
    theta[friction] = -3.0
    assert mirrored(poses, theta) is None  # friction alone is an error, which has no image
    theta[spring] = -1.2
    image = mirrored(poses, theta)
    assert image is not None
    assert (image[friction], image[spring]) == (3.0, 1.2)
    np.testing.assert_array_equal(np.delete(image, [friction, spring]), np.delete(theta, [friction, spring]))


@pytest.mark.slow
def test_a_search_that_began_on_the_wrong_side_ends_on_the_right_one(simulated: Simulated):
    """The torques give this robot's joint 6 a friction below zero to begin with, by their error."""
    campaign = simulated(seed=11, poses=100, tables=("free_air", "wrist", "clamped", "poses"))
    model = identify(campaign, holdout=0.2, seed=11)
    values = {s.label: v for s, v in model.stages["free_air"].values().items()}
    assert values["wrist_coupling_friction.F@joint6"] < 0.0
    found = {s.label: v for s, v in model.stages["poses"].values().items()}
    assert found["wrist_coupling_friction.F@joint6"] > 0.0
    assert found["joint_compliance.c@joint6"] > 0.0
    assert model.ledger[-1].heldout_rms < 1.1 * model.ledger[-1].noise_floor
