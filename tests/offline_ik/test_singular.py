"""Singular poses: each is reached, is said to be singular, and is held by the posture nearest to that at hand."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from ik_arms import MOUNT, drawn_arm
from scipy.optimize import brentq

from kinematics.description import load_robot
from kinematics.poe import forward, joint_transforms
from offline_ik.arm.identified import Conditions, nominal_arm
from offline_ik.cell.coordinates import detector_angles
from offline_ik.inverse.detector import Detector
from offline_ik.inverse.postures import PostureSearch
from offline_ik.inverse.singular import wrist_of
from offline_ik.inverse.solver import Solver

ARMS = ("nominal", "calibrated")
PARTS = (
    ("wrist",), ("wrist", "elbow"), ("shoulder",), ("wrist", "shoulder"), ("elbow", "shoulder"),
    ("wrist", "elbow", "shoulder"),
)  # fmt: skip


@lru_cache
def search_on(arm: str) -> PostureSearch:
    robot = load_robot("kuka_kr20_r1810")
    solver = Solver(nominal_arm(robot) if arm == "nominal" else drawn_arm(), MOUNT)
    return PostureSearch(solver, robot.lower, robot.upper)


def made_singular(search: PostureSearch, q: np.ndarray, parts: tuple[str, ...], off: float) -> np.ndarray | None:
    """The posture ``(6,)`` singular but for ``off``, rad; None: no joint 2 takes the wrist to axis 1."""
    ortho, q = search.solver.ortho, q.copy()
    assert ortho is not None
    if "wrist" in parts:
        q[4] = off - ortho.psi
    if "elbow" in parts:
        q[2] = ortho.stretched + off
    if "shoulder" in parts:
        radial = np.cross(ortho.axes[0], ortho.axes[1])

        def ahead(q2: float) -> float:
            turned = joint_transforms(search.solver.arm.robot.screws, np.array([0.0, q2, q[2], 0.0, 0.0, 0.0]))[3]
            return float(radial @ (turned[:3, :3] @ ortho.wrist + turned[:3, 3] - ortho.foot))

        grid = np.linspace(search.lower[1], search.upper[1], 60)
        values = np.array([ahead(q2) for q2 in grid])
        crossed = np.flatnonzero(values[:-1] * values[1:] < 0)
        if not len(crossed):
            return None
        k = crossed[np.argmin(np.abs(grid[crossed] - q[1]))]
        q[1] = brentq(ahead, grid[k], grid[k + 1], xtol=1e-15) + off
    return q if (q >= search.lower).all() and (q <= search.upper).all() else None


@pytest.mark.parametrize("arm", ARMS)
@settings(derandomize=True, max_examples=15, deadline=None)
@given(
    st.lists(st.floats(-0.98, 0.98), min_size=6, max_size=6),
    st.sampled_from(PARTS),
    st.sampled_from([0.0, 1e-12, -1e-9, 1e-7, -1e-5, 1e-3]),
    st.integers(0, 5),
)
@example([0.3409, 0.7215, 0.7926, 0.7163, -0.9944, 0.0829], ("shoulder",), 0.0, 0)  # joint 5 next to its limit
def test_a_singular_pose_is_reached_at_the_posture_at_hand(
    arm: str, shares: list[float], parts: tuple[str, ...], off: float, seed: int
) -> None:
    search = search_on(arm)
    middle, half = 0.5 * (search.upper + search.lower), 0.5 * (search.upper - search.lower)
    q = made_singular(search, middle + np.array(shares) * np.minimum(half, np.pi), parts, off)
    assume(q is not None)
    assert q is not None
    still = Conditions.still(6)
    T = search.solver.pose(q, still)[0]
    found = search.find(T, q, None, still, {})
    moves = [np.abs(p - q).max() for p, _ in found]
    if len(parts) < 3:  # of all three at once the pose has postures in a whole surface, and another may be found
        assert min(moves) < 0.02  # an arm that is stretched as well has two postures beside each other
    for p, _ in found:
        assert np.abs(search.solver.pose(p, still)[0] - T).max() < 1e-9
        assert ((p >= search.lower) & (p <= search.upper)).all()
    nearest = found[int(np.argmin(moves))][0]
    assert len(parts) == 3 or set(parts) <= set(search.singular(T, search.solver.linkage @ nearest, still))
    there = np.clip(q + np.random.default_rng(seed).uniform(-1, 1, 6), search.lower, search.upper)
    assert search.find(T, there, None, still, {})


@pytest.mark.parametrize("turn", [-2.0, 0.3, 2.5])
def test_on_the_nominal_arm_joint_4_stays_where_the_wrist_is_straight_and_joint_1_where_it_turns_on_axis_1(
    turn: float,
) -> None:
    search, still = search_on("nominal"), Conditions.still(6)
    for parts, joint in ((("wrist",), 3), (("wrist", "elbow"), 3), (("shoulder",), 0)):
        q = made_singular(search, np.array([0.4, -1.5, 1.5, 0.3, 0.6, -0.4]), parts, 0.0)
        assert q is not None
        here = q.copy()
        here[joint] += turn
        found = search.find(search.solver.pose(q, still)[0], here, None, still, {})
        kept = [abs(p[joint] - here[joint]) for p, _ in found]
        assert min(kept) < 1e-6


def test_a_wrist_is_turned_to_any_orientation() -> None:
    search, rng = search_on("nominal"), np.random.default_rng(0)
    robot = search.solver.arm.robot
    chain, other = rng.uniform(-2, 2, (2, 50, 6))
    R = forward(robot.screws, robot.flange, other[0])[:3, :3]
    for side in (1.0, -1.0):
        found = wrist_of(search.solver, chain, R, side, 0.0)
        assert np.abs(forward(robot.screws, robot.flange, found)[:, :3, :3] - R).max() < 1e-12
        assert (found[:, :3] == chain[:, :3]).all()
        assert (search.solver.signs(found)[:, 2] == side).all()


@pytest.mark.slow
def test_a_detector_with_a_straight_wrist_is_left_at_the_posture_at_hand(detector: Detector) -> None:
    """By the one kernel: it takes what its branches have, and others of the same pose are nearer."""
    q = np.array([0.2, -1.3, 1.4, 0.6, 0.0, -0.5])
    pose = detector.pose(q[None])[0]
    convention = detector.cell.convention.with_sample(pose[:3, 3] + 0.8 * pose[:3, 2])
    there = Detector(detector.arm, replace(detector.cell, convention=convention, obstacles=()))
    at = detector_angles(convention, pose)
    assert np.abs(at.tilt).max() < 1e-12
    asked = (at.gamma, at.delta, at.r, at.roll)
    for turn in (0.0, 1.0, -2.5):
        here = q + turn * np.array([0, 0, 0, 1, 0, -1])
        for branch in ("nearest", "all"):
            first = there.locate(*asked, near=here, branch=branch).solutions[0]
            assert "wrist" in first.singular
            assert np.abs(there.pose(first.q[None])[0] - pose).max() < 2e-9
            if turn == 0.0:
                assert first.distance < 1e-3
        at_once = there.at_once(*asked, near=here)
        assert at_once is None or at_once.solutions[0].distance < 0.1
    away = q + 0.3
    moved = there.locate(*asked, near=away, direction="moved").solutions[0]
    far = np.abs(moved.q - away) > 1e-2
    assert far.any()
    assert (moved.direction == np.sign(moved.q - away))[far].all()
