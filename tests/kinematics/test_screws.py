"""Identities of rotations, rigid transforms and screws."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kinematics import screws as s

few = settings(derandomize=True, max_examples=60, deadline=None)
numbers = st.floats(-3, 3, allow_subnormal=False)
vectors = arrays(np.float64, 3, elements=numbers)
twists = arrays(np.float64, 6, elements=numbers)
directions = vectors.filter(lambda v: np.linalg.norm(v) > 0.1).map(lambda v: v / np.linalg.norm(v))
angles = st.one_of(
    st.floats(0, np.pi), st.sampled_from([0.0, 1e-300, 1e-12, 1e-8, 1e-4, 0.0999, 0.1001, 3.1415, np.pi - 1e-8, np.pi])
)


@few
@given(vectors, vectors)
def test_hat_is_the_cross_product_and_vee_undoes_it(a, b):
    np.testing.assert_allclose(s.hat3(a) @ b, np.cross(a, b), atol=1e-14)
    np.testing.assert_array_equal(s.vee3(s.hat3(a)), a)


@few
@given(directions, angles)
def test_rotation_logarithm_undoes_the_exponential(axis, angle):
    R = s.exp_so3(axis * angle)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1)
    w = s.log_so3(R)
    np.testing.assert_allclose(s.exp_so3(w), R, atol=1e-14)
    if angle < np.pi - 1e-6:
        np.testing.assert_allclose(w, axis * angle, atol=1e-14, rtol=1e-13)


def test_logarithm_keeps_all_digits_of_a_small_rotation():
    w = np.array([1e-9, -2e-9, 3e-10])
    np.testing.assert_allclose(s.log_so3(s.exp_so3(w)), w, rtol=1e-12)


@few
@given(directions, angles, vectors)
def test_transform_logarithm_undoes_the_exponential(axis, angle, v):
    T = s.exp_se3(np.concatenate([axis * angle, v]))
    np.testing.assert_allclose(s.exp_se3(s.log_se3(T)), T, atol=2e-14)
    if angle < np.pi - 1e-6:
        np.testing.assert_allclose(s.log_se3(T), np.concatenate([axis * angle, v]), atol=5e-14)


@few
@given(twists, twists, twists)
def test_adjoint_is_a_representation(a, b, c):
    A, B = s.exp_se3(a), s.exp_se3(b)
    np.testing.assert_allclose(s.adjoint(A @ B), s.adjoint(A) @ s.adjoint(B), atol=1e-12)
    np.testing.assert_allclose(s.adjoint(s.inverse(A)) @ s.adjoint(A), np.eye(6), atol=1e-12)
    np.testing.assert_allclose(s.exp_se3(s.adjoint(A) @ c), A @ s.exp_se3(c) @ s.inverse(A), atol=1e-11)


@few
@given(directions, vectors, st.floats(-1, 1))
def test_points_on_a_screw_axis_only_slide(axis, point, pitch):
    T = s.exp_se3(s.screw(axis, point, pitch) * 1.3)
    np.testing.assert_allclose((T @ [*point, 1.0])[:3], point + 1.3 * pitch * axis, atol=1e-12)


def test_prismatic_screw_translates():
    T = s.exp_se3(0.7 * s.prismatic_screw([0.0, 0.6, 0.8]))
    np.testing.assert_allclose(T, s.transform(np.eye(3), [0.0, 0.42, 0.56]), atol=1e-15)


def test_everything_is_batched(rng):
    twist = rng.normal(size=(4, 5, 6))
    T = s.exp_se3(twist)
    assert T.shape == (4, 5, 4, 4)
    for function, argument in (
        (s.log_se3, T), (s.adjoint, T), (s.inverse, T), (s.exp_se3, twist), (s.log_so3, T[..., :3, :3]),
        (s.exp_so3, twist[..., :3]), (s.cayley, twist[..., :3]), (s.cayley_left_jacobian, twist[..., :3]),
    ):  # fmt: skip
        np.testing.assert_array_equal(function(argument)[2, 3], function(argument[2, 3]))


@few
@given(vectors)
def test_cayley_is_a_rotation_by_twice_the_arc_tangent(w):
    R = s.cayley(w)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.norm(s.log_so3(R)) == pytest.approx(2 * np.arctan(np.linalg.norm(w) / 2), abs=1e-12)


def test_cayley_agrees_with_the_exponential_to_second_order():
    w = 1e-4 * np.array([0.3, -0.7, 0.5])
    assert np.abs(s.cayley(w) - s.exp_so3(w)).max() < 1e-12


@few
@given(vectors)
def test_cayley_left_jacobian_by_complex_step(w):
    J = s.cayley_left_jacobian(w)
    for k in range(3):
        step = np.zeros(3, dtype=complex)
        step[k] = 1e-30j
        dR = s.cayley(w + step).imag / 1e-30
        np.testing.assert_allclose(dR @ s.cayley(w).T, s.hat3(J[:, k]), atol=1e-13)
