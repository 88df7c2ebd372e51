"""The scattering point from reflections found: recovered within its stated covariance, or refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from offline_ik.cell.coordinates import CONVENTIONS, detector_pose
from offline_ik.errors import TargetError
from offline_ik.reflections import bragg
from offline_ik.reflections.bragg import FALSE_ALARM, Reflection, SamplePosition, sample_position, scattering_angle

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


def test_reflections_that_are_alike_do_not_determine_it() -> None:
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


PLACES = [(0.3, 0.2, 0.6), (-0.4, 0.1, 0.8), (0.5, 0.6, 0.7), (0.2, -0.5, 0.5), (0.8, 0.3, 0.9), (0.6, -0.2, 0.7)]
CHI2_95_OF_3 = 7.814727903251179  # of chi-square with three degrees of freedom, from tables


def rays(places: list[tuple[float, float, float]], sample: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Detectors' middles ``(N, 3)`` and the angles ``(N,)`` of the rays that meet them there."""
    points = np.array([detector_pose(CONVENTION, *place)[:3, 3] for place in places])
    v = points - sample
    return points, np.arccos(v @ np.array(CONVENTION.beam) / np.linalg.norm(v, axis=1))


def tables(count: int, drift: np.ndarray | None = None, seed: int = 5) -> list[SamplePosition]:
    """Fits of many tables whose points were moved together, by ``drift`` ``(3 N, K)`` times standard normal numbers."""
    rng, sample = np.random.default_rng(seed), np.add(CONVENTION.sample, (2e-3, -1e-3, 3e-3))
    points, angles = rays(PLACES, sample)
    root = np.zeros((3 * len(PLACES), 1)) if drift is None else drift
    out = []
    for _ in range(count):
        seen = points - (root @ rng.normal(size=root.shape[1])).reshape(-1, 3)
        noisy = angles + SIGMA * rng.normal(size=len(angles))
        given = [Reflection(p, a, SIGMA) for p, a in zip(seen, noisy, strict=True)]
        out.append(sample_position(CONVENTION, given, root @ root.T))
    return out


def test_errors_that_all_points_share_are_counted_as_such() -> None:
    """Points that are off together hide in the sample's place: taken for independent, they would average out."""
    together = 3e-5 * np.tile(np.eye(3), (len(PLACES), 1))
    bent = 3e-5 * np.random.default_rng(8).normal(size=(3 * len(PLACES), 2))
    found = tables(1000, np.hstack([together, bent]))
    truth = np.add(CONVENTION.sample, (2e-3, -1e-3, 3e-3))
    inside = [(t.sample - truth) @ np.linalg.solve(t.covariance, t.sample - truth) < CHI2_95_OF_3 for t in found]
    assert 0.929 < np.mean(inside) < 0.971  # 0.95 within three standard errors of 1000 draws
    assert np.mean([t.chi_square for t in found]) == pytest.approx(3.0, abs=0.24)
    assert (found[0].std > 3e-5).all()


def test_right_errors_are_called_wrong_as_often_as_stated() -> None:
    share = np.mean([not t.fits for t in tables(1500, seed=6)])
    assert share == pytest.approx(FALSE_ALARM, abs=3 * np.sqrt(FALSE_ALARM / 1500))


@pytest.mark.parametrize("wrong", range(len(PLACES)))
def test_a_reflection_that_does_not_fit_is_named(wrong: int) -> None:
    sample = np.add(CONVENTION.sample, (2e-3, -1e-3, 3e-3))
    points, angles = rays(PLACES, sample)
    angles[wrong] += 60 * SIGMA  # of another ring
    got = sample_position(CONVENTION, [Reflection(p, a, SIGMA) for p, a in zip(points, angles, strict=True)])
    assert not got.fits
    assert got.suspects == (wrong,)
    assert abs(got.checks[wrong]) == np.abs(got.checks).max()
    # Less one reflection chi-square falls by the square of its check: here all of it.
    others = [Reflection(p, a, SIGMA) for k, (p, a) in enumerate(zip(points, angles, strict=True)) if k != wrong]
    assert got.chi_square - got.checks[wrong] ** 2 == pytest.approx(
        sample_position(CONVENTION, others).chi_square, abs=1
    )
    # and the standard errors are those that the misfit shows.
    angles[wrong] -= 60 * SIGMA
    right = sample_position(CONVENTION, [Reflection(p, a, SIGMA) for p, a in zip(points, angles, strict=True)])
    assert np.allclose(got.std, right.std * got.misfit, rtol=0.02)


def test_one_redundant_reflection_does_not_identify_the_wrong_one() -> None:
    points, angles = rays(PLACES[:4], np.array(CONVENTION.sample))
    angles[2] += 40 * SIGMA
    got = sample_position(CONVENTION, [Reflection(p, a, SIGMA) for p, a in zip(points, angles, strict=True)])
    assert not got.fits
    assert sorted(got.suspects) == [0, 1, 2, 3]
    assert np.allclose(np.abs(got.checks), np.abs(got.checks[0]), rtol=1e-6)
    assert sample_position(
        CONVENTION, [Reflection(p, a, SIGMA) for p, a in zip(points[:3], angles[:3], strict=True)]
    ).fits


def test_a_direction_that_is_not_determined_is_said_and_kept() -> None:
    """Detectors in the plane of the beam and across it tell nothing of the height."""
    sample = np.add(CONVENTION.sample, (2e-3, -1e-3, 0.0))
    points, angles = rays([(g, 0.0, 0.8) for g in (0.3, 0.6, -0.4, 0.9)], sample)
    got = sample_position(CONVENTION, [Reflection(p, a, SIGMA) for p, a in zip(points, angles, strict=True)])
    assert np.allclose(np.abs(got.undetermined), [[0.0, 0.0, 1.0]], atol=1e-3)
    assert np.allclose(got.sample, sample, atol=1e-8)
    assert got.freedom == 2
    assert got.std[2] > 1e-2


def test_a_search_that_does_not_settle_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bragg, "MAX_STEPS", 2)
    points, angles = rays(PLACES, np.add(CONVENTION.sample, (5e-2, -3e-2, 4e-2)))
    with pytest.raises(TargetError, match="did not settle within 2 steps"):
        sample_position(CONVENTION, [Reflection(p, a, SIGMA) for p, a in zip(points, angles, strict=True)])


def test_braggs_law() -> None:
    assert scattering_angle(1.0, 1.0) == pytest.approx(np.pi / 3)
    assert scattering_angle(1.54056, 3.1356) == pytest.approx(np.deg2rad(28.443), abs=1e-4)  # silicon 111, Cu K-alpha 1
    with pytest.raises(TargetError, match="does not reflect"):
        scattering_angle(3.0, 1.0)
    for wrong in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(TargetError, match="positive"):
            scattering_angle(1.0, wrong)
