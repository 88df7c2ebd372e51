"""What verbs print for people, from the dictionaries and values that programs get."""

from __future__ import annotations

from typing import Any

import pytest

from clampid.diagnosis.limits import limit_rows, not_testable
from clampid.display import span
from clampid.models.model import Round
from clampid.verbs.findings import show_diagnosis
from clampid.verbs.output import Output
from clampid.verbs.show import show_rounds, terms_text

Capture = pytest.CaptureFixture[str]


def a_round(*added: str, **evidence: object) -> Round:
    return Round("poses", ("geometry", *added), added, 1.1e-4, 1.2e-4, 1e-4, evidence)


def test_history_says_p_of_the_family_and_what_is_confusable(capsys: Capture) -> None:
    alike = [
        {"effect": "link_bending", "where": ["link1"], "cos2": 0.9899, "aliased": False},
        {"effect": "link_bending", "where": ["link2"], "cos2": 0.93, "aliased": False},
        {"effect": "nonlinear_stiffness", "where": ["joint1", "joint2"], "cos2": 0.99999, "aliased": True},
    ]
    refused = {"name": "base_tilt", "where": ["base"], "heldout_rms_after": 1e-4, "reason": "the error does not fall"}
    passed_over = {"name": "dress_pack", "where": ["joint3"], "reason": "explains 7 % as much"}
    step = a_round("joint_compliance@joint2", "joint_compliance@joint3", p_familywise=0.005, confusable_with=alike)
    show_rounds([a_round(), step, a_round("backlash@joint1", rejected=[refused, passed_over])], Output())
    table, _, notes = capsys.readouterr().out.partition("\nround ")
    assert "p family" in table
    lines = {line.split()[0]: line for line in table.splitlines() if line.strip()[:1].isdigit()}
    assert lines["1"].split()[-1] == lines["3"].split()[-1] == "–"
    assert lines["2"].split()[-1] == "0.0050"
    assert "+ joint_compliance at joints 2, 3 " in lines["2"]
    assert max(map(len, lines.values())) <= 100
    assert notes.splitlines() == [
        "2: confusable with link_bending@link1 (0.99), nonlinear_stiffness at joints 1, 2 (1); in brackets cos²",
        "round 3: refused: base_tilt@base: the error does not fall",
    ]


def test_history_of_effects_that_were_given_has_no_column_for_what_is_not_known(capsys: Capture) -> None:
    show_rounds([a_round(), a_round("backlash@joint1")], Output())
    out = capsys.readouterr().out
    assert "p family" not in out
    assert "+ backlash@joint1" in out


def test_terms_of_several_places() -> None:
    assert terms_text(["geometry", "backlash@joint1", "base_tilt@base"]) == "geometry, backlash@joint1, base_tilt@base"
    assert terms_text(["a@link2", "b@joint1", "a@link3"]) == "a at links 2, 3, b@joint1"
    assert terms_text(["a@link2", "a@base"]) == "a at link2, base"
    assert terms_text([f"a@joint{j}" for j in (6, 1, 3, 4, 5)]) == "a at joints 1, 3–6"


def limits(name: str, state: str, *limits: tuple[str, float | None], size: float = 1e-4) -> dict[str, Any]:
    """What a candidate's testability is in the JSON of ``diagnose``."""
    listed = [{"name": f"{name}.{at}", "limit": value, "unit": "rad", "size": size} for at, value in limits]
    return {"effect": name, "name": name, "where": [], "state": state, "retained": 0.5, "limits": listed}


TESTED = (
    limits("backlash", "testable", ("gap@joint1", 2e-5), ("gap@joint2", 4e-4)),
    limits("backlash", "testable", ("gap@joint1", 1e-5)),
    limits("backlash", "insensitive", ("gap@joint3", None)),
    limits("backlash", "absorbed", ("gap@joint4", None)),
    limits("gear_eccentricity", "testable", ("a1@joint1", 3e-5), ("b1@joint1", None), size=1e-3),
    limits("gear_eccentricity", "weak", ("a1@joint2", 1e-9), ("b1@joint2", 1e-9)),
    limits("base_tilt", "testable", ("cxx@base", None), ("cxy@base", 1e-3), size=1e-6),
    limits("payload", "absent", ("m@tool", None)),
    limits("joint_angle_curve", "absent"),
)


def test_limits_come_by_effect_the_best_seen_first() -> None:
    assert limit_rows(TESTED) == [
        ("gear_eccentricity.a1", "joint1", "30 µrad"),
        ("backlash.gap", "joints 1, 2", "10 – 400 µrad"),
        ("base_tilt.cxy", "base", "1000 µrad"),
    ]


def test_what_cannot_be_tested_is_named_with_the_reason() -> None:
    assert not_testable(TESTED) == {
        "has no influence on these rows": ["payload", "joint_angle_curve"],
        "absorbed by the model": ["backlash@joint4"],
        "nearly all of it absorbed by the model": ["gear_eccentricity@joint2"],
        "only an implausible size would be found": ["backlash@joint3"],
    }


def test_a_diagnosis_lists_the_limits_that_it_speaks_of(capsys: Capture) -> None:
    many = [limits(f"effect{k}", "testable", ("p@joint1", 1e-5 * (12 - k))) for k in range(12)]
    part = {"verdict": "adequate", "unit": "m", "summary": "above the listed limits", "candidates": []}
    show_diagnosis({"stages": {"poses": {**part, "testability": [*many, *TESTED]}}}, Output())
    out = capsys.readouterr().out
    assert "of 15, all in --json" in out
    rows = [line.split()[0] for line in out.splitlines() if "µrad" in line]
    assert rows == ["gear_eccentricity.a1", "backlash.gap", *(f"effect{k}.p" for k in range(11, 5, -1))]
    assert "not testable here: payload, joint_angle_curve (has no influence on these rows); backlash@joint4" in out
    show_diagnosis({"stages": {"poses": part}}, Output())
    assert "testable" not in capsys.readouterr().out


def test_a_span_has_one_unit() -> None:
    assert span(1.5e-5, 1.2e-4, "m") == "15 – 120 µm"
    assert span(3.4e-6, 2.6e-5, "") == "3.4 – 26 ppm"
    assert span(0.0123, 0.0861, "") == "0.012 – 0.086"
    assert span(4.4e-12, 4.6e-11, "rad/Nm^3") == "0.0044 – 0.046 nrad/Nm³"
    assert span(0.05, 0.05, "Nm") == "0.050 Nm"
