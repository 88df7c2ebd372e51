"""Metrics of ISO 9283: hand-worked cases, and what must hold of any numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.measures.iso9283 import expected_repeatability, pose_metrics
from experiments.measures.metrics import (
    accuracy,
    angle_accuracy,
    angle_repeatability,
    angle_variation,
    drift,
    repeatability,
    split_about,
    variation,
)

seeds = st.integers(0, 10_000)
SQUARE = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])


def test_accuracy_and_repeatability_by_hand() -> None:
    there = SQUARE + np.array([3.0, 4.0, 0.0])
    assert accuracy(there, np.zeros(3)) == pytest.approx(5.0)
    assert repeatability(there) == pytest.approx(1.0)  # all one from the barycentre: no scatter of the distances
    # Distances from the barycentre 2, 2, 0 (mean 4/3, S = sqrt(4/3)) of three points on a line.
    line = np.array([[-2.0, 0, 0], [2, 0, 0], [0, 0, 0]])
    assert repeatability(line) == pytest.approx(4 / 3 + 3 * np.sqrt(4 / 3))


def test_variation_and_drift_by_hand() -> None:
    sides = [SQUARE, SQUARE + np.array([0, 0, 2.0]), SQUARE + np.array([0, 3.0, 2.0])]
    assert variation(sides) == pytest.approx(np.sqrt(13))
    ap, rp = drift(
        [SQUARE + np.array([1.0, 0, 0]), SQUARE + np.array([0, 4.0, 0]), 2 * SQUARE + np.array([0, 0, 2.0])],
        np.zeros(3),
    )
    assert ap == pytest.approx(3.0)
    assert rp == pytest.approx(1.0)
    assert np.isnan(drift([SQUARE[:1], SQUARE[1:2]], np.zeros(3))[1])


def test_radial_and_along_by_hand() -> None:
    points, centre = np.array([[0.0, 0.0, 3.0], [5.0, 1.0, 1.0]]), np.array([0.0, 1.0, 1.0])
    radial, along = split_about(np.array([[0.0, -1.0, 2.0], [0.1, 0.3, 0.4]]), points, centre)
    assert radial[0] == pytest.approx(5 / np.sqrt(5))
    assert along[0] == pytest.approx(0.0, abs=1e-7)
    assert (radial[1], along[1]) == (pytest.approx(0.1), pytest.approx(0.5))


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_parts_add_up_and_frames_do_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    error, points = rng.standard_normal((2, 20, 3))
    radial, along = split_about(error, points + 5.0, np.zeros(3))
    assert np.allclose(radial**2 + along**2, np.sum(error**2, axis=1))
    Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    turned = split_about(error @ Q, (points + 5.0) @ Q, np.zeros(3))
    assert np.allclose(turned[0], radial)
    assert np.allclose(turned[1], along)
    assert repeatability(points @ Q + 7.0) == pytest.approx(repeatability(points))


def test_angles_are_taken_axis_by_axis() -> None:
    attained = np.array([[1.0, -2.0, 0.0], [3.0, -2.0, 0.0]])
    assert angle_accuracy(attained, np.array([0.0, 0.0, 1.0])) == pytest.approx([2.0, 2.0, 1.0])
    assert angle_repeatability(attained) == pytest.approx([3 * np.sqrt(2), 0.0, 0.0])
    assert angle_variation([attained, attained[:1], -attained]) == pytest.approx([4.0, 4.0, 0.0])


def test_a_table_is_grouped_by_place_and_side() -> None:
    off = np.array(
        [SQUARE[0], SQUARE[1], [0, 0, 2.0], [0, 0, 2.0], [0, 0, 9.0], [0, 0, 9.0], SQUARE[0], [7.0, 0, 0], [0, 0, 0]]
    )
    place = np.array([0, 0, 0, 0, 1, 1, 2, 3, 3])
    side = np.array([0, 0, 1, 1, 0, 0, 0, -1, -1])
    found = pose_metrics(off, place, place, side, np.arange(9.0)).metrics
    # Poses: the mean of 0's two sides (0 and 2), and 9 at pose 1.
    assert (found["AP"].places, found["AP"].poses, found["AP"].returns) == (3, 2, (2, 2))
    assert (found["AP"].mean, found["AP"].maximum) == (pytest.approx(5.0), pytest.approx(9.0))
    assert (found["RP"].mean, found["RP"].maximum) == (pytest.approx(0.25), pytest.approx(1.0))
    assert (found["vAP"].places, found["vAP"].mean) == (1, pytest.approx(2.0))
    # (1, 0, 0), (-1, 0, 0) and twice (0, 0, 2): sqrt 2, sqrt 2, 1 and 1 from their middle (0, 0, 1).
    assert found["RP_bidirectional"].returns == (4, 4)
    assert found["RP_bidirectional"].mean == pytest.approx((np.sqrt(2) + 1) / 2 + 3 * (np.sqrt(2) - 1) / np.sqrt(3))
    assert found["dAP"].places == 3
    assert found["vAP"].interval is None  # of a single pose


def test_drift_of_repeatability_sets_early_returns_against_late_ones() -> None:
    early, late = 1.0 * SQUARE, 3.0 * SQUARE
    time = np.random.default_rng(0).permutation(2 * len(SQUARE)).astype(float)
    off = np.vstack([early, late])[time.astype(int)]  # rows in any order: their time counts
    same = np.zeros(len(off), dtype=np.int64)
    found = pose_metrics(off, same, same, same, time)
    assert found.metrics["dRP"].mean == pytest.approx(repeatability(late) - repeatability(early))
    assert found.span == 7.0
    few = pose_metrics(off[:3], same[:3], same[:3], same[:3], time[:3])
    assert few.missing["dRP"] == "no pose was visited four times from the same side"
    assert "dAP" in few.metrics


@pytest.mark.parametrize(
    ("place", "side", "missing"),
    [
        ([0, 1, 2], [0, 1, 0], dict.fromkeys(("AP", "RP", "vAP", "dRP"), "no pose was visited twice")),
        ([0, 0, 1], [0, 1, 0], {"RP": "no pose was visited twice from the same side"}),
        ([0, 0, 1], [0, 0, 0], {"vAP": "no pose was visited from two sides"}),
        ([0, 0, 1], [-1] * 3, {"RP_bidirectional": "the table does not say from which side poses were approached"}),
    ],
)
def test_what_cannot_be_determined_is_said(place: list[int], side: list[int], missing: dict[str, str]) -> None:
    where = np.array(place)
    found = pose_metrics(SQUARE[:3], where, where, np.array(side), np.arange(3.0))
    assert missing.items() <= found.missing.items()
    assert not missing.keys() & found.metrics.keys()
    assert ("AP" in found.metrics) == (len(set(zip(place, side, strict=True))) < 3)


@pytest.mark.parametrize("std", [(1.0, 1.0, 1.0), (1.0, 0.3, 0.1), (0.0, 0.0, 2.0)])
def test_thirty_returns_show_on_average_what_is_expected(std: tuple[float, ...]) -> None:
    turn, _ = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))
    returns = np.random.default_rng(0).standard_normal((4000, 30, 3)) * std @ turn
    expected = expected_repeatability(turn.T @ np.diag(np.square(std)) @ turn)
    assert repeatability(returns).mean() == pytest.approx(expected, rel=0.015)


def _returned(rng: np.random.Generator, poses: int, returns: int, apart: float, std: np.ndarray):
    """Poses approached ``returns`` times from each of two sides ``apart``, m, with normal scatter."""
    place, side = (a.ravel() for a in np.meshgrid(np.arange(poses), [0, 1], indexing="ij"))
    place, side = np.repeat(place, returns), np.repeat(side, returns)
    error = rng.standard_normal((len(place), 3)) * std
    error[:, 0] += apart * side
    return pose_metrics(error, place, place, side, np.arange(float(len(place))))


@pytest.mark.slow
def test_repeatability_interval_from_two_returns_has_its_coverage() -> None:
    std = np.array([3e-5, 1e-5, 1e-5])
    truth, rng = expected_repeatability(np.diag(std**2)), np.random.default_rng(0)
    found = [_returned(rng, 6, 2, 0.0, std) for _ in range(400)]
    inside = np.mean([m.thirty.interval[0] <= truth <= m.thirty.interval[1] for m in found])
    assert 0.92 < inside < 0.985  # 95 % of 400 within three standard errors
    assert np.mean([m.thirty.value for m in found]) == pytest.approx(truth, rel=0.05)
    assert np.mean([m.metrics["RP"].mean for m in found]) < 0.4 * truth  # the formula's own, of two returns


def test_scatter_explains_only_its_own_share() -> None:
    rng, std = np.random.default_rng(0), np.full(3, 1e-5)
    none, some = _returned(rng, 60, 3, 0.0, std), _returned(rng, 60, 3, 1e-4, std)
    for name in ("vAP", "dAP"):
        assert none.metrics[name].mean == pytest.approx(none.metrics[name].by_scatter, rel=0.15)
    assert some.metrics["vAP"].mean == pytest.approx(1e-4, rel=0.1)
    assert some.metrics["vAP"].by_scatter == pytest.approx(none.metrics["vAP"].by_scatter, rel=0.15)
    assert none.metrics["RP"].by_scatter is None
    low, high = some.metrics["vAP"].interval
    assert low < 1e-4 < high < 1.2e-4


def test_targets_of_one_pose_are_no_poses_more() -> None:
    off = np.random.default_rng(0).standard_normal((8, 3))
    pose, place = np.repeat([0, 1], 4), np.array([0, 0, 1, 1, 2, 2, 3, 3])
    zero = np.zeros(8, dtype=np.int64)
    shared = pose_metrics(off, place, pose, zero, np.arange(8.0))
    apart = pose_metrics(off, place, place, zero, np.arange(8.0))
    assert (shared.metrics["RP"].places, shared.metrics["RP"].poses) == (4, 2)
    assert shared.metrics["RP"].mean == pytest.approx(apart.metrics["RP"].mean)
    assert shared.thirty.freedom == pytest.approx(apart.thirty.freedom / 2)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: repeatability(SQUARE[:1]), "expected two or more attained positions, found 1"),
        (lambda: variation([SQUARE]), "expected two or more sides, found 1"),
        (lambda: drift([SQUARE], np.zeros(3)), "expected two or more cycles, found 1"),
    ],
)
def test_too_few_returns_are_refused(call, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        call()
