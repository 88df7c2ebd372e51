"""Joints on one curve: found with their senses and phases where they share it, left alone where they do not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clampid.catalogue import catalogue
from clampid.chain.chain import build_chain
from clampid.comparison.compare import compare
from clampid.effect import EffectError
from clampid.evidence.alignment import VERY_STRONG_LOG_ODDS, Alignment, align, alignment_of
from clampid.evidence.curves import Curves, turned
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.loop.add import add
from clampid.loop.undo import undo
from clampid.models.curves import angle_errors, shared_curve
from clampid.models.model import Model, load_model, save_model
from clampid.slots import Layout, Slot, slots_of
from clampid.stages.stage_kind import kind_of
from experiments.campaign import Campaign
from experiments.virtual_robot import Hidden, measure
from kinematics.description import load_robot

Simulated = Callable[..., Campaign]

ONE, SEVERAL = "encoder_disc:3", "different_encoder_discs:3"
OWN = ("geometry", "joint_compliance", "backlash", "joint_angle_curve")
SHARED = ("geometry", "joint_compliance", "backlash", "shared_angle_curve")
EFFECT = catalogue()["shared_angle_curve"]
HARMONICS = np.arange(3.0, 49.0)
SEAT, SIZE = 8e-5, 3e-4
SHARE = np.repeat((1 - (HARMONICS / 49) ** 2) / np.sqrt(np.sum((1 - (HARMONICS / 49) ** 2) ** 2)), 2)


def true_turns(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Senses and phases ``(n,)`` of the hidden discs, counted from the first joint's."""
    drive = measure(load_robot("ur10"), [Hidden.parse(ONE)], seed=seed, poses=2, tables=("poses",)).truth.plant.drive
    sense = drive.disc_sense
    return sense * sense[0], sense[0] * (drive.disc_turn[0] - drive.disc_turn)


