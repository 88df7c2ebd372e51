"""All tables in one fit: the same as stage by stage where nothing is shared, and never much worse where much is."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.cli import run
from clampid.comparison.compare import compare
from clampid.identification.fitted_stage import fit_stage
from clampid.identification.identify import identify
from clampid.identification.joint import is_shared
from clampid.identification.model_on_campaign import on_campaign
from clampid.models.model import Model, load_model, save_model
from experiments.campaign import Campaign

Simulated = Callable[..., Campaign]
STAGES = ("free_air", "clamped", "poses")


@pytest.fixture(scope="module")
def campaign(simulated: Simulated) -> Campaign:
    return simulated(seed=3, poses=60)


@pytest.fixture(scope="module")
def apart(campaign: Campaign) -> Model:
    return identify(campaign, holdout=0.2)


@pytest.fixture(scope="module")
def joint(campaign: Campaign) -> Model:
    return identify(campaign, holdout=0.2, joint=True)


def shared_of(model: Model) -> list[tuple[str, str]]:
    """Pairs (slot, stages) of the effects that are the arm's."""
    effects = catalogue()
    seen: dict[str, list[str]] = {}
    for name, stage in model.stages.items():
        for slot in stage.slots:
            if is_shared(effects[slot.effect]):
                seen.setdefault(slot.label, []).append(name)
    return [(label, ",".join(stages)) for label, stages in seen.items() if len(stages) > 1]


def value(model: Model, stage: str, label: str) -> tuple[float, float]:
    part = model.stages[stage]  # type: ignore[index]
    k = [s.label for s in part.slots].index(label)
    return float(part.theta[k]), float(part.std[k])


def test_what_is_shared_has_one_value(joint: Model):
    pairs = shared_of(joint)
    assert {"joint_compliance.c@joint2", "backlash.gap@joint5", "gravity.mx@link2"} <= {label for label, _ in pairs}
    for label, stages in pairs:
        first, *rest = stages.split(",")
        for other in rest:
            assert value(joint, other, label) == pytest.approx(value(joint, first, label), rel=1e-9), label


def test_friction_of_a_motor_is_not_shared(joint: Model):
    assert not is_shared(catalogue()["coulomb_friction"])
    label = "coulomb_friction.Fc@joint1"
    assert value(joint, "free_air", label) != value(joint, "clamped", label)


def test_joint_fit_has_no_larger_standard_errors_than_stagewise(apart: Model, joint: Model):
    for label, stages in shared_of(joint):
        for stage in stages.split(","):
            assert value(joint, stage, label)[1] <= 1.05 * value(apart, stage, label)[1], (label, stage)
    # The clamped springs gain from the poses, which stage by stage they never hear of.
    label = "backlash.gap@joint4"
    assert value(joint, "clamped", label)[1] < 0.8 * value(apart, "clamped", label)[1]


def test_the_last_stage_is_where_the_joint_fit_is(apart: Model, joint: Model):
    """Priors carried forward bring the last stage near the joint fit, which alone knows drives that no pose tells."""
    a, b = apart.stages["poses"], joint.stages["poses"]
    assert a.slots == b.slots
    told = np.array(a.identified)
    np.testing.assert_allclose(((a.theta - b.theta) / a.std)[told], 0.0, atol=1.0)  # a standard error


def test_held_out_rows_are_not_worse(apart: Model, joint: Model):
    for old, new in zip(apart.ledger, joint.ledger, strict=True):
        assert (old.stage, old.effects) == (new.stage, new.effects)
        assert new.evidence["joint"]
        assert new.heldout_rms < 1.02 * old.heldout_rms


@pytest.mark.slow
def test_an_unloaded_joint_whose_friction_comes_out_negative_keeps_its_flanks(simulated: Simulated):
    """Nothing loads joint 1 of this robot; its friction is known to 2 Nm, and comes out below zero by 1.5 errors."""
    campaign = simulated(seed=4, poses=100, tables=("free_air", "wrist", "clamped", "poses"))
    apart, joint = identify(campaign, holdout=0.2, seed=4), identify(campaign, holdout=0.2, seed=4, joint=True)
    friction, std = value(joint, "poses", "wrist_coupling_friction.F@joint1")
    assert -3.0 * std < friction < 0.0
    for old, new in zip(apart.ledger, joint.ledger, strict=True):
        assert new.heldout_rms < 1.02 * old.heldout_rms, new.stage


