"""What is found without whole tables of derivatives is what these give."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np
import pytest

from clampid.algebra import harmonics
from clampid.catalogue import catalogue
from clampid.diagnosis.linear_refit import linear_refit
from clampid.effect import Stage
from clampid.evidence.candidates import named_candidates
from clampid.evidence.score import score
from clampid.evidence.space import space_of
from clampid.fitting.descent import Chord, Limits, descend
from clampid.fitting.fit import fit
from clampid.fitting.noise import learn_noise
from clampid.fitting.parted_log import PartedLog
from clampid.fitting.prior_and_start import prior_of
from clampid.fitting.solve import solve, stage_point
from clampid.identification.fitted_stage import active_slots
from clampid.identification.identify import stage_rows
from clampid.slots import Term
from clampid.stages.fit_problem import FitProblem, fit_problem
from clampid.stages.layout import layout_of
from clampid.stages.pose_rows import pose_rows
from clampid.stages.rows import Array, Rows
from experiments.campaign import Campaign


@pytest.fixture(scope="module")
def arm(tiny: Campaign) -> FitProblem:
    rows = pose_rows([tiny], layout_of([tiny]), "poses")
    names = ("geometry", "joint_compliance", "joint_angle_curve")
    return fit_problem(rows, catalogue(), active_slots(rows, catalogue(), [Term(name, None) for name in names]))


def test_harmonics_are_sines_and_cosines():
    angle = np.linspace(-7.0, 7.0, 101)
    for k, (sine, cosine) in enumerate(harmonics(ca.DM(angle), 48), start=1):
        np.testing.assert_allclose(np.array(sine).ravel(), np.sin(k * angle), atol=1e-13)
        np.testing.assert_allclose(np.array(cosine).ravel(), np.cos(k * angle), atol=1e-13)


@dataclass
class Bent:
    """Where x is 2 less a little of y squared, and y a sine of x: no Gauss-Newton step reaches that at once."""

    theta: Array
    made: list[int] = field(default_factory=list)

    @property
    def residual(self) -> Array:
        x, y = self.theta
        return 1e4 * np.array([x - 2.0 + 0.05 * y * y, 3.0 * (y - np.sin(x))])

    @property
    def jacobian(self) -> Array:
        x, y = self.theta
        return 1e4 * np.array([[1.0, 0.1 * y], [-3.0 * np.cos(x), 3.0]])

    @property
    def cost(self) -> float:
        return float(self.residual @ self.residual)

    @property
    def count(self) -> int:
        return 2

    def gradient(self) -> Array:
        return -self.jacobian.T @ self.residual

    def normal(self) -> tuple[Array, Array]:
        self.made.append(1)
        return self.jacobian.T @ self.jacobian, self.gradient()


def test_a_kept_matrix_leads_to_the_same_place_in_fewer_matrices():
    limits = Limits(np.ones(2), np.full(2, -9.0), np.full(2, 9.0), np.zeros(2, dtype=bool))
    start, none, ends = np.array([1.9, 0.9]), np.zeros((2, 2)), []
    counts: list[int] = []
    for chord in (None, Chord(Bent.gradient)):
        made: list[int] = []
        end, _ = descend(lambda x, made=made: Bent(x, made), start, none, np.zeros(2), limits, chord)
        ends.append(end.theta)
        counts.append(len(made))
    assert counts[1] < counts[0]
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-5)


def test_errors_and_steps_are_those_of_the_whole_derivative(arm: FitProblem):
    rng = np.random.default_rng(1)
    size = arm.sizes()
    theta = arm.start() + 0.1 * size * rng.normal(size=len(size))
    residual, jacobian = arm.residual(theta)
    np.testing.assert_array_equal(arm.error(theta), residual)
    first = len(size) - 40
    last = arm.derivative(theta, first)
    np.testing.assert_allclose(last, jacobian[:, :, first:], rtol=1e-12, atol=1e-15)
    steps = size[:, None] * rng.normal(size=(len(size), 3))
    expected = jacobian @ steps
    np.testing.assert_allclose(arm.moved(theta, steps), expected, atol=1e-12 * np.abs(expected).max())


def test_a_candidate_fitted_along_has_the_derivatives_of_both(arm: FitProblem):
    estimate = fit(arm, reject=False)
    s = next(s for s in score(space_of(estimate), named_candidates(estimate, catalogue())) if s.freedom)
    near = linear_refit(estimate, s)
    assert near is not None
    white, old = near.whitened, estimate.whitened
    J = white.jacobian
    own = [near.slots.index(slot) for slot in estimate.slots]
    added = [near.slots.index(slot) for slot in s.candidate.slots]
    np.testing.assert_array_equal(J[:, own], old.jacobian)
    np.testing.assert_array_equal(J[:, added], s.candidate.columns.dense(len(J)))
    np.testing.assert_allclose(white.normal, J.T @ J, atol=1e-9 * np.abs(white.normal).max())
    step = near.theta.copy()
    step[own] -= estimate.theta[: len(own)]
    np.testing.assert_allclose(white.residual, old.residual - J @ step, atol=1e-9 * np.abs(old.residual).max())


def test_errors_and_steps_of_a_log_are_those_of_the_whole_derivative(few_rows: dict[Stage, Rows]):
    rows = few_rows["free_air"]
    names = ("gravity", "coulomb_friction", "load_dependent_friction", "torque_ripple")
    log = fit_problem(rows, catalogue(), active_slots(rows, catalogue(), [Term(name, None) for name in names]))
    rng = np.random.default_rng(2)
    size = log.sizes()
    theta = log.start() + 0.1 * size * rng.normal(size=len(size))
    residual, jacobian = log.residual(theta)
    np.testing.assert_array_equal(log.error(theta), residual)
    first = len(log.slots) - 9
    last = log.derivative(theta, first)
    np.testing.assert_array_equal(last, jacobian[:, :, first : len(log.slots)])
    near = theta + 1e-6 * size * (np.arange(len(size)) == first)
    slope = (residual - log.error(near)) / (1e-6 * size[first])
    np.testing.assert_allclose(last[:, :, 0], slope, atol=1e-4 * np.abs(slope).max())
    steps = size[:, None] * rng.normal(size=(len(size), 3))
    expected = jacobian @ steps
    np.testing.assert_allclose(log.moved(theta, steps), expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("further", [(), ("stribeck_friction",)])
def test_a_linear_log_is_searched_from_its_first_derivative(few_rows: dict[Stage, Rows], further: tuple[str, ...]):
    rows, names = few_rows["free_air"], ("gravity", "coulomb_friction", *further)
    log = fit_problem(rows, catalogue(), active_slots(rows, catalogue(), [Term(name, None) for name in names]))
    assert log.affine is (not further)  # whose speed is a shape
    noise = learn_noise(rows, log.error(log.start()))
    precision, mean = prior_of(log, ())
    found = solve(log, log.start(), noise, precision, mean)
    there = stage_point(log, noise, found.theta)
    scale = np.abs(there.residual).max()
    np.testing.assert_allclose(found.residual, there.residual, atol=1e-9 * scale)
    np.testing.assert_allclose(found.whitened.residual, there.white.residual, atol=1e-8)
    np.testing.assert_allclose(found.whitened.normal, there.matrix, atol=1e-9 * there.matrix.max())


def _is_the_whole_log(trial: FitProblem) -> None:
    """Compare a log by parts with the whole derivative, away from where the parts were computed."""
    rng, start = np.random.default_rng(1), trial.start()
    noise = learn_noise(trial.rows, trial.residual(start)[0])
    away = start + 0.01 * trial.sizes() * rng.standard_normal(len(start))
    parted, whole = PartedLog.of(trial, noise, start).at(away), stage_point(trial, noise, away)
    np.testing.assert_allclose(parted.residual, whole.residual, atol=1e-11 * np.abs(whole.residual).max())
    for mine, theirs in zip(parted.normal(), whole.normal(), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-11 * np.abs(theirs).max())
    np.testing.assert_allclose(parted.white.jacobian, whole.white.jacobian, atol=1e-9)


@pytest.mark.parametrize(
    "further",
    [
        ("stribeck_friction",),
        ("load_dependent_friction",),
        ("torque_gain",),
        ("torque_gain", "stribeck_friction", "torque_offset"),
        ("torque_gain", "load_dependent_friction", "inertia"),
    ],
)
def test_a_log_by_parts_is_the_whole_log(tiny: Campaign, further: tuple[str, ...]):
    """Residual, gradient, products and Jacobian at another point are those of the whole derivative made there."""
    known, layout = catalogue(), layout_of([tiny])
    names = ("gravity", "coulomb_friction", "viscous_friction", "wrist_coupling_friction", *further)
    rows = stage_rows([tiny], layout, "free_air")
    trial = fit_problem(rows, known, active_slots(rows, known, [Term(name) for name in names]))
    gains = "torque_gain" in further and "load_dependent_friction" not in further  # else they scale no linear torque
    assert len(trial.chain.gains.number) == (layout.joints if gains else 0)
    assert (0 if gains else 1) <= trial.chain.bends.sum() < len(trial.slots)
    assert trial.chain.bends.any() == (set(further) != {"torque_gain"})
    _is_the_whole_log(trial)


def test_a_gain_counts_where_nothing_is_known_to_weigh_at_the_start(tiny: Campaign):
    """The load that it scales is zero at the first point, and not at the others."""
    known, rows = catalogue(), stage_rows([tiny], layout_of([tiny]), "free_air")
    none = {name: np.zeros_like(rows.signals[name]) for name in ("gravity_torque", "inertia_torque")}
    rows = replace(rows, signals={**rows.signals, **none})
    names = ("gravity", "coulomb_friction", "torque_gain")
    trial = fit_problem(rows, known, active_slots(rows, known, [Term(name) for name in names]))
    _is_the_whole_log(trial)
