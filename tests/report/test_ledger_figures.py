"""One held-out error for one step, and one name for what is in the model, wherever a report says it."""

from __future__ import annotations

from typing import Any

from clampid.catalogue import catalogue
from clampid.diagnosis.headline import as_added, headline
from clampid.models.model import Model, Round
from clampid.report.ledger_figures import with_ledger_figures
from clampid.slots import Layout, parse_term

CURVES = [f"joint_angle_curve@joint{k}" for k in range(1, 7)]


def candidate(name: str, where: list[str], before: float, after: float, **more: Any) -> dict[str, Any]:
    errors = {"heldout_rms_before": before, "heldout_rms_after": after}
    return {"effect": name, "name": name, "where": where, "alternative": False, **errors, **more}


def added(labels: list[str], before: float, after: float) -> Round:
    return Round(
        "poses", (), tuple(labels), after, after, 1e-5, {"heldout_rms_before": before, "heldout_rms_after": after}
    )


def ledger(*rounds: Round) -> Model:
    return Model("robot", Layout(6), {"poses": None}, (), (Round("poses", (), (), 1e-3, 1e-3, 1e-5), *rounds))  # type: ignore[dict-item]


def diagnosis(*candidates: dict[str, Any]) -> dict[str, Any]:
    ends = {"heldout_rms_before": 348e-6, "heldout_rms_after": 101.9e-6}
    return {"stages": {"poses": {"verdict": "missing", "unit": "m", "candidates": list(candidates), **ends}}}


def test_a_step_that_the_model_took_has_the_errors_of_its_ledger() -> None:
    """On the UR10 the verdict said 110 µm of the step of which the ladder said 112 µm."""
    found = diagnosis(
        candidate("joint_angle_curve", [f"joint{k}" for k in range(1, 7)], 348e-6, 109.8e-6),
        candidate("gravity", [], 109.8e-6, 101.9e-6),
    )
    model = ledger(added(CURVES, 347.9e-6, 111.8e-6), added(["gravity"], 111.8e-6, 102.1e-6))
    one = with_ledger_figures(found, model, None)
    assert one is not None
    part = one["stages"]["poses"]
    errors = [(c["heldout_rms_before"], c["heldout_rms_after"]) for c in part["candidates"]]
    assert errors == [(347.9e-6, 111.8e-6), (111.8e-6, 102.1e-6)]
    assert (part["heldout_rms_before"], part["heldout_rms_after"]) == (347.9e-6, 102.1e-6)
    assert found["stages"]["poses"]["candidates"][0]["heldout_rms_after"] == 109.8e-6  # what was given stays as it was


def test_how_far_the_error_is_from_the_floor_is_said_of_this_model() -> None:
    """5.9 noise floors stood below 93.7 and 17.3 µm, a ratio of 5.4: the shared curve came after the diagnosis."""
    found = diagnosis(candidate("gravity", [], 348e-6, 101.9e-6))
    found["stages"]["poses"]["above_floor"] = {"times_floor": 5.9, "reasons": ["noise: why"]}
    model = ledger(added(["gravity"], 348e-6, 102e-6), added(["shared_angle_curve@joint1"], 102e-6, 93.7e-6))
    one = with_ledger_figures(found, model, None)
    assert one is not None
    assert one["stages"]["poses"]["above_floor"] == {"times_floor": 93.7e-6 / 1e-5, "reasons": ["noise: why"]}


def test_a_candidate_that_the_model_does_not_have_keeps_its_own_errors() -> None:
    found = diagnosis(candidate("backlash", ["joint2"], 2e-4, 1e-4))
    for model in (ledger(), ledger(added(["backlash@joint3"], 3e-4, 2e-4))):
        assert with_ledger_figures(found, model, None) == found
    assert with_ledger_figures(None, ledger(), None) is None


def test_the_verdict_on_a_mended_model_names_what_is_in_it() -> None:
    """The UR10's verdict said joints 1–6 beside a list with joint 6: one curve had taken the place of five."""
    six = candidate("joint_angle_curve", [f"joint{k}" for k in range(1, 7)], 348e-6, 110e-6)
    stages = diagnosis(six)["stages"]
    shared = [f"shared_angle_curve@joint{k}" for k in range(1, 6)]
    now = as_added(stages, {"poses": ["joint_angle_curve@joint6", *shared]})
    text = headline(now, mended=True)
    assert "Joint angle curve at joint 6 and shared angle curve at joints 1–5 were missing" in text
    assert as_added(stages, {}) == stages
    assert "joints 1–6" in headline(as_added(stages, {"poses": CURVES}), mended=True)


def test_alternatives_are_kept_beside_what_was_added() -> None:
    other = candidate("link_bending", ["link1"], 3e-4, 2e-4) | {"alternative": True}
    stages = diagnosis(candidate("gravity", [], 3e-4, 2e-4), other)["stages"]
    now = as_added(stages, {"poses": ["gravity"]})["poses"]["candidates"]
    assert [(c["name"], c["alternative"]) for c in now] == [("gravity", False), ("link_bending", True)]


def test_labels_of_the_ledger_are_terms() -> None:
    """The comparison of candidates with rounds rests on it."""
    assert [parse_term(label, catalogue(), Layout(6)).label for label in [*CURVES, "gravity"]] == [*CURVES, "gravity"]
