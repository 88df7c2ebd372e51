"""Normal equations by joints are those of the Jacobian, and a span by Cholesky factors is that by pivots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clampid.catalogue import catalogue
from clampid.evidence.space import _span
from clampid.fitting.many_amplitudes import AmplitudePoint, has_many_amplitudes
from clampid.fitting.noise import initial_noise
from clampid.fitting.solve import stage_point
from clampid.identification.fitted_stage import active_slots
from clampid.slots import Term
from clampid.stages.fit_problem import FitProblem, fit_problem
from clampid.stages.layout import layout_of
from clampid.stages.pose_rows import pose_rows
from experiments.campaign import Campaign
from kinematics.screws import exp_so3


def arm(campaign: Campaign, *names: str) -> FitProblem:
    rows = pose_rows([campaign], layout_of([campaign]), "poses")
    return fit_problem(rows, catalogue(), active_slots(rows, catalogue(), [Term(name, None) for name in names]))


@pytest.mark.parametrize("oblique", [False, True])
def test_normal_equations_by_joints_are_those_of_the_jacobian(tiny: Campaign, oblique: bool):
    whole = arm(tiny, "geometry", "joint_compliance", "backlash", "joint_angle_curve", "instrument_scale")
    rng = np.random.default_rng(3)
    theta = whole.start() + 0.1 * whole.sizes() * rng.normal(size=len(whole.sizes()))
    rows = whole.rows
    axes = exp_so3(rng.normal(size=(len(rows), 3)))
    constants = replace(rows.constants, noise_axes=axes) if oblique else rows.constants
    rows = replace(rows, used=rows.used & (rng.random(rows.used.shape) < 0.8), constants=constants)
    trial = whole.with_rows(replace(rows, sigma=rows.sigma * rng.uniform(0.5, 2.0, rows.sigma.shape))).with_flanks(
        theta
    )
    noise = initial_noise(trial.rows)
    assert has_many_amplitudes(trial, noise)
    found, expected = AmplitudePoint.at(trial, noise, theta), stage_point(trial, noise, theta)
    assert found.cost == pytest.approx(expected.cost, rel=1e-12)
    assert found.count == expected.count
    size = trial.sizes()
    for mine, theirs, unit in zip(found.normal(), expected.normal(), (np.outer(size, size), size), strict=True):
        np.testing.assert_allclose(mine * unit, theirs * unit, atol=1e-11 * np.abs(theirs * unit).max())
    assert not isinstance(found.white.source, np.ndarray)  # it is made when it is asked for
    np.testing.assert_allclose(found.white.jacobian, expected.white.jacobian, rtol=1e-12, atol=1e-300)
    np.testing.assert_allclose(found.gradient() * size, expected.normal()[1] * size, rtol=1e-9)


def test_few_parameters_go_by_the_jacobian(tiny: Campaign):
    whole = arm(tiny, "geometry", "joint_compliance")
    assert not has_many_amplitudes(whole, initial_noise(whole.rows))


@settings(derandomize=True, deadline=None)
@given(
    columns=st.integers(1, 12), repeated=st.integers(0, 3), empty=st.integers(0, 2), near=st.sampled_from([1.0, 1e-5])
)
def test_a_span_is_orthonormal_and_holds_its_columns(columns: int, repeated: int, empty: int, near: float):
    rng = np.random.default_rng(columns + 100 * repeated)
    own = rng.normal(size=(60, columns))
    own[:, -1] = own[:, 0] + near * own[:, -1]
    A = np.c_[own, own[:, rng.integers(0, columns, repeated)], np.zeros((60, empty))]
    length = np.linalg.norm(A, axis=0)
    A = A / np.where(length > 0, length, 1.0)
    Q = _span(A)
    assert Q.shape == (60, columns)
    np.testing.assert_allclose(Q.T @ Q, np.eye(columns), atol=1e-13)
    np.testing.assert_allclose(Q @ (Q.T @ A), A, atol=1e-13)
