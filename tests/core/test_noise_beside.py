"""What is significant is judged by the noise beside it, not by a noise that contains it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.diagnosis.candidate_scores import CandidateScores
from clampid.diagnosis.confirm import cross_fitted_fall
from clampid.diagnosis.noise_beside import with_equal_weights, with_noise_about_its_level, with_noise_beside
from clampid.diagnosis.probes import probes
from clampid.diagnosis.scoring import scored_beside_probes, scores_of
from clampid.diagnosis.wandering import level_beside, whitened_by
from clampid.evidence.flips import Flips
from clampid.evidence.score import Scored, score
from clampid.evidence.space import space_of
from clampid.fitting.fit import fit
from clampid.fitting.solve import Estimate
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from experiments.campaign import Campaign


@pytest.mark.parametrize("p", [0.005, 0.01, 0.02, 0.5])
def test_a_p_value_is_carried_to_another_null(p: float) -> None:
    null = Flips(np.random.default_rng(4).exponential(size=199))
    assert null.p_familywise(null.log_p_at(p)) == pytest.approx(p)


LABEL, MOTOR, SIZE = "products of q2 and q3 at motor4", 3, 0.8


@pytest.fixture(scope="module")
def clean(simulated: Callable[..., Campaign]) -> Estimate:
    campaign = simulated(seed=3, poses=40, tables=("free_air", "wrist", "poses"))
    opened = on_campaign(identify(campaign), campaign)
    return opened.refit("free_air", opened.rows("free_air")).estimate


@pytest.fixture(scope="module")
def lacking(clean: Estimate) -> Estimate:
    """The fit of the same log with an error of one motor's torque, as slow as its angles, which no effect describes."""
    rows = clean.problem.rows
    angles = rows.signals["q"]
    error = np.sin(angles[:, 1]) * np.cos(angles[:, 2])
    measured = rows.measured.copy()
    measured[:, MOTOR] += SIZE * clean.noise.sigma[:, MOTOR] * error / np.sqrt(np.mean(error**2))
    return fit(clean.problem.with_rows(replace(rows, measured=measured)))


def probe(estimate: Estimate) -> Scored:
    (found,) = score(space_of(estimate), [p for p in probes(estimate) if p.name == LABEL])
    return found


def test_noise_is_learned_without_the_error_that_stands_out(clean: Estimate, lacking: Estimate) -> None:
    fired = probe(lacking)
    found = with_noise_beside(lacking, [fired])
    assert found is not None
    for lag in (1, 5, 12):
        true, taken = clean.noise.autocorrelations[MOTOR][lag], lacking.noise.autocorrelations[MOTOR][lag]
        assert found.noise.autocorrelations[MOTOR][lag] - true < 0.2 * (taken - true)
    assert found.noise.sigma[0, MOTOR] == pytest.approx(clean.noise.sigma[0, MOTOR], rel=0.02)
    assert probe(found).explained > 2.0 * fired.explained
    others = [c for c in range(len(clean.noise.autocorrelations)) if c != MOTOR]
    for c in others:
        np.testing.assert_array_equal(found.noise.autocorrelations[c], lacking.noise.autocorrelations[c])


def test_noise_beside_what_explains_nothing_stays_as_it_was(clean: Estimate) -> None:
    assert with_noise_beside(clean, []) is None
    found = with_noise_beside(clean, [probe(clean)]) or clean
    change = found.noise.autocorrelations[MOTOR] - clean.noise.autocorrelations[MOTOR]
    assert np.abs(change[:13]).max() < 0.03


def test_the_size_of_what_is_left_is_that_in_the_torque(lacking: Estimate) -> None:
    plain = with_equal_weights(lacking)
    fall = cross_fitted_fall(plain, probe(plain), 0)
    motors = np.bincount(plain.whitened.channel)
    size = np.sqrt(fall.share * motors.sum() / motors[MOTOR])
    true = SIZE / np.sqrt(1.0 + SIZE**2)  # in units of all that is left of this motor
    assert 0.5 * true < size < 1.1 * true  # a part of it looks like weight, and is taken for it


