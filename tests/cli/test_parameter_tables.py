"""Parameters as tables: an effect each, joints as columns, one unit a row, and no value that the data do not hold."""

from __future__ import annotations

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.display import compact, scale_for
from clampid.models.model import StageModel
from clampid.slots import Slot, Term
from clampid.verbs.findings import show_diagnosis
from clampid.verbs.output import Output
from clampid.verbs.parameter_tables import show_parameters
from kinematics.description import load_robot

Capture = pytest.CaptureFixture[str]


@pytest.mark.parametrize(
    ("value", "std", "unit", "text"),
    [
        (242.1e-6, 9.4e-6, "m", "242(9)"),
        (1.0855e-3, 6.2e-6, "m", "1.086(6)"),
        (-130e-6, 17e-6, "m", "−130(17)"),
        (1.0461, 0.0077, "Nm", "1.046(8)"),
        (0.0, 1.7, "kg m", "0.0(17)"),
        (1234.0, 56.0, "Nm", "1230(60)"),
        (5.0, float("nan"), "kg", "5.000"),
        (5.0, 0.0, "kg", "5.000"),
    ],
)
def test_a_value_with_the_error_of_its_last_digits(value: float, std: float, unit: str, text: str) -> None:
    assert compact(value, std, scale_for(unit, [value])) == text


def a_stage(effect: str, parameter: str, values: list[float], known: list[bool]) -> StageModel:
    slots = tuple(Slot(effect, parameter, f"joint{j}") for j in range(1, len(values) + 1))
    covariance = np.diag([1e-12 if k else 1e30 for k in known])
    return StageModel("poses", (Term(effect),), slots, np.array(values), covariance, tuple(known))


def test_joints_are_columns_and_what_is_not_identifiable_has_no_value(capsys: Capture) -> None:
    stage = a_stage(
        "backlash", "gap", [2.031e-4, 3.09e-4, 1.9e15, 1e-4, 2e-4, -7e14], [True, True, False, True, True, False]
    )
    show_parameters("poses", stage, catalogue(), load_robot("ur10"), Output())
    out = capsys.readouterr().out
    (row,) = [line for line in out.splitlines() if line.startswith("gap")]
    assert row.split() == ["gap", "[µrad]", "203.1(10)", "309.0(10)", "·", "100.0(10)", "200.0(10)", "·"]
    assert "backlash: not identifiable: gap at joints 3, 6" in out
    assert "e+1" not in out
    assert "·10" not in out
    assert max(map(len, out.splitlines())) <= 80


def test_a_curve_is_reported_by_its_size_and_not_by_its_harmonics(capsys: Capture) -> None:
    effect = catalogue()["joint_angle_curve"]
    names = [p.name for p in effect.parameters if p.per == "joint"]
    slots = tuple(Slot(effect.name, name, "joint1") for name in names)
    count = len(slots)
    stage = StageModel("poses", (Term(effect.name),), slots, np.full(count, 0.1), np.eye(count) * 1e-4, (True,) * count)
    show_parameters("poses", stage, catalogue(), load_robot("ur10"), Output())
    out = capsys.readouterr().out
    assert "root sum of squares" in out
    assert len(out.splitlines()) < 10


def test_nothing_is_printed_without_verbose(capsys: Capture) -> None:
    stage = a_stage("backlash", "gap", [1e-4], [True])
    show_parameters("poses", stage, catalogue(), load_robot("ur10"), Output(verbose=False))
    assert capsys.readouterr().out == ""


def test_a_diagnosis_prints_no_value_that_the_data_do_not_determine(capsys: Capture) -> None:
    wild = {"name": "gravity.my@link2", "value": 2.6e15, "std": 2e15, "unit": "kg m", "identified": False}
    held = {"name": "joint_angle_curve.rms@robot", "value": 3e-4, "std": 3e-13, "unit": "rad", "identified": True}
    candidate = {"effect": "gravity", "where": ["link2"], "alternative": False, "parameters": [wild, held]}
    part = {"verdict": "missing", "unit": "m", "summary": "", "candidates": [candidate]}
    show_diagnosis({"stages": {"poses": part}}, Output())
    out = capsys.readouterr().out
    assert "not identifiable: gravity.my@link2" in out
    assert "00000" not in out
    assert "10¹⁵" not in out
    assert "300 µrad (fixed)" in out
