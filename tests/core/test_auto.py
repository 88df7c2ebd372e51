"""The whole loop: every step that a diagnosis confirmed is a round of the ledger, and can be taken back alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.diagnosis import testability
from clampid.diagnosis.candidate_scores import DICTIONARY_FALSE_ALARMS, IMPOSSIBLE
from clampid.diagnosis.diagnose import Diagnosis, diagnose
from clampid.diagnosis.rejected import evidence_of
from clampid.diagnosis.result import Step
from clampid.diagnosis.scoring import scores_of
from clampid.display import error_text
from clampid.effect import Stage
from clampid.identification.fitted_stage import FittedStage, fit_stage
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.loop.add import add, add_steps
from clampid.loop.auto import auto, mend
from clampid.loop.undo import undo
from clampid.models.model import Model, load_model, save_model
from clampid.slots import Term
from experiments.campaign import Campaign

Simulated = Callable[..., Campaign]
START = ("geometry",)  # a robot of poses yields and has clearances, too


@pytest.fixture(scope="module")
def arm(simulated: Simulated) -> Campaign:
    hidden = ("thermal_expansion:3",)
    return simulated(seed=3, poses=100, tables=("poses", "verification"), hidden=hidden, robot="ur10")


@pytest.fixture(scope="module")
def first(arm: Campaign) -> Model:
    return identify(arm, START)


@pytest.fixture(scope="module")
def mended(arm: Campaign) -> tuple[Model, Diagnosis]:
    return auto(arm, START)


def test_each_step_is_a_round_and_the_error_falls(mended: tuple[Model, Diagnosis], first: Model):
    model, found = mended
    steps = found.stages["poses"].steps
    assert [step.terms[0].effect for step in steps[:2]] == ["joint_compliance", "thermal_expansion"]
    assert model.ledger[0] == first.ledger[0]
    rounds = model.ledger[1:]
    assert [r.added for r in rounds] == [tuple(t.label for t in step.terms) for step in steps]
    errors = [r.heldout_rms for r in model.ledger]
    assert np.all(np.diff(errors) < 0.0)
    for before, after in zip(model.ledger, rounds, strict=False):
        assert after.evidence["heldout_rms_before"] == pytest.approx(before.heldout_rms, rel=0.01)
        assert after.effects == (*before.effects, *after.added)


def test_rounds_end_where_the_diagnosis_did(mended: tuple[Model, Diagnosis]):
    """Friction only winds up springs: of it no row tells anything before there are any, and one round would lose it."""
    model, found = mended
    stage, part = model.stages["poses"], found.stages["poses"]
    assert part.fitted is not None
    assert "wrist_coupling_friction" in {t.effect for t in stage.terms}
    known = part.fitted.model.values()
    assert set(stage.slots) == set(known)
    off = [(value - known[slot]) / std for (slot, value), std in zip(stage.values().items(), stage.std, strict=True)]
    np.testing.assert_allclose(off, 0.0, atol=0.1)
    assert model.ledger[-1].heldout_rms == pytest.approx(part.after, rel=1e-5)


def test_add_gives_the_error_that_the_diagnosis_has_said(arm: Campaign, first: Model, mended: tuple[Model, Diagnosis]):
    """Both begin at the same step towards each effect: on gears' flanks another start ends in another minimum."""
    part = mended[1].stages["poses"]
    terms = [f"poses={c['name']}@{p}" if c["where"] else c["name"] for c in part.candidates for p in c["where"] or [""]]
    _, addition = add(first, arm, terms)
    after = addition.stages["poses"].after.heldout_rms
    assert error_text(after, "m") == error_text(part.after, "m")
    assert after == pytest.approx(part.after, rel=1e-4)


def test_undo_takes_back_one_step(arm: Campaign, mended: tuple[Model, Diagnosis]):
    model, _ = mended
    back, gone = undo(model, arm)
    assert gone == model.ledger[-1]
    assert back.ledger == model.ledger[:-1]
    assert tuple(t.label for t in back.stages["poses"].terms) == model.ledger[-2].effects


def test_a_step_of_which_no_row_is_informative_is_left_out_and_said(arm: Campaign, first: Model):
    again, gear = Step((Term("thermal_expansion", "link2"),)), Step((Term("gear_eccentricity", "joint2"),))
    model, left_out = add_steps(first, arm, {"poses": [again, gear, again]})
    assert left_out == [("poses", again)]
    assert [r.added for r in model.ledger[1:]] == [("thermal_expansion@link2",), ("gear_eccentricity@joint2",)]


