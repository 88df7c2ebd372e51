"""The table for readers: the thesis' order, signs and units; read back from what is printed."""

from __future__ import annotations

import csv
from collections.abc import Callable
from importlib import resources

import numpy as np
import pytest

from clampid.exports.dh_export import dh_export, postures, read_dh
from clampid.exports.dh_layout import thesis_layout
from clampid.models.model import Model
from kinematics.description import load_robot
from kinematics.dh import Convention, DHRow, DHTable, forward
from kinematics.fixed_angles import rotation_of
from kinematics.screws import transform

Make = Callable[..., Model]
ROBOT = "kuka_kr20_r1810"


def cells(text: str) -> list[list[str]]:
    return [[c.strip() for c in line.strip("|").split(" | ")] for line in text.splitlines() if line.startswith("| ")]


def number(cell: str) -> float:
    return float(cell.partition(" ± ")[0].replace("−", "-").replace(" ", ""))


def table_of(text: str, convention: Convention) -> DHTable:
    """Give the compensated table from what is printed, its rounded digits included."""
    rows, ends = [], []
    for cell in cells(text):
        if cell[1] == "compensated":
            theta, offset = cell[2].split(f"θ{len(rows) + 1}")
            d, a, alpha, *beta = map(number, cell[3:])
            rows.append(DHRow(-1 if theta else 1, number(offset) if offset else 0.0, d, a, alpha, *beta))
        elif cell[0] in ("base", "tool"):
            values = np.array(list(map(number, cell[1:])))
            ends.append(transform(rotation_of(values[3:]), values[:3]))
    return DHTable(tuple(rows), ends[0], ends[1], convention)


@pytest.mark.parametrize("convention", ["hayati", "standard"])
def test_the_printed_digits_are_the_table(convention: Convention, make_model: Make) -> None:
    found = dh_export(make_model(ROBOT), convention, fit="static")
    robot = load_robot(ROBOT)
    text = thesis_layout(found, robot)
    q = postures(robot, seed=7)
    off = np.abs(forward(table_of(text, convention), q) - forward(read_dh(found.text), q)).max()
    told = float(text.partition("differ by at most ")[2].split()[0])
    assert 0 < told <= 1e-6
    assert off < 2 * told  # other postures than those it was measured at
    for line in found.said:
        assert line[1:] in text


def test_nominal_rows_are_the_thesis_consistent_ones(make_model: Make) -> None:
    """The appendix's table, its two corrected rows included, in its own order and notation."""
    found = dh_export(make_model(ROBOT, size=1e-4), "standard", fit="static")
    printed = cells(thesis_layout(found, load_robot(ROBOT)))
    assert printed[0] == ["link", "", "θ [rad]", "d [m]", "a [m]", "α [rad]"]
    source = resources.files("appendix_data").joinpath("dh_nominal_consistent.csv").read_text(encoding="utf-8")
    for row, cell in zip(csv.reader(source.splitlines()[1:]), [c for c in printed if c[1] == "nominal"], strict=True):
        link, theta, d, a, alpha = row
        angles = [v.replace("−", "-").replace(" ", "").replace("θ", "theta").replace("π", "pi") for v in cell[2:]]
        assert (cell[0], angles[0], angles[3]) == (link, theta, alpha)
        assert (number(cell[3]), number(cell[4])) == (float(d), float(a))


def test_standard_errors_stand_beside_what_was_identified(make_model: Make) -> None:
    found = dh_export(make_model(ROBOT, std=2e-5), "hayati", fit="static")
    rows = [c for c in cells(thesis_layout(found, load_robot(ROBOT))) if c[1] == "compensated"]
    std = float(found.table["std_a_m"].iloc[1])
    assert float(rows[1][4].partition(" ± ")[2]) == pytest.approx(std, rel=0.05)
    assert "±" not in rows[1][3]  # d of a Hayati row is zero by convention
    assert number(rows[1][3]) == 0.0
    assert {len(row) for row in rows} == {7}  # with beta


def test_signs_are_typographic_and_zero_has_none(make_model: Make) -> None:
    text = thesis_layout(dh_export(make_model(ROBOT, size=0.0), "hayati", fit="static"), load_robot(ROBOT))
    assert "-0.0" not in text
    assert "−0.0000000 " not in text
    assert all(c[2].startswith("θ") or c[2].startswith("−θ") for c in cells(text) if c[1] == "nominal")
