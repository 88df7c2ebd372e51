"""A stage is diagnosed with what those before it lack: what a torque log shows is not given another name in poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType

import pytest

from clampid.catalogue import catalogue
from clampid.diagnosis.candidate_scores import simplest_of
from clampid.diagnosis.diagnose import Diagnosis, diagnose
from clampid.diagnosis.scoring import scores_of
from clampid.diagnosis.tried import Undecided
from clampid.evidence.candidates import terms_not_active
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.loop.auto import mend
from clampid.models.model import Model
from clampid.slots import Term
from experiments.campaign import Campaign

BALANCER = "gravity_compensator"
LAWS = (BALANCER, "long_lever_compensator")  # of two and of three harmonics


@pytest.fixture(scope="module")
def campaign(simulated: Callable[..., Campaign]) -> Campaign:
    tables = ("free_air", "wrist", "poses", "verification")
    return simulated(seed=2, poses=100, tables=tables, hidden=(f"{BALANCER}@joint2",))


@pytest.fixture(scope="module")
def mended(campaign: Campaign) -> tuple[Model, Diagnosis]:
    return mend(identify(campaign), campaign)


def first_of(found: Diagnosis) -> dict[str, tuple[str, list[str]]]:
    return {stage: (part.candidates[0]["effect"], part.candidates[0]["where"]) for stage, part in found.stages.items()}


def test_poses_name_what_the_log_has_shown(mended: tuple[Model, Diagnosis]):
    _, found = mended
    assert first_of(found) == {"free_air": (BALANCER, ["joint2"]), "poses": (BALANCER, ["joint2"])}
    assert found.stages["poses"].verdict == "missing"


def test_what_is_added_has_one_value(mended: tuple[Model, Diagnosis]):
    """The poses take the log's, with its covariance."""
    model, _ = mended
    values = {stage: model.stages[stage].values() for stage in ("free_air", "poses")}
    shared = [slot for slot in values["free_air"] if slot.effect in LAWS]
    (law,) = {slot.effect for slot in shared}
    assert [slot.parameter for slot in shared] == list(catalogue()[law].by_name)
    for slot in shared:
        std = model.stages["free_air"].std[model.stages["free_air"].slots.index(slot)]
        assert values["poses"][slot] == pytest.approx(values["free_air"][slot], abs=4 * std)


@pytest.mark.slow
def test_poses_alone_do_not_find_the_balancer_of_the_log(campaign: Campaign, mended: tuple[Model, Diagnosis]):
    """Asked for the poses only, of a model without it, they call what they see by the name that they have."""
    poses = diagnose(identify(campaign), campaign, stages=["poses"]).stages["poses"]
    assert BALANCER not in {c["effect"] for c in poses.candidates}


@pytest.mark.slow
def test_what_a_log_leaves_open_is_no_gear_in_poses(simulated: Callable[..., Campaign]):
    """An offset of joint 2's torque is one of three names by the log alone, so that none of them is added.

    Gravity then has the errors that it has with one of them fitted along: the poses are told so, and see no eccentric
    gear in what the offset has done to it.
    """
    tables = ("free_air", "wrist", "poses", "verification")
    campaign = simulated(seed=2, poses=100, tables=tables, hidden=("torque_offset@joint2",))
    found = diagnose(identify(campaign), campaign).stages
    assert found["free_air"].verdict == "ambiguous"
    assert found["free_air"].candidates[0]["name"] == "torque_offset"
    assert found["poses"].verdict == "adequate"
    assert found["poses"].after < 1.15 * found["poses"].noise_floor


