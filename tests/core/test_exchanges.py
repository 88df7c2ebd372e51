"""Exchanges of poses as the test of effects that few visits show."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse, stats

from clampid.evidence import exchanges
from clampid.evidence.exchanges import Visits
from clampid.evidence.joint_errors import JointErrors
from clampid.stages.rows import Array

POSES, EACH = 40, 3
POSE = np.repeat(np.arange(POSES), EACH)


def visits(error: Array, pose: Array = POSE) -> Visits:
    """Visits with given errors of the joint's angle, in standard deviations."""
    V = len(error)
    seen = JointErrors(np.arange(V), sparse.identity(V, format="csr"), error)
    first = np.searchsorted(pose, pose)
    return Visits(seen, pose.astype(np.int64), (np.arange(V) - first).astype(np.int64))


def shown_at(*poses: int) -> Array:
    """A shape of equal size at all visits of some poses, and nothing elsewhere: ``(V, 1)``."""
    shape = np.isin(POSE, poses).astype(float)
    return (shape / np.linalg.norm(shape))[:, None]


def test_a_false_alarm_is_as_frequent_as_its_p_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors that the visits of a pose share, and heavy tails, change nothing: poses stay exchangeable."""
    monkeypatch.setattr(exchanges, "EXCHANGES", 999)
    rng, count = np.random.default_rng(3), 400
    found = []
    for seed in range(count):
        error = np.repeat(rng.standard_t(3, POSES), EACH) + rng.normal(size=POSES * EACH)
        found.append(np.exp(visits(np.clip(error, -3, 3)).log_p([shown_at(0, 1, 2)], seed)[0]))
    for level in (0.01, 0.05, 0.2):
        assert stats.binomtest(int(np.sum(np.array(found) <= level)), count, level, "greater").pvalue > 0.001


def test_three_poses_show_what_no_flip_of_their_signs_does() -> None:
    """If all of their visits are off by two and a half standard deviations, p is far below 2^-3."""
    error = np.random.default_rng(5).normal(size=POSES * EACH)
    error[np.isin(POSE, (4, 11, 30))] = 2.5
    right, other = visits(error).log_p([shown_at(4, 11, 30), shown_at(5, 12, 31)], 0)
    assert right < np.log(1e-3)
    assert other > np.log(0.01)


def test_a_pose_that_is_off_for_itself_counts_once() -> None:
    """However many visits it has: one of forty poses has the largest error by chance in one case of forty."""
    error = np.random.default_rng(7).normal(scale=0.5, size=POSES * EACH)
    error[POSE == 9] = 3.0
    log_p = visits(error).log_p([shown_at(9)], 0)[0]
    assert log_p == pytest.approx(np.log(1 / POSES), abs=0.2)


def test_only_poses_with_as_many_visits_are_exchanged() -> None:
    """A pose of ten visits, as for repeatability, cannot be elsewhere: its error says nothing."""
    pose = np.r_[np.zeros(10, dtype=np.int64), 1 + np.repeat(np.arange(30), EACH)]
    error = np.where(pose == 0, 3.0, np.random.default_rng(9).normal(size=len(pose)))
    shape = (pose == 0) / np.sqrt(10.0)
    assert visits(error, pose).log_p([shape[:, None]], 0)[0] == pytest.approx(0.0)


def test_the_order_of_the_columns_does_not_matter() -> None:
    """Nor their scale: the basis of a shape of two columns is what counts."""
    rng = np.random.default_rng(11)
    own = visits(rng.normal(size=POSES * EACH))
    turn = np.linalg.qr(rng.normal(size=(2, 2)))[0]
    shape = np.hstack([shown_at(1, 2), shown_at(7, 8, 9)])
    one, turned = own.log_p([shape, shape @ turn], 0)
    assert one == pytest.approx(turned)
