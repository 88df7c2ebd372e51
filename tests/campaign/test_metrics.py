"""Metrics of ISO 9283: hand-worked cases, and what must hold of any numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.metrics import accuracy, drift, pose_metrics, repeatability, split_about, variation

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


def test_a_table_is_grouped_by_place_and_side() -> None:
    command = np.tile([1.0, 2.0, 3.0], (9, 1))
    off = np.array(
        [SQUARE[0], SQUARE[1], [0, 0, 2.0], [0, 0, 2.0], [0, 0, 9.0], [0, 0, 9.0], SQUARE[0], [7.0, 0, 0], [0, 0, 0]]
    )
    place = np.array([0, 0, 0, 0, 1, 1, 2, 3, 3])
    side = np.array([0, 0, 1, 1, 0, 0, 0, -1, -1])
    found = pose_metrics(command + off, command, place, side, np.arange(9.0)).to_json()
    assert found["AP"] == {"poses": 3, "mean": pytest.approx(11 / 3), "max": pytest.approx(9.0)}
    assert found["RP"] == {"poses": 3, "mean": pytest.approx(1 / 3), "max": pytest.approx(1.0)}
    assert found["vAP"] == {"poses": 1, "mean": pytest.approx(2.0), "max": pytest.approx(2.0)}
    assert found["dAP"]["poses"] == 3
    assert pose_metrics(off[:1], off[:1], place[:1], side[:1], np.zeros(1)).to_json() == {}


def test_drift_of_repeatability_sets_early_returns_against_late_ones() -> None:
    early, late = 1.0 * SQUARE, 3.0 * SQUARE
    time = np.random.default_rng(0).permutation(2 * len(SQUARE)).astype(float)
    off = np.vstack([early, late])[time.astype(int)]  # rows in any order: their time counts
    same = np.zeros(len(off), dtype=np.int64)
    found = pose_metrics(off, np.zeros_like(off), same, same, time).to_json()
    expected = repeatability(late) - repeatability(early)
    assert found["dRP"] == {"poses": 1, "mean": pytest.approx(expected), "max": pytest.approx(expected)}
    few = pose_metrics(off[:3], np.zeros((3, 3)), same[:3], same[:3], time[:3]).to_json()
    assert "dRP" not in few
    assert "dAP" in few


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