@pytest.mark.slow
def test_two_names_of_one_model_are_alike_and_a_third_is_not(simulated: Callable[..., Campaign]):
    """An offset of the torque and an asymmetric friction are the same columns; a cable pulls at the poses, too."""
    tables = ("free_air", "wrist", "poses", "verification")
    campaign = simulated(seed=2, poses=100, tables=tables, hidden=("torque_offset@joint2",))
    opened = on_campaign(
        identify(campaign, {"free_air": ["gravity", "coulomb_friction", "viscous_friction"]}), campaign
    )
    fitted = opened.refit("free_air", opened.rows("free_air"))
    scores = scores_of(fitted.estimate, dict(opened.effects), flips=19, seed=0)
    at = {s.candidate.name: s for s in scores.named if s.candidate.places == ("joint2",)}
    offset, friction, cable = (at[name] for name in ("torque_offset", "asymmetric_friction", "dress_pack"))
    kept = scores.remembered
    assert Undecided([offset, friction], kept).alike(opened.effects, ["poses"])
    assert not Undecided([offset, friction, cable], kept).alike(opened.effects, ["poses"])


@pytest.mark.slow
def test_the_model_of_a_log_alone_takes_the_name_that_moves_no_flange(simulated: Callable[..., Campaign]):
    """By a log alone an offset of joint 2's torque may be a cable, too, which would bend the arm in poses.

    The model takes the offset, and what else is missing is found beside it; that the name is open is still said.
    """
    hidden = ("torque_offset@joint2", "stribeck_friction@joint5")
    campaign = simulated(seed=2, poses=60, tables=("free_air", "wrist"), hidden=hidden)
    model, found = mend(identify(campaign), campaign)
    log, terms = found.stages["free_air"], model.stages["free_air"].terms
    assert log.verdict == "ambiguous"
    assert {c["name"] for c in log.candidates if c["alternative"]} >= {"torque_offset", "dress_pack"}
    assert Term("torque_offset", "joint2") in terms
    assert "dress_pack" not in {t.effect for t in terms}
    assert [step.label for step in log.in_order] == ["torque_offset@joint2", "stribeck_friction@joint5"]
    assert log.after == pytest.approx(1.0, abs=0.1)  # in units of the noise


@pytest.mark.slow
def test_a_drift_is_named_only_if_it_is_seen(simulated: Callable[..., Campaign]):
    """Beside a constant offset at joint 4 a drift with a room that hardly warmed explains what chance explains."""
    campaign = simulated(seed=2, poses=60, tables=("free_air", "wrist"), hidden=("torque_offset@joint4",))
    opened = on_campaign(identify(campaign), campaign)
    scores = scores_of(
        opened.refit("free_air", opened.rows("free_air")).estimate, dict(opened.effects), flips=19, seed=0
    )
    drifting = next(
        s
        for s in scores.named
        if s.candidate.label == "ambient_torque_offset@joint4" and s.candidate.places == ("joint4",)
    )
    assert simplest_of(scores.named, drifting).candidate.name == "torque_offset"


@pytest.mark.slow
@pytest.mark.parametrize("reading", [None, 24.0], ids=["not recorded", "constant"])
def test_a_drift_with_a_temperature_that_never_varies_is_not_looked_for(
    simulated: Callable[..., Campaign], reading: float | None
):
    """It would be the constant offset under another name."""
    whole = simulated(seed=2, poses=60, tables=("free_air", "wrist"))
    assert "ambient_torque_offset" in sought(whole)
    tables = {
        name: t.drop(columns="temp_ambient_C") if reading is None else t.assign(temp_ambient_C=reading)
        for name, t in whole.tables.items()
    }
    names = sought(replace(whole, tables=MappingProxyType(tables), fingerprint=f"ambient {reading}"))
    assert "ambient_torque_offset" not in names
    assert {"torque_offset", "motor_torque_offset"} <= names  # the motors' temperatures do vary


def sought(campaign: Campaign) -> set[str]:
    """The effects that diagnosis of a log looks for."""
    opened = on_campaign(identify(campaign), campaign)
    estimate = opened.refit("free_air", opened.rows("free_air")).estimate
    return {term.effect for term in terms_not_active(estimate, dict(opened.effects))}
