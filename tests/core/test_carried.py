"""What clamped sweeps tell the poses: springs with their covariance, unless the poses contradict them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from clampid.catalogue import catalogue
from clampid.effect import Stage
from clampid.evidence.candidates import named_candidates
from clampid.fitting.descent import inverse_of
from clampid.fitting.fit import fit
from clampid.fitting.prior_and_start import prior_of
from clampid.identification.carried import carried_drives, log_friction, prior_from, with_log_friction
from clampid.identification.fitted_stage import FittedStage, fit_stage
from clampid.identification.identify import stage_rows
from clampid.models.model import StageModel
from clampid.slots import Prior, Slot, Term
from clampid.stages.fit_problem import fit_problem
from clampid.stages.layout import layout_of
from experiments.campaign import Campaign
from kinematics.description import RobotDescription

Simulated = Callable[..., Campaign]
TERMS = {
    "free_air": ("gravity", "coulomb_friction", "viscous_friction", "wrist_coupling_friction"),
    "clamped": ("joint_compliance", "backlash", "coulomb_friction"),
    "poses": ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction"),
}
DRIVES = ("joint_compliance", "backlash")


@pytest.fixture(scope="module")
def campaign(simulated: Simulated) -> Campaign:
    return simulated(seed=3, poses=100, tables=("free_air", "wrist", "clamped", "poses", "verification"))


@pytest.fixture(scope="module")
def fitted(campaign: Campaign) -> Callable[..., FittedStage]:
    layout, effects = layout_of([campaign]), catalogue()

    def one(stage: Stage, before: dict[Stage, StageModel]) -> FittedStage:
        rows = stage_rows([campaign], layout, stage)
        return fit_stage(rows, effects, [Term(name) for name in TERMS[stage]], before)

    return one


@pytest.fixture(scope="module")
def clamped(fitted: Callable[..., FittedStage]) -> StageModel:
    return fitted("clamped", {}).model


@pytest.fixture(scope="module")
def free_air(fitted: Callable[..., FittedStage]) -> StageModel:
    """Frictions of the wrist: poses alone would tell them by flanks, which are not linear."""
    return fitted("free_air", {}).model


@pytest.fixture(scope="module")
def alone(fitted: Callable[..., FittedStage], free_air: StageModel) -> FittedStage:
    return fitted("poses", {"free_air": free_air})


@pytest.fixture(scope="module")
def together(fitted: Callable[..., FittedStage], free_air: StageModel, clamped: StageModel) -> FittedStage:
    return fitted("poses", {"free_air": free_air, "clamped": clamped})


def drives_of(model: StageModel) -> tuple[np.ndarray, np.ndarray]:
    index = [k for k, s in enumerate(model.slots) if s.effect in DRIVES]
    return model.theta[index], model.covariance[np.ix_(index, index)]


def test_poses_and_sweeps_are_weighted_by_their_covariances(
    clamped: StageModel, alone: FittedStage, together: FittedStage
):
    """Rule of two independent Gaussian estimates: information adds up, means weighted by it."""
    assert not together.contradicted
    order = [s for s in together.model.slots if s.effect in DRIVES]
    (a, spread_alone), (b, B) = drives_of(alone.model), drives_of(clamped)
    assert order == [s for s in clamped.slots if s.effect in DRIVES]
    # The weight that the rows had in the fit; what visits share widens the errors beyond that, not the weights.
    J = alone.estimate.whitened.jacobian
    index = [k for k, s in enumerate(alone.model.slots) if s.effect in DRIVES]
    A = inverse_of(J.T @ J + alone.estimate.prior_precision)[np.ix_(index, index)]
    scale = np.sqrt(np.diag(B))
    A, B = A / np.outer(scale, scale), B / np.outer(scale, scale)
    gain = linalg.solve(A + B, A, assume_a="pos").T
    mean = a + scale * (gain @ ((b - a) / scale))
    found, spread = drives_of(together.model)
    std = np.sqrt(np.diag(spread))
    told = [alone.model.identified[k] and together.model.identified[k] for k, _ in enumerate(alone.model.slots)]
    loaded = np.array([told[alone.model.slots.index(s)] for s in order])
    assert np.count_nonzero(loaded) >= 8
    np.testing.assert_allclose(((found - mean) / std)[loaded], 0.0, atol=0.2)  # flanks and noise are found anew
    assert np.all((std <= 1.05 * np.sqrt(np.minimum(np.diag(spread_alone), scale**2)))[loaded])


def test_what_no_pose_determines_is_not_taken_over(alone: FittedStage, together: FittedStage):
    """Gravity never loads joint 1: its clearance would only stand in predictions, on a flank that is guessed."""
    k = together.model.slots.index(Slot("joint_compliance", "c", "joint1"))
    assert not alone.model.identified[k]
    assert not together.model.identified[k]


def test_springs_that_the_poses_contradict_are_not_taken_over(
    fitted: Callable[..., FittedStage], free_air: StageModel, clamped: StageModel, alone: FittedStage
):
    """A clamp that yields makes springs too soft by many standard errors."""
    theta = clamped.theta.copy()
    theta[clamped.slots.index(Slot("joint_compliance", "c", "joint2"))] *= 1.5
    wrong = replace(clamped, theta=theta)
    found = fitted("poses", {"free_air": free_air, "clamped": wrong})
    assert "joint_compliance.c@joint2" in [a.slot.label for a in found.contradicted]
    assert found.evidence["contradicted"][0]["where"] == "joint2"
    told = np.array([s.place != "joint1" for s in found.model.slots])  # friction winds its spring like a gap: not told
    off = (found.model.theta - alone.model.theta) / alone.model.std
    np.testing.assert_allclose(off[told], 0.0, atol=0.05)


def test_a_stage_without_drives_gives_nothing(clamped: StageModel, alone: FittedStage):
    assert carried_drives(None, alone.estimate).prior is None
    friction = tuple(s for s in clamped.slots if s.effect == "coulomb_friction")
    index = [clamped.slots.index(s) for s in friction]
    bare = replace(
        clamped,
        slots=friction,
        theta=clamped.theta[index],
        covariance=clamped.covariance[np.ix_(index, index)],
        identified=(True,) * len(index),
    )
    assert carried_drives(bare, alone.estimate).prior is None


def test_a_prior_of_very_different_units_keeps_all_it_knows(alone: FittedStage):
    """Variances of 1e-12 rad² beside 1e4 kg²: a pseudo-inverse would call the small ones zero."""
    trial = fit_problem(
        alone.rows,
        catalogue(),
        (*(s for s in alone.model.slots if s.effect == "backlash"), Slot("gravity", "m", "link2")),
    )
    slots = (Slot("backlash", "gap", "joint2"), Slot("gravity", "m", "link2"))
    covariance = np.diag([1e-12, 1e4])
    precision, _ = prior_of(trial, (Prior(slots, np.zeros(2), covariance),))
    index = [trial.slots.index(s) for s in slots]
    np.testing.assert_allclose(np.diag(precision)[index] * np.diag(covariance), 1.0)


def test_priors_pull_by_their_information(alone: FittedStage, clamped: StageModel):
    prior = prior_from(clamped, tuple(s for s in clamped.slots if s.effect in DRIVES))
    sure = replace(prior, covariance=1e-6 * prior.covariance)
    found = fit(alone.estimate.problem, (sure,), alone.estimate.values())
    values = np.array([found.values()[s] for s in prior.slots])
    np.testing.assert_allclose(values, prior.mean, atol=1e-7)


def moving(robot: RobotDescription, friction: float, *further: Slot) -> StageModel:
    """A torque stage that knows a dry friction of every motor, and further numbers."""
    slots = (*(Slot("coulomb_friction", "Fc", f"joint{j + 1}") for j in range(robot.n)), *further)
    one = np.ones(len(slots))
    return StageModel(
        "free_air", (), slots, friction * one, np.diag((0.01 * friction * one) ** 2), (True,) * len(slots)
    )


def test_the_friction_of_a_joint_is_that_of_all_motors_that_turn_with_it(campaign: Campaign):
    """Power: where joint 4 turns alone, motors of the coupled wrist turn with it, and each brakes it."""
    robot = campaign.robot
    found = log_friction({"free_air": moving(robot, 0.5)}, robot, catalogue())
    for j in range(robot.n):
        speed = np.zeros(robot.n)
        speed[j] = 1.0
        power = 0.5 * np.abs(np.linalg.solve(np.asarray(robot.transmission).T, speed)).sum()
        assert power < found[j] < 1.001 * power
    assert np.isinf(log_friction({}, robot, catalogue())).all()


def test_what_a_log_does_not_know_bounds_nothing(campaign: Campaign):
    robot = campaign.robot
    known = moving(robot, 0.5, Slot("wrist_coupling_friction", "F", "joint2"))
    some = replace(known, identified=tuple(slot.place != "joint5" for slot in known.slots))
    with_motor_5 = np.linalg.inv(np.asarray(robot.transmission))[:, 4] != 0.0
    assert 0 < with_motor_5.sum() < robot.n
    of_its_own = np.arange(robot.n) == 1
    assert (np.isinf(log_friction({"free_air": known}, robot, catalogue())) == of_its_own).all()
    assert (np.isinf(log_friction({"free_air": some}, robot, catalogue())) == with_motor_5 | of_its_own).all()


def test_a_loaded_joint_has_no_more_friction_at_the_arm_than_in_all(
    campaign: Campaign, alone: FittedStage, free_air: StageModel
):
    """Of a joint that bears nothing, a clearance and the twist by friction are one number, and stay so."""
    problem, most = alone.estimate.problem, log_friction({"free_air": free_air}, campaign.robot, catalogue())
    load = np.median(np.abs(problem.rows.signals["gravity_torque"]), axis=0)
    bounded = np.isfinite(most) & (load > most)
    assert bounded[1]
    assert not bounded[0]
    for k in problem.numbers_of("arm_friction"):
        joint = int(problem.slots[k].place.removeprefix("joint")) - 1
        assert problem.prior_std()[k] == pytest.approx(min(50.0, most[joint]) if bounded[joint] else 50.0)
        assert problem.clear()[k] <= 0.5 * problem.prior_std()[k]


def test_a_clearance_is_tried_with_the_friction_of_a_joint_that_bears_less(alone: FittedStage, free_air: StageModel):
    """Without it, one of 0.2 mrad at such a joint explained 0.9 instead of 435, and something unknown was missing."""
    rows = with_log_friction(alone.estimate.problem.rows, {"free_air": free_air}, catalogue())
    assert rows.pose.log_friction is not None
    assert rows.pose.flank_friction is not None
    light = np.isinf(rows.pose.log_friction) & np.isfinite(rows.pose.flank_friction)
    assert light[0]
    slots = tuple(s for s in alone.estimate.slots if s.effect != "backlash")
    estimate = fit(fit_problem(rows, catalogue(), slots))
    tried = [c for c in named_candidates(estimate, {"backlash": catalogue()["backlash"]}) if c.friction]
    joints = {slot.place: value for c in tried for slot, value in c.friction.items()}
    assert joints["joint1"] == pytest.approx(rows.pose.flank_friction[0])