def off_by(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Difference of two angles, the short way round."""
    return np.angle(np.exp(1j * (found - true)))


@pytest.fixture(scope="module")
def one_disc(simulated: Simulated) -> Campaign:
    return simulated(seed=2, poses=200, tables=("poses",), hidden=(ONE,), robot="ur10")


@pytest.fixture(scope="module")
def one_curve(one_disc: Campaign) -> Model:
    return identify(one_disc, SHARED, holdout=0.05)


def drawn(rng: np.random.Generator, members: int, deviation: float, noise: float = 1e-5) -> tuple:
    """What precise rows would say of curves of which the first few are one: with true senses and phases."""
    joints = 4
    sense, phase = rng.choice([-1.0, 1.0], joints), rng.uniform(-np.pi, np.pi, joints)
    curve = SIZE * SHARE * rng.normal(size=92)
    coefficients = np.empty((joints, 96))
    for j in range(joints):
        own = SHARE * rng.normal(size=92)
        high = turned(sense[j], phase[j], HARMONICS) @ curve + deviation * own if j < members else SIZE * own
        coefficients[j] = np.r_[SEAT * rng.normal(size=4), high]
    measured = coefficients + noise * rng.normal(size=coefficients.shape)
    information = (np.eye(joints * 96) / noise**2).reshape(joints, 96, joints, 96)
    return Curves(tuple(range(joints)), information, measured / noise**2, np.full(4, SEAT), SHARE), sense, phase


def check(found: Alignment, sense: np.ndarray, phase: np.ndarray, members: int) -> None:
    assert found.joints == tuple(range(members))
    np.testing.assert_array_equal(found.sense, sense[0] * sense[:members])
    np.testing.assert_allclose(off_by(found.phase, sense[0] * (phase - phase[0])[:members]), 0.0, atol=np.radians(1.0))


@pytest.mark.slow
@settings(max_examples=2, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([0.0, 3e-5]))
def test_joints_on_one_curve_are_found_and_the_others_left(seed: int, deviation: float):
    curves, sense, phase = drawn(np.random.default_rng(seed), 3, deviation)
    found = align(curves)
    check(found, sense, phase, 3)
    assert found.log_odds > VERY_STRONG_LOG_ODDS
    assert list(found.refused) == [3]
    assert found.refused[3] < VERY_STRONG_LOG_ODDS
    if deviation:
        # With the noise above, three times a coefficient's deviation, that is hardly told; with a tenth of it, to 6 %.
        quiet, *_ = drawn(np.random.default_rng(seed), 3, deviation, noise=1e-6)
        assert align(quiet).deviation == pytest.approx(deviation, rel=0.4)


@pytest.mark.slow
@settings(max_examples=2, deadline=None)
@given(st.integers(0, 2**31))
def test_different_curves_are_not_one(seed: int):
    curves, _, _ = drawn(np.random.default_rng(seed), 0, 0.0)
    assert align(curves).joints == ()


@settings(max_examples=50, deadline=None)
@given(st.sampled_from([-1.0, 1.0]), st.floats(-10, 10), st.floats(-4, 4), st.integers(0, 2**31))
def test_turned_coefficients_are_those_of_the_turned_curve(sense: float, phase: float, q: float, seed: int):
    k, a = HARMONICS, np.random.default_rng(seed).normal(size=92)

    def value(c: np.ndarray, u: float) -> float:
        return float(c[::2] @ np.sin(k * u) + c[1::2] @ np.cos(k * u))

    assert value(turned(sense, phase, k) @ a, q) == pytest.approx(sense * value(a, sense * q - phase), abs=1e-9)


@pytest.mark.slow
def test_the_effect_is_the_curve_of_the_alignment():
    """The values that an alignment hands over mean the same in the effect's own formula."""
    rng = np.random.default_rng(5)
    curves, *_ = drawn(rng, 4, 3e-5, noise=1e-6)
    found = align(curves)
    layout = Layout(4)
    slots = slots_of(EFFECT, layout)
    chain = build_chain(kind_of("poses"), slots, catalogue(), layout, {})
    values = found.values(EFFECT)
    q = rng.uniform(-np.pi, np.pi, (20, 4))
    error = chain.evaluate(np.array([values[s] for s in slots]), {"q": q}).values[:, chain.offsets["joint_angle"]]
    truth = curves.score * 1e-6**2  # what the rows measured
    order = np.arange(1, 49)
    for j in range(4):
        angle = q[:, [j]] * order
        expected = np.sin(angle) @ truth[j, ::2] + np.cos(angle) @ truth[j, 1::2]
        np.testing.assert_allclose(error[:, j], expected, atol=3e-5)


def test_a_shared_disc_is_found_from_the_poses_alone(one_disc: Campaign, one_curve: Model):
    stage = one_curve.stages["poses"]
    assert [t.label for t in stage.terms[3:]] == [f"shared_angle_curve@joint{j}" for j in range(1, 7)]
    one = shared_curve(stage, catalogue(), np.linspace(0, 2 * np.pi, 361)[:-1])
    assert one is not None
    sense, phase = true_turns(2)
    np.testing.assert_array_equal(np.round(one.sense, 6), sense)
    assert np.all(np.abs(off_by(one.phase, phase)) < 4 * one.phase_std + 1e-9)
    assert one.phase_std[0] < 1e-6 < one.phase_std[1:].min() < one.phase_std[1:].max() < np.radians(1.0)
    assert one.deviation < 0.4 * np.std(one.error)
    # A pose of one joint counts for all: less is extrapolated than by curves of the joints' own.
    q = np.tile(np.linspace(-np.pi, np.pi, 181)[:, None], (1, 6))
    own = identify(one_disc, OWN, holdout=0.05)
    far = [
        angle_errors(m.stages["poses"], catalogue(), m.layout, one_disc.robot, q).extrapolated.mean()
        for m in (own, one_curve)
    ]
    assert far[1] <= far[0]


@pytest.mark.slow
def test_one_curve_carries_further_than_several(one_disc: Campaign, one_curve: Model):
    """To poses of the same robot where a joint had never been: another joint has."""
    rows = one_disc.tables["poses"]
    part = rows[np.sin(rows["q5_rad"]) > 0].reset_index(drop=True)
    rest = rows[np.sin(rows["q5_rad"]) < 0].reset_index(drop=True)
    near = replace(one_disc, tables={"poses": part}, fingerprint="near")
    away = replace(one_disc, tables={"poses": rest}, fingerprint="away")
    error = [
        compare(identify(near, e, holdout=0.05), away, refit=("base",), refit_fraction=0.1).tables["poses"]["heldout"]
        for e in (OWN, SHARED)
    ]
    assert error[1]["rms"] < 0.8 * error[0]["rms"]


def test_the_model_is_fitted_again_as_it_was(one_disc: Campaign, one_curve: Model, tmp_path: Path):
    """A model read from its file keeps senses, deviation and the first phase, and its joints."""
    save_model(one_curve, tmp_path / "model.json")
    again = on_campaign(load_model(tmp_path / "model.json"), one_disc).refit("poses")
    old, new = one_curve.stages["poses"].values(), again.model.values()
    assert again.model.terms == one_curve.stages["poses"].terms
    for slot, value in old.items():
        if slot.parameter in ("sense", "deviation") or slot == Slot(EFFECT.name, "phase", "joint1"):
            assert new[slot] == pytest.approx(value, rel=1e-6, abs=1e-6)
    np.testing.assert_allclose(again.model.theta, one_curve.stages["poses"].theta, atol=0.2 * again.model.std.max())


@pytest.mark.slow
def test_adding_it_takes_the_place_of_the_curves(one_disc: Campaign):
    model = identify(one_disc, OWN, holdout=0.05)
    mended, addition = add(model, one_disc, ["shared_angle_curve"])
    labels = [t.label for t in mended.stages["poses"].terms]
    assert "joint_angle_curve" not in " ".join(labels)
    added = addition.stages["poses"]
    assert [(a["name"], a["where"]) for a in added.added] == [(EFFECT.name, [f"joint{j}" for j in range(1, 7)])]
    assert added.after.heldout_rms < 1.05 * added.before.heldout_rms
    with pytest.raises(EffectError, match="in the model already"):
        add(mended, one_disc, ["shared_angle_curve"])
    back, _ = undo(mended, one_disc)
    assert {t.label for t in back.stages["poses"].terms} == set(model.ledger[-1].effects)
    assert back.ledger == model.ledger


@pytest.mark.slow
def test_different_discs_keep_their_own_curves(simulated: Simulated):
    campaign = simulated(seed=2, poses=200, tables=("poses",), hidden=(SEVERAL,), robot="ur10")
    model = identify(campaign, OWN, holdout=0.05)
    found = alignment_of(on_campaign(model, campaign).refit("poses").estimate, EFFECT)
    assert found is not None
    assert found.joints == ()
    with pytest.raises(EffectError, match=r"found no evidence of one.*joint_angle_curve gives each joint"):
        identify(campaign, SHARED, holdout=0.05)


def test_one_joint_shares_with_nobody(one_disc: Campaign):
    with pytest.raises(EffectError, match="expected two joints or more"):
        identify(one_disc, ("geometry", "shared_angle_curve@joint2"), holdout=0.05)
