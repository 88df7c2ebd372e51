"""What verbs print for people, from the dictionaries and values that programs get."""

from __future__ import annotations

import pytest

from clampid.model import Round
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
    assert lines["2"].split()[-1] == "0.005"
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
