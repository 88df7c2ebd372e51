"""The scattering point from reflections found: recovered within its stated covariance, or refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from offline_ik.bragg import Reflection, sample_position, scattering_angle
from offline_ik.coordinates import CONVENTIONS, detector_pose
from offline_ik.errors import TargetError

CONVENTION = replace(CONVENTIONS["thesis"], beam=(0.6, 0.8, 0.0), sample=(0.3, 0.2, 0.9))
SIGMA = 5e-5  # rad
POINT = 1e-5  # m


def found(rng: np.random.Generator, sample: np.ndarray, noise: float = 1.0) -> list[Reflection]:
    """Reflections where rays from ``sample`` meet detectors that stand about the assumed one."""
    out = []
    for gamma, delta, r in ((0.3, 0.2, 0.6), (-0.4, 0.1, 0.8), (0.5, 0.6, 0.7), (0.2, -0.5, 0.5), (0.8, 0.3, 0.9)):
        point = detector_pose(CONVENTION, gamma, delta, r)[:3, 3]
        v = point - sample
        two_theta = np.arccos(np.array(CONVENTION.beam) @ v / np.linalg.norm(v))
        seen = point + noise * POINT * rng.normal(size=3)
        out.append(Reflection(seen, two_theta + noise * SIGMA * rng.normal(), SIGMA, POINT**2 * np.eye(3)))
    return out


def test_without_noise_the_sample_is_found_exactly() -> None:
    sample = np.add(CONVENTION.sample, (4e-3, -3e-3, 2e-3))
    got = sample_position(CONVENTION, found(np.random.default_rng(0), sample, noise=0.0))
    assert np.allclose(got.sample, sample, atol=1e-9)
    assert got.misfit < 1e-6


def test_its_covariance_is_that_of_many_repetitions() -> None:
    rng = np.random.default_rng(1)
    sample = np.add(CONVENTION.sample, (1e-3, 2e-3, -1e-3))
    tries = [sample_position(CONVENTION, found(rng, sample)) for _ in range(600)]
    off = np.array([t.sample - sample for t in tries])
    whitened = np.array([e @ np.linalg.solve(t.covariance, e) for e, t in zip(off, tries, strict=True)])
    assert whitened.mean() == pytest.approx(3.0, rel=0.15)
    assert np.allclose(off.std(axis=0), tries[0].std, rtol=0.15)
    assert np.sqrt(np.mean([t.misfit**2 for t in tries])) == pytest.approx(1.0, rel=0.1)


def test_reflections_that_are_alike_do_not_tell_it() -> None:
    rng = np.random.default_rng(2)
    one = found(rng, np.array(CONVENTION.sample))[0]
    with pytest.raises(TargetError, match="too much alike"):
        sample_position(CONVENTION, [one] * 5)
    with pytest.raises(TargetError, match="at least three"):
        sample_position(CONVENTION, [one] * 2)


@pytest.mark.parametrize("wrong", [{"two_theta": 0.0}, {"std_angle": 0.0}, {"point": np.array([np.nan, 0, 0])}])
def test_numbers_that_cannot_be_are_refused(wrong: dict) -> None:
    good = found(np.random.default_rng(3), np.array(CONVENTION.sample))
    with pytest.raises(TargetError):
        sample_position(CONVENTION, [replace(good[0], **wrong), *good[1:]])


def test_braggs_law() -> None:
    assert scattering_angle(1.0, 1.0) == pytest.approx(np.pi / 3)
    assert scattering_angle(1.54056, 3.1356) == pytest.approx(np.deg2rad(28.443), abs=1e-4)  # silicon 111, Cu K-alpha 1
    with pytest.raises(TargetError, match="does not reflect"):
        scattering_angle(3.0, 1.0)
    with pytest.raises(TargetError, match="positive"):
        scattering_angle(1.0, 0.0)
