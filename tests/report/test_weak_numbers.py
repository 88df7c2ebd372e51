"""What a number in the report may be taken for: not determined, not told from zero, hidden beside found."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
from virtual_arms import arm

from clampid.catalogue import catalogue
from clampid.report.dh_section import _cell as dh_cell
from clampid.report.parameters import _cell, _groups, _pivot, _scale
from clampid.report.style import Table, Weak
from clampid.report.truth import truth_and_found
from clampid.slots import Slot
from kinematics.description import load_robot

ROBOT = load_robot("kuka_kr20_r1810")


def stage(*found: tuple[Slot, float, float]) -> Any:
    slots, theta, std = zip(*found, strict=True)
    return SimpleNamespace(
        slots=slots, theta=np.array(theta), std=np.array(std), identified=np.ones(len(slots), dtype=bool)
    )


def test_a_dh_table_prints_by_the_error_and_says_what_is_open():
    row = {"d_m": 0.52, "std_d_m": 3.4e-6, "theta_offset_rad": math.radians(-32.91139), "a_m": 0.16}
    row |= {"std_theta_offset_rad": math.radians(0.22), "std_a_m": math.nan}
    assert dh_cell(row, "d_m") == "520.0000 ± 0.0034"
    assert dh_cell(row, "theta_offset_rad") == "−32.91 ± 0.22"
    assert dh_cell(row, "a_m") == "160"
    assert dh_cell({"d_m": 555.29, "std_d_m": 2.9}, "d_m") == "not determined"
    assert dh_cell({"d_m": 0.4, "std_d_m": 0.5}, "d_m") == "not determined"
    assert dh_cell({"d_m": math.nan}, "d_m") == ""


def test_what_does_not_differ_from_zero_is_weak_and_a_friction_below_zero_is_named():
    effects = catalogue()
    F = [Slot("wrist_coupling_friction", "F", f"joint{j}") for j in (4, 5, 6)]
    c = Slot("joint_compliance", "c", "joint4")
    found = stage((F[0], -0.8, 2.6), (F[1], 7.03, 0.04), (F[2], 1.1, 1.3), (c, 0.4, 0.001))
    cells = [_cell(found, effects, ROBOT, k, _scale(found, effects, ROBOT, [k])) for k in range(4)]
    assert cells == ["−0.8 ± 2.6 (below zero)", "7.030 ± 0.040", "1.1 ± 1.3", "400.0 ± 1.0"]  # the last beyond a bound
    assert [isinstance(cell, Weak) for cell in cells] == [True, False, True, False]


def test_joints_that_slide_have_tables_of_their_own():
    robot = arm("scara")
    slots = [Slot("joint_compliance", "c", f"joint{j}") for j in (2, 3, 4)]
    found = stage((slots[0], 4e-6, 1e-7), (slots[1], 2e-6, 1e-7), (slots[2], 6e-6, 1e-7))
    turns, slides = _groups(found, catalogue(), robot)
    assert (turns, slides) == ([0, 2], [1])
    heads = [_pivot(found, catalogue(), robot, group).columns for group in (turns, slides)]
    assert [head[1] for head in heads] == ["c, µrad/Nm#", "c, µm/N#"]


def test_what_was_hidden_stands_beside_what_was_found_in_one_unit():
    slots = [Slot("gear_eccentricity", name, "joint1") for name in ("a1", "b1")]
    model: Any = SimpleNamespace(stages={"poses": stage((slots[0], 1.623e-4, 2.2e-6), (slots[1], 2.302e-4, 2.7e-6))})
    hidden = {
        "effect": "gear_eccentricity",
        "where": "joint1",
        "parameters": {"sin_q_rad": 1.639e-4, "cos_q_rad": 2.294e-4},
    }
    section = truth_and_found([hidden], model, catalogue(), ROBOT)
    assert section is not None
    (table,) = section.blocks
    assert isinstance(table, Table)
    assert [(row[2], row[3], row[5]) for row in table.rows] == [
        ("164 µrad", "sin q", "162.3 ± 2.2 µrad"),
        ("229 µrad", "cos q", "230.2 ± 2.7 µrad"),
    ]
    assert table.rows[0][4].startswith("a1, sine part")
    missed = truth_and_found([{**hidden, "where": "joint2"}], model, catalogue(), ROBOT)
    assert missed is not None
    assert isinstance(missed.blocks[0], Table)
    assert missed.blocks[0].rows[0][4] == "not in the model"
    nothing = truth_and_found([], model, catalogue(), ROBOT)
    assert nothing is not None
    assert "Nothing." in nothing.paragraphs
    assert truth_and_found(None, model, catalogue(), ROBOT) is None