def with_error(clean: Estimate, error: np.ndarray) -> Estimate:
    """The fit of the same log with an error ``(N,)`` of one motor's torque, in units of its noise."""
    rows = clean.problem.rows
    measured = rows.measured.copy()
    measured[:, MOTOR] += clean.noise.sigma[:, MOTOR] * error
    return fit(clean.problem.with_rows(replace(rows, measured=measured)))


def test_a_constant_error_is_no_noise(clean: Estimate) -> None:
    """An offset of 1.5 standard deviations correlates the residual at all lags by two thirds, which hid it."""
    lacking = with_error(clean, np.full(len(clean.residual), 1.5))
    assert lacking.noise.autocorrelations[MOTOR][12] > 0.5
    found = with_noise_about_its_level(lacking)
    assert found is not None
    assert found.noise.autocorrelations[MOTOR][12] == pytest.approx(clean.noise.autocorrelations[MOTOR][12], abs=0.1)
    assert found.noise.sigma[0, MOTOR] == pytest.approx(clean.noise.sigma[0, MOTOR], rel=0.1)
    others = [c for c in range(len(clean.noise.autocorrelations)) if c != MOTOR]
    for c in others:
        np.testing.assert_array_equal(found.noise.autocorrelations[c], lacking.noise.autocorrelations[c])


def test_an_error_that_follows_a_temperature_is_no_noise(clean: Estimate) -> None:
    """It changes by less than a tenth within the noise's memory, and was filtered out with it."""
    rows = clean.problem.rows
    slow = np.sqrt(2.0) * np.sin(np.linspace(0.0, 4.0, len(rows)))
    rows = replace(rows, signals={**rows.signals, "ambient_temperature": slow})
    lacking = with_error(replace(clean, problem=clean.problem.with_rows(rows)), slow)
    assert lacking.noise.autocorrelations[MOTOR][12] > 0.4
    found = with_noise_about_its_level(lacking)
    assert found is not None
    assert found.noise.autocorrelations[MOTOR][12] == pytest.approx(clean.noise.autocorrelations[MOTOR][12], abs=0.1)
    assert found.noise.sigma[0, MOTOR] == pytest.approx(clean.noise.sigma[0, MOTOR], rel=0.1)


def test_a_constant_error_does_not_wander(clean: Estimate) -> None:
    """A walk that begins anywhere was likelier than the constant, and then hid it."""
    lacking = with_error(clean, np.full(len(clean.residual), 1.5))
    assert level_beside(with_noise_about_its_level(lacking) or lacking, []) is None
    steps = 0.05 * np.random.default_rng(0).standard_normal(len(clean.residual))
    walking = with_error(clean, 1.5 + np.cumsum(steps))
    walking = with_noise_about_its_level(walking) or walking
    assert level_beside(whitened_by(walking, walking.noise.of_short_memory), []) is not None


def test_without_a_constant_error_the_noise_stays_as_it_was(clean: Estimate) -> None:
    assert with_noise_about_its_level(clean) is None


def test_a_name_is_scored_by_the_noise_beside_the_probe_that_shows_it(clean: Estimate) -> None:
    """Friction that follows the load changes as slowly as the motion: learned as noise, most of it was filtered out."""
    rows, theta = clean.problem.rows, clean.theta
    rubbing = np.abs(clean.problem.loads(theta)[:, MOTOR]) * rows.signals["joint_motion"][:, MOTOR]
    lacking = with_error(clean, 2.0 * rubbing / np.sqrt(np.mean(rubbing**2)))
    effects = dict(catalogue())
    before = scores_of(lacking, effects, 199, 0)
    found = scored_beside_probes(lacking, before, effects, 199, 0)
    assert found is not None
    assert not found.noise_of_fit
    label = f"load_dependent_friction@joint{MOTOR + 1}"

    def explained(scores: CandidateScores) -> float:
        return next(s.explained for s in scores.named if s.candidate.label == label)

    assert explained(found) > 2.0 * explained(before)


def test_where_no_probe_is_significant_names_keep_their_noise(clean: Estimate) -> None:
    effects = dict(catalogue())
    assert scored_beside_probes(clean, scores_of(clean, effects, 199, 0), effects, 199, 0) is None
