"""Negative numbers for people have minus signs; commands to copy and words with hyphens stay as they are."""

from __future__ import annotations

import pytest

from clampid.display import fixed, number, quantity, ranged, true_minus, with_error, with_std
from clampid.display import scale_for as scale
from clampid.report.first_screen import FirstScreen
from clampid.report.page import render
from clampid.report.style import Section, Table
from clampid.screen import Next, Screen, laid_out
from clampid.text_table import table_lines


def test_numbers_for_people_have_minus_signs() -> None:
    assert with_error(-165.8e-6, 2.0e-6, "rad") == "−165.8 ± 2.0 µrad"
    assert with_std(-165.8e-6, 0.0, scale("rad", [-165.8e-6])) == "−165.8 µrad"
    assert quantity(-0.0012, 0.0001, "m")[0] == "−1.20"
    assert (fixed(-1.25, 2), fixed(-0.001, 1), number(-9.81), number(-1.5e-9)) == (
        "−1.25",
        "0.0",
        "−9.81",
        "−1.50·10⁻⁹",
    )
    assert ranged(-0.5, "m") == "−500.0 mm"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a2 = -165.8 µrad at (0, -9.81)", "a2 = −165.8 µrad at (0, −9.81)"),
        ("-.5 to -3 and 1-3 of 2026-11-27", "−.5 to −3 and 1-3 of 2026-11-27"),
        ("type clampid ik --gamma -0.3 --delta=-0.1", "type clampid ik --gamma -0.3 --delta=-0.1"),
        ("found '-3' in run-2.csv, 1e-05, sign-flip", "found '-3' in run-2.csv, 1e-05, sign-flip"),
    ],
)
def test_only_signs_of_numbers_become_minus_signs(text: str, shown: str) -> None:
    assert true_minus(text) == shown


def test_screens_have_minus_signs_but_in_commands() -> None:
    screen = Screen("Moved by -3 mm.", facts=(("x", "-1.0 m"),), notes=("at -2 degC",), next=(Next("Next:", "go -1"),))
    lines = [line.text for line in laid_out(screen)]
    assert [line for line in lines if "−" in line] == ["Moved by −3 mm.", "  x  −1.0 m", "- at −2 degC"]
    assert lines[-1] == "  go -1"
    assert table_lines(["joint", "q"], [["1", "-0.25"]], 1, 80)[-1].endswith("−0.25")


def test_reports_have_minus_signs_in_sentences_and_all_columns() -> None:
    table = Table(("Target", "Place#"), (("tool (-20.0, 0, 151) mm", "-3.5"),), "a of row 2, -0.773 mm")
    first = FirstScreen("today", (), "", None, "by -3 µm", True, ("a2 = -165.8",), ())
    text = render("Arm", "campaign-1", first, [Section("dh", "DH", ("s = -1",), (table,))])
    for shown in ("(−20.0, 0, 151)", ">−3.5<", "−0.773 mm", "by −3 µm", "a2 = −165.8", "s = −1", "campaign-1"):
        assert shown in text
