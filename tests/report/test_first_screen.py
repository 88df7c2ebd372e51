"""The report's first screen: three numbers, the fall of the error, one sentence, what is mended and what is open."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clampid.models.model import Model, Round, StageModel
from clampid.report.first_screen import FirstScreen, first_screen
from clampid.report.page import render
from clampid.slots import Layout, Term
from clampid.verbs.screens import mended_screen


def a_model(*added: str, held_out: tuple[float, ...] = (1.07e-4, 5.3e-5)) -> Model:
    terms = (Term("geometry"), *(Term(*label.split("@")) for label in added))
    rounds = [Round("poses", ("geometry",), (), 9e-5, held_out[0], 4.7e-5)]
    rounds += [
        Round("poses", ("geometry", label), (label,), 5e-5, e, 4.7e-5)
        for label, e in zip(added, held_out[1:], strict=True)
    ]
    stage = StageModel("poses", terms, (), np.zeros(0), np.zeros((0, 0)), ())
    return Model("ur10", Layout(6, ("T1",)), {"poses": stage}, (), tuple(rounds))


def found(verdict: str, *candidates: dict[str, Any], **more: Any) -> dict[str, Any]:
    part = {"verdict": verdict, "unit": "m", "noise_floor": 4.7e-5, "heldout_rms_before": 1.07e-4,
            "heldout_rms_after": 5.2e-5, "candidates": list(candidates), "depends_on": [], **more}  # fmt: skip
    return {"stages": {"poses": part}}


GEAR = {"effect": "gear_eccentricity", "name": "gear_eccentricity", "where": ["joint2"], "alternative": False,
        "parameters": [], "heldout_rms_after": 5.2e-5}  # fmt: skip


def test_what_was_missing_is_said_to_be_in_the_model_that_has_it() -> None:
    screen = first_screen(a_model("gear_eccentricity@joint2"), None, {}, found("missing", GEAR))
    assert screen.verdict.startswith("Gear eccentricity at joint 2 was missing and is now in the model")
    assert screen.good
    assert screen.mended == ("gear eccentricity at joint 2 (poses)",)
    assert screen.open == ()
    assert screen.numbers[1:] == (("with this model", "53.0 µm"), ("noise floor", "47.0 µm"))


def test_what_is_missing_still_is_open() -> None:
    screen = first_screen(a_model(held_out=(1.07e-4,)), None, {}, found("missing", GEAR))
    assert "now in the model" not in screen.verdict
    assert not screen.good
    assert screen.mended == ()
    assert screen.open == ("Gear eccentricity at joint 2 is not in the model yet.",)


def test_a_superseded_effect_is_not_called_missing() -> None:
    mended = a_model("joint_angle_curve@joint1", "bearing_tilt@joint4", held_out=(3e-4, 1.1e-4, 1e-4))
    stage = replace(
        mended.stages["poses"], terms=(Term("geometry"), Term("bearing_tilt", "joint4"), Term("shared_angle_curve"))
    )
    last = Round("poses", (), ("shared_angle_curve",), 9e-5, 9.5e-5, 4.7e-5)
    mended = replace(mended, stages={"poses": stage}, ledger=(*mended.ledger, last))
    fitted = {"heldout_rms": 9.5e-5, "noise_floor": 4.7e-5, "unit": "m"}
    data = {"diagnosis": found("missing", {**GEAR, "name": "joint_angle_curve"}), "stages": {"poses": fitted}}
    assert mended_screen(data, mended, {}, "Fitted and mended.", ()).facts == (
        ("poses:", "added bearing tilt at joint 4 and shared angle curve"),
    )
    curve = {**GEAR, "name": "joint_angle_curve", "where": ["joint1"]}
    tilt = {**GEAR, "effect": "bearing_tilt", "name": "bearing_tilt", "where": ["joint4"]}
    screen = first_screen(mended, None, {}, found("missing", curve, tilt))
    assert "now in the model" in screen.verdict
    assert screen.mended == ("bearing tilt at joint 4 (poses)", "shared angle curve (poses)")
    assert screen.open == ()


def test_a_diagnosis_after_mending_keeps_what_was_mended_in_the_sentence() -> None:
    screen = first_screen(a_model("gear_eccentricity@joint2"), None, {}, found("adequate"))
    assert screen.verdict.startswith(
        "Gear eccentricity at joint 2 was missing and is now in the model; no further effect was found"
    )
    assert len(screen.verdict.split()) <= 25


def test_without_a_diagnosis_nothing_is_claimed() -> None:
    screen = first_screen(a_model("gear_eccentricity@joint2"), None, {}, None)
    assert screen.verdict == "No diagnosis of this model on this campaign was computed."
    assert "clampid diagnose" in screen.open[0]


def test_the_picture_falls_from_left_to_right_within_its_frame() -> None:
    fall = first_screen(a_model("gear_eccentricity@joint2"), None, {}, None).fall
    assert fall is not None
    places = [step.at for step in fall.steps]
    assert places == sorted(places, reverse=True)
    assert all(0 <= at <= 1 for at in (*places, fall.floor[1], *(at for _, at in fall.ticks)))
    assert fall.floor[1] < places[-1]
    assert [step.label for step in fall.steps] == ["start model", "+ gear eccentricity, joint 2"]


def test_the_first_screen_needs_no_script_and_comes_before_any(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    screen = first_screen(a_model("gear_eccentricity@joint2"), None, {}, found("missing", GEAR))
    text = render("UR10", "arm", screen, [])
    head = text[: text.index("<script")]
    for words in (
        screen.verdict,
        "53.0 µm",
        "noise floor 47.0 µm",
        "gear eccentricity at joint 2 (poses)",
        "1 January 1970",
    ):
        assert words in head
    assert "<svg" in head
    assert isinstance(screen, FirstScreen)
    assert not re.search(r"\son[a-z]+=", head)


def test_what_is_ambiguous_says_how_to_plan_what_separates_it() -> None:
    one, other = ({**GEAR, "effect": e, "name": e, "alternative": True} for e in ("bearing_tilt", "link_bending"))
    plan = {"for": "parting", "helps": True, "sigma_before": 2.0, "sigma_after": 5.8, "count": 20}
    data = found("ambiguous", one, other, next_measurement="20 poses", next_plan=plan)
    lines = first_screen(a_model(held_out=(1.07e-4,)), None, {}, data).open
    assert lines[-1] == "To plan that measurement: clampid diagnose MODEL CAMPAIGN --plan next.toml"
    assert "The closest two differ by 2.0 σ; 20 proposed poses raise this to 5.8 σ." in lines


def test_no_plan_is_offered_where_no_poses_help() -> None:
    """A plan was offered below the sentence that no poses distinguish the effects."""
    one, other = ({**GEAR, "effect": e, "name": e, "alternative": True} for e in ("bearing_tilt", "link_bending"))
    plan = {"for": "parting", "helps": False, "sigma_before": 1.9, "sigma_after": 1.9, "count": 20}
    data = found("ambiguous", one, other, next_measurement="no poses", next_plan=plan)
    lines = first_screen(a_model(held_out=(1.07e-4,)), None, {}, data).open
    assert any("No poses that this robot can take" in line for line in lines)
    assert not any("--plan" in line for line in lines)
