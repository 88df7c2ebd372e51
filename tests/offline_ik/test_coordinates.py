"""Detector coordinates: round trips, the two public conventions apart, the thesis' matrix, what cannot be meant."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from offline_ik.cell.coordinates import CONVENTIONS, Convention, check_target, detector_angles, detector_pose, pose_sx
from offline_ik.errors import CellError, TargetError

NAMES = st.sampled_from(sorted(CONVENTIONS))
ANGLE, SMALL = st.floats(-3.1, 3.1), st.floats(-1.5, 1.5)


def placed(name: str) -> Convention:
    return replace(CONVENTIONS[name], beam=(0.6, 0.0, 0.8), up=(-0.8, 0.0, 0.6), sample=(0.3, -0.2, 0.9))


@given(NAMES, ANGLE, SMALL, st.floats(0.05, 5.0), ANGLE)
def test_angles_lead_to_a_pose_and_back(name: str, outer: float, inner: float, r: float, roll: float) -> None:
    convention = placed(name)
    gamma, delta = (outer, inner) if convention.order == "gamma_outer" else (inner, outer)
    at = detector_angles(convention, detector_pose(convention, gamma, delta, r, roll))
    assert np.allclose([at.gamma, at.delta, at.r, at.roll, *at.tilt], [gamma, delta, r, roll, 0, 0], atol=1e-9)


@given(NAMES, ANGLE, ANGLE, ANGLE)
def test_the_normal_is_at_the_sample_and_the_frame_is_a_rotation(name: str, g: float, d: float, roll: float) -> None:
    convention = placed(name)
    T = detector_pose(convention, g, d, 0.7, roll)
    assert np.allclose(T[:3, 3] + 0.7 * T[:3, 2], convention.sample, atol=1e-14)
    assert np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-14)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)


def test_the_symbolic_pose_is_the_numeric_one() -> None:
    x = ca.SX.sym("x", 4)
    for name in CONVENTIONS:
        R, p = pose_sx(placed(name), x[0], x[1], x[2], x[3])
        T = detector_pose(placed(name), 0.4, -0.3, 0.9, 1.2)
        found = ca.Function("f", [x], [R, p])([0.4, -0.3, 0.9, 1.2])
        assert np.allclose(np.array(found[0]), T[:3, :3], atol=1e-15)
        assert np.allclose(np.array(found[1]).ravel(), T[:3, 3], atol=1e-15)


def test_two_public_conventions_differ_by_55_mm_at_a_metre() -> None:
    g, d = np.deg2rad([30.0, 20.0])
    one, other = (detector_pose(CONVENTIONS[n], g, d, 1.0)[:3, 3] for n in ("nanomax", "nanomax_reversed"))
    assert np.linalg.norm(one - other) == pytest.approx(0.0549, abs=1e-4)
    lab = CONVENTIONS["nanomax"].lab.T @ one
    assert np.allclose(lab, [-np.sin(g) * np.cos(d), np.sin(d), np.cos(g) * np.cos(d)], atol=1e-15)


def test_the_thesis_matrix() -> None:
    g, d = 0.5, -0.3
    A, B = g + np.pi, np.pi / 2 + d  # beam along +x: its azimuth is zero
    cA, sA, cB, sB = np.cos(A), np.sin(A), np.cos(B), np.sin(B)
    T = detector_pose(CONVENTIONS["thesis"], g, d, 1.0)
    assert np.allclose(T[:3, :3], [[cA * cB, -sA, cA * sB], [sA * cB, cA, sA * sB], [-sB, 0, cB]], atol=1e-15)


def test_at_the_pole_of_the_inner_circle_the_outer_angle_is_zero() -> None:
    T = detector_pose(CONVENTIONS["nanomax"], 0.0, np.pi / 2, 1.0)
    assert detector_angles(CONVENTIONS["nanomax"], T).delta == pytest.approx(np.pi / 2)


def test_at_the_sample_there_are_no_angles() -> None:
    with pytest.raises(TargetError, match="at the sample"):
        detector_angles(CONVENTIONS["thesis"], np.eye(4))


@pytest.mark.parametrize(
    ("gamma", "delta", "r", "says"),
    [
        (30.0, 0.1, 1.0, "did you mean 30 degrees, that is 0.5235"),
        (0.1, -45.0, 1.0, "did you mean -45 degrees"),
        (0.1, 0.1, 800.0, "did you mean 800 mm, that is 0.8 m"),
        (float("nan"), 0.1, 1.0, "finite"),
        (0.1, float("inf"), 1.0, "finite"),
        (0.1, 0.1, 0.0, "positive"),
        (0.1, 0.1, -1.0, "positive"),
        (1e9, 0.1, 1.0, "radians"),
    ],
)
def test_what_cannot_be_meant_is_asked_about(gamma: float, delta: float, r: float, says: str) -> None:
    with pytest.raises(TargetError, match=says):
        check_target(gamma, delta, r)


@pytest.mark.parametrize(
    "wrong",
    [{"order": "both"}, {"gamma_sign": 2}, {"beam": (0, 0, 0)}, {"up": (1, 0, 0)}, {"sample": (0, 0)},
     {"frame": "moon"}, {"beam": (float("nan"), 0, 1)}],
)  # fmt: skip
def test_a_convention_that_contradicts_itself_is_refused(wrong: dict) -> None:
    with pytest.raises(CellError):
        replace(CONVENTIONS["thesis"], **wrong)