def test_a_stage_fitted_again_stays_where_it_was(campaign: Campaign, joint: Model):
    """With what all other rows say of it as prior, no row counts twice."""
    opened = on_campaign(joint, campaign)
    for stage in ("clamped", "poses"):
        again, model = opened.refit(stage).model, joint.stages[stage]
        assert again.slots == model.slots
        np.testing.assert_allclose((again.theta - model.theta) / model.std, 0.0, atol=0.3)
        np.testing.assert_allclose(again.std, model.std, rtol=0.1)


def test_the_model_file_says_so(joint: Model, apart: Model, tmp_path: Path):
    save_model(joint, tmp_path / "joint.json")
    again = load_model(tmp_path / "joint.json")
    assert again.joint
    for name, stage in joint.stages.items():
        told = again.stages[name].carried_prior
        assert told is not None
        assert stage.carried_prior is not None
        assert told.slots == stage.carried_prior.slots
        np.testing.assert_array_equal(told.covariance, stage.carried_prior.covariance)
    assert not apart.joint
    assert all(s.carried_prior is None for s in apart.stages.values())


def test_the_comparison_reads_it(joint: Model, campaign: Campaign):
    found = compare(joint, campaign)
    assert set(found.tables) >= {"free_air", "clamped", "poses"}
    # The agreement is tested on stages fitted alone: joint ones agree by construction.
    assert any(abs(a.z) > 0.01 for a in found.drives)


@pytest.mark.slow
def test_one_stage_alone_is_the_same_fit(simulated: Simulated):
    campaign = simulated(seed=5, poses=12, tables=("clamped",))
    apart, joint = identify(campaign), identify(campaign, joint=True)
    a, b = apart.stages["clamped"], joint.stages["clamped"]
    np.testing.assert_allclose((a.theta - b.theta) / a.std, 0.0, atol=0.02)
    np.testing.assert_allclose(a.std, b.std, rtol=0.01)


@pytest.mark.slow
def test_contradicted_springs_are_not_shared(simulated: Simulated):
    """Where the poses contradict the sweeps, each stage keeps springs of its own, and the ledger says so."""
    campaign = simulated(seed=1, poses=100, hidden=("fixture_compliance",))
    apart, joint = identify(campaign), identify(campaign, joint=True)
    assert apart.ledger[-1].evidence["contradicted"]
    assert joint.ledger[-1].evidence["contradicted"]
    label = "joint_compliance.c@joint2"
    assert value(joint, "clamped", label) != value(joint, "poses", label)
    assert joint.ledger[-1].heldout_rms < 1.02 * apart.ledger[-1].heldout_rms


@pytest.mark.slow
def test_on_the_command_line(campaign: Campaign, tmp_path: Path):
    target, data = tmp_path / "joint.json", tmp_path / "out.json"
    call = ["identify", str(campaign.path), "-o", str(target), "--joint", "-q", "--json", str(data)]
    assert run(call) == 0
    assert json.loads(target.read_text())["joint"] is True
    assert json.loads(data.read_text())["joint"] is True


def test_what_was_identified_replaces_what_is_carried_over(campaign: Campaign, joint: Model):
    opened = on_campaign(joint, campaign)
    stage = joint.stages["poses"]
    plain = fit_stage(opened.rows("poses"), opened.effects, stage.terms, {}, stage.values(), opened.held_out("poses"))
    assert (
        plain.model.std[stage.slots.index(joint.stages["clamped"].slots[0])]
        > stage.std[stage.slots.index(joint.stages["clamped"].slots[0])]
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*(pytest.param(s, marks=pytest.mark.study) for s in (2, 3)), 5])
def test_the_search_gets_where_every_stage_is_explained(simulated: Simulated, seed: int):
    """From the poses' springs alone the constants of sweeps are so far off that no step leads down."""
    campaign = simulated(seed=seed, poses=100, tables=("free_air", "wrist", "clamped", "poses"))
    apart, joint = (identify(campaign, holdout=0.2, seed=seed, joint=together) for together in (False, True))
    for one, whole in zip(apart.ledger, joint.ledger, strict=True):
        assert one.stage == whole.stage
        assert whole.heldout_rms < 1.05 * one.heldout_rms, one.stage
