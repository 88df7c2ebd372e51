"""Do the pose stage's intervals hold the truth on arms of all kinds, with a linkage and a sliding joint among them?

The study itself is benchmarks/pose_coverage.py; the virtual robot shares no code with the effects.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pose_coverage
import pytest
from virtual_arms import ARMS, arm

FEW = range(2)  # the benchmark itself goes over 200


@cache
def trial(name: str, seed: int) -> pose_coverage.Trial:
    return pose_coverage.trial(name, seed)


@pytest.mark.slow
def test_the_truth_of_a_linkage_can_be_expressed():
    found = trial("abb_irb2400_12_155", 0)
    # Springs on the wrong side of the linkage left 600 µm; loads at the posture before it yields leave a few.
    assert found.inexpressible < 20e-6
    assert found.elsewhere < found.instrument


def test_every_arm_of_the_study_has_weight_and_is_drawn_apart():
    arms = [arm(name) for name in ARMS]
    assert all(robot.has_masses for robot in arms)
    assert [robot.n for robot in arms] == [6, 6, 6, 6, 6, 6, 4]
    assert arms[-1].joints[2].kind == "prismatic"


def test_a_sagging_joint_that_never_turns_its_load_is_not_called_known():
    errors = trial("scara", 0).errors
    # The slide carries one weight in all poses: its spring and the height of the base are one number.
    assert "joint_compliance.c@joint3" not in errors
    assert "geometry.base_z@session1" not in errors
    assert np.sqrt(np.mean(np.square(list(errors.values())))) < 1.5


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_intervals_hold_the_truth_on_every_arm():
    z = np.concatenate([list(trial(name, seed).errors.values()) for name in ARMS for seed in FEW])
    assert len(z) > 500
    # Errors of one individual go together: some 150 independent ones, of which fewer than 88 % are inside in one case
    # of 10 000 where intervals are true.
    assert np.mean(np.abs(z) < 1.96) > 0.88
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.25