def test_a_round_keeps_what_spoke_for_it_and_against_all_else(
    arm: Campaign, first: Model, mended: tuple[Model, Diagnosis], tmp_path: Path
):
    model, found = mended
    save_model(model, tmp_path / "model.json")
    rounds = load_model(tmp_path / "model.json").ledger[1:]
    assert rounds == model.ledger[1:]
    expansion = next(r for r in rounds if r.added == ("thermal_expansion@link2",)).evidence
    candidate = next(c for c in found.stages["poses"].candidates if c["effect"] == "thermal_expansion")
    for key in ("p_value", "p_familywise", "p_held_out", "stability", "confusable_with"):
        assert expansion[key] == candidate[key]
    assert expansion["p_familywise"] == 1 / 200
    # Of its other places the best is the next link, which explains a part of it.
    other = next(r for r in expansion["rejected"] if r["name"] == "thermal_expansion")
    assert other["where"] == ["link1"]
    assert other["explained"] < 0.5 * expansion["explained"]
    assert other["reason"] == f"explains {100 * other['explained'] / expansion['explained']:.0f} % as much"
    assert "heldout_rms_after" not in other  # it was not fitted
    for entry in (r for rnd in rounds for r in rnd.evidence["rejected"]):
        assert entry["reason"]
        assert entry["p_familywise"] <= DICTIONARY_FALSE_ALARMS


def test_what_was_fitted_and_refused_comes_first_and_once(arm: Campaign, first: Model):
    opened = on_campaign(first, arm)
    scores = scores_of(opened.refit("poses").estimate, dict(opened.effects), 99, 0)
    best = scores.best()
    assert best is not None
    others = evidence_of({"p_value": 1e-9, "parameters": []}, best, scores, [])
    assert others["p_value"] == 1e-9
    assert "parameters" not in others
    same = {**others["rejected"][-1], "heldout_rms_after": 1e-4, "reason": "the held-out error does not fall"}
    rejected = evidence_of({}, best, scores, [same])["rejected"]
    assert rejected[0] == same
    assert len(rejected) == len(others["rejected"])
    mine = {(best.candidate.name, p) for p in best.candidate.places}
    assert not mine & {(r["name"], p) for r in rejected for p in r["where"]}


@pytest.mark.slow
def test_limits_are_those_of_what_is_not_in_the_model_in_the_end(arm: Campaign, mended: tuple[Model, Diagnosis]):
    model, found = mended
    listed = found.stages["poses"].testability
    active = {(t.effect, t.place) for t in model.stages["poses"].terms}
    assert not active & {(e["name"], place) for e in listed for place in e["where"]}
    states = {e["state"] for e in listed}
    assert {"testable", "insensitive", "absent", "weak"} <= states
    for entry in listed:
        told = [limit for limit in entry["limits"] if limit["limit"] is not None]
        assert bool(told) or entry["state"] != "testable"
        assert not told or entry["state"] != "insensitive"
        assert all(0.0 < limit["limit"] <= IMPOSSIBLE * limit["size"] for limit in told)
    # Springs hid in their residual what a gear of the same arm would be seen by.
    start = diagnose(identify(arm, (*START, "joint_compliance", "thermal_expansion@link2")), arm).stages["poses"]
    before = scores_of(on_campaign(identify(arm, START), arm).refit("poses").estimate, catalogue(), 99, 0)
    hidden = testability.testability_of(before.named, before.named_null, catalogue(), arm.robot)
    smallest = [
        min(limit["limit"] for e in several if e["name"] == "gear_eccentricity" for limit in e["limits"])
        for several in (hidden, start.testability)
    ]
    assert smallest[1] < 0.2 * smallest[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stage", "hidden", "start"),
    [
        ("free_air", "load_dependent_friction@joint2:3", None),
        pytest.param("poses", "thermal_expansion:3", START, marks=pytest.mark.study),
    ],
)
def test_what_the_diagnosis_of_one_stage_has_fitted_is_not_fitted_again(
    simulated: Simulated, monkeypatch: pytest.MonkeyPatch, stage: Stage, hidden: str, start: tuple[str, ...] | None
):
    """And it is the model that a fit of the same terms gives."""
    campaign = simulated(seed=3, poses=100, tables=(stage,), hidden=(hidden,), robot="ur10")
    model, found = auto(campaign, start)
    fitted: list[int] = []

    def counted(*args: Any, **options: Any) -> FittedStage:
        fitted.append(1)
        return fit_stage(*args, **options)

    steps = found.stages[stage].steps
    assert steps
    assert all(step.fitted is None for step in steps)
    monkeypatch.setattr("clampid.loop.add.fit_stage", counted)
    first = identify(campaign, start)
    again, _ = add_steps(first, campaign, {stage: steps})
    of_all = len(fitted)
    mend(first, campaign)
    assert len(fitted) - of_all == of_all - len(steps)
    for slot, value in again.stages[stage].values().items():
        size = np.sqrt(again.stages[stage].covariance.diagonal())[again.stages[stage].slots.index(slot)]
        assert abs(model.stages[stage].values()[slot] - value) < 0.01 * max(size, 1e-12)
