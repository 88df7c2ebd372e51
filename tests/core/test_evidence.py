"""The evidence of a prior's size: its closed form, the size that it finds, and a curve of that size on a robot."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clampid.catalogue import catalogue
from clampid.diagnosis.diagnose import diagnose
from clampid.evidence.of_size import ANY_SIZE, evidence, of_any_size, of_size
from clampid.identification.identify import identify
from clampid.models.curves import angle_errors
from clampid.slots import Slot
from experiments.campaign import Campaign
from experiments.virtual_robot import Hidden, measure
from kinematics.description import load_robot

Simulated = Callable[..., Campaign]

STANDARD = ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction")
WEAK_DISC = "encoder_disc:0.55"
"""Read at this size, it leaves errors of the points of about 0.8 of their noise."""


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), size=st.floats(0.01, 10.0))
def test_directions_say_what_the_matrices_do(seed: int, size: float):
    rng = np.random.default_rng(seed)
    X, r, prior = rng.normal(size=(30, 8)), rng.normal(size=30), rng.uniform(0.1, 2.0, size=8)
    information, score = X.T @ X, X.T @ r
    told, vectors = np.linalg.eigh(information * np.outer(prior, prior))
    component = (prior * score @ vectors) / np.sqrt(told)
    direct, mean = evidence(information, score, size * prior)
    assert float(of_size(size, told, component)) == pytest.approx(direct, rel=1e-8, abs=1e-8)
    # Against the same from the rows' joint normal distribution, in which the amplitudes never appear.
    covariance = np.eye(30) + X @ np.diag((size * prior) ** 2) @ X.T
    by_rows = -0.5 * (r @ np.linalg.solve(covariance, r) - r @ r + np.linalg.slogdet(covariance)[1])
    assert direct == pytest.approx(by_rows, rel=1e-8, abs=1e-8)
    np.testing.assert_allclose(X.T @ (r - X @ mean), mean / (size * prior) ** 2, atol=1e-8)


def test_evidence_of_any_size_is_the_mean_over_sizes():
    told, component = np.array([400.0, 3.0]), np.array([6.0, 0.5])
    each = [evidence(np.diag(told), component * np.sqrt(told), np.full(2, size))[0] for size in ANY_SIZE]
    assert of_any_size(told, component) == pytest.approx(np.log(np.mean(np.exp(each))), rel=1e-12)


@settings(max_examples=50, deadline=None)
@given(told=st.floats(1e-1, 1e5), z=st.floats(3.0, 30.0), idle=st.integers(1, 30))
def test_undetermined_parameters_have_no_bic_cost(told: float, z: float, idle: int):
    """A fixed charge for each number would let one wrong number stand before several right ones."""
    alone = of_any_size(np.array([told]), np.array([z]))
    beside = of_any_size(np.r_[told, np.full(idle, 1e-12)], np.r_[z, np.zeros(idle)])
    assert beside == pytest.approx(alone, abs=1e-4)


def test_noise_is_rarely_evidence_of_an_effect():
    """Of what is not there the mean Bayes factor is at most one: odds of twenty come less than once in twenty times."""
    rng = np.random.default_rng(5)
    told = np.array([900.0, 40.0, 5.0, 0.1])
    found = np.array([of_any_size(told, rng.standard_normal(4)) for _ in range(4000)])
    assert np.mean(found > np.log(20.0)) < 0.05


@pytest.mark.parametrize("size", [0.05, 0.2, 1.0])
def test_the_largest_evidence_is_at_the_size_that_amplitudes_have(size: float):
    rng = np.random.default_rng(3)
    told = rng.uniform(1.0, 400.0, size=2_000)
    component = np.sqrt(1.0 + size**2 * told) * rng.normal(size=2_000)
    sizes = size * np.linspace(0.5, 2.0, 61)
    best = sizes[np.argmax(of_size(sizes, told, component))]
    assert best == pytest.approx(size, rel=0.1)


def curve_rms(seed: int) -> float:
    """What the hidden discs of the default robot amount to, rms over a turn and the joints, rad."""
    truth = measure(load_robot("kuka_kr20_r1810"), [Hidden.parse(WEAK_DISC)], seed=seed, poses=2, tables=("poses",))
    disc = truth.truth.plant.drive.disc
    mark = disc - disc.mean(axis=1, keepdims=True)
    following = np.roll(mark, -1, axis=1)  # straight from mark to mark
    return float(np.sqrt(np.mean((mark**2 + mark * following + following**2) / 3.0)))


@pytest.fixture(scope="module")
def weak(simulated: Simulated) -> Campaign:
    return simulated(seed=2, poses=200, tables=("poses", "verification"), hidden=(WEAK_DISC,))


@pytest.mark.slow
def test_a_fit_finds_how_large_the_curves_are(weak: Campaign):
    model = identify(weak, (*STANDARD, "joint_angle_curve"))
    found = model.stages["poses"].values()[Slot("joint_angle_curve", "rms", "robot")]
    assert found == pytest.approx(curve_rms(2), rel=0.4)
    errors = angle_errors(model.stages["poses"], catalogue(), model.layout, weak.robot, np.zeros((1, 6)))
    np.testing.assert_allclose(errors.assumed, found, rtol=0.1)


@pytest.mark.slow
def test_curves_smaller_than_the_noise_are_named(weak: Campaign):
    found = diagnose(identify(weak, STANDARD), weak).stages["poses"]
    assert (found.verdict, found.candidates[0]["name"]) == ("missing", "joint_angle_curve")
    assert found.after < 0.9 * found.before
