"""The verbs of an unknown effect as they are typed, and the section of the report that shows its shape."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from clampid.charts import Band, Line
from clampid.cli import run
from clampid.report.limits import exported
from clampid.report.style import Figure
from clampid.report.unknown_shape import unknown_shape_section


def typed(text: str) -> int:
    return run(text.split())


def test_new_writes_a_file_and_says_how_to_use_it(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert typed("effect new snag --depends-on q4,dir4 --at joint4") == 0
    said = capsys.readouterr().out
    assert "Wrote snag.py" in said
    assert "--effects-from snag.py" in said
    assert typed("effects --effects-from snag.py --quiet --json -") == 0
    (own,) = (e for e in json.loads(capsys.readouterr().out) if e["name"] == "snag")
    assert own["equation"] == "dq_4 = sum_k c_k f_k(q4, dir4)"
    assert own["family"] == "snag"
    assert {p["unit"] for p in own["parameters"]} == {"rad"}


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        ("effect new snag --depends-on q4,,dir4 --at joint4", "variable '' is not known in poses; known: q1, q2, …"),
        ("effect new snag --depends-on qq4 --at joint4", "variable 'qq4' is not known in poses; known: q1, q2, …"),
        ("effect new snag --depends-on q4 --at knee", "nothing acts at 'knee' in poses; known: joint1, joint2, …"),
        ("effect new snag --depends-on q4 --at joint4 --stage air", "stage 'air' is not known; known: free_air"),
        ("effect new geometry --depends-on q4 --at joint4", "the catalogue has an effect of that name"),
        ("effect new ../snag --depends-on q4 --at joint4", "'../snag': expected a name"),
        ("effect new snag --depends-on q4 --at joint4 --orders 99", "orders: expected 1 to 12, found 99"),
        ("effect new snag --depends-on q4 --at joint4 -o .", "expected a file to write to, found a folder"),
        ("effect new snag --at joint4", "Missing option '--depends-on'"),
        ("undo nothing.json arm -o back.json", "nothing.json: expected a model file, found none"),
    ],
)
def test_wrong_calls_are_refused_in_one_line(call: str, complaint: str, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert typed(call) == 2
    said = capsys.readouterr().err.strip()
    assert complaint in said
    assert len(said.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_new_does_not_overwrite(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "snag.py").write_text("mine")
    assert typed("effect new snag --depends-on q4 --at joint4") == 2
    assert "snag.py: expected a file that does not exist yet, found one" in capsys.readouterr().err
    assert (tmp_path / "snag.py").read_text() == "mine"


def curve(axis: str, unit: str, given: dict[str, float]) -> dict:
    x = np.linspace(-2.0, 2.0, 5)
    return {
        "variable": "q4", "variable_unit": "rad", "given": given, "axis": axis, "unit": unit, "x": x.tolist(),
        "value": (1e-4 * x).tolist(), "low": (1e-4 * x - 2e-5).tolist(), "high": (1e-4 * x + 2e-5).tolist(),
    }  # fmt: skip


def shape(at: str, curves: list[dict]) -> dict:
    part = {"at": at, "depends_on": ["q4", "dir4"], "share": 0.5, "curves": curves, "command": "clampid effect new a"}
    return {"stages": {"poses": {"verdict": "unknown", "shape": part}}}


def test_the_report_draws_the_shape_in_units_for_people():
    found = shape("joint5", [curve("dq", "rad", {"dir4": -1.0}), curve("dq", "rad", {"dir4": 1.0})])
    section = unknown_shape_section(found)
    (figure,) = (block for block in section.blocks if isinstance(block, Figure))
    (panel,) = figure.plot.panels
    lines = [mark for mark in panel.marks if isinstance(mark, Line)]
    assert [line.name for line in lines] == ["dir4 = −1", "dir4 = +1"]
    np.testing.assert_allclose(lines[0].x[0], np.degrees(-2.0))
    np.testing.assert_allclose(lines[0].y[0], -200.0)  # µrad
    band = next(mark for mark in panel.marks if isinstance(mark, Band))
    assert max(band.high) == pytest.approx(220.0)
    assert "simultaneous" in figure.caption
    assert any("clampid effect new a" in note for note in section.notes)


def test_a_place_of_several_numbers_gets_a_panel_each():
    curves = [curve(axis, "m", {}) for axis in "xyz"]
    (figure,) = (b for b in unknown_shape_section(shape("instrument", curves)).blocks if isinstance(b, Figure))
    # One title a panel, and one of the axis that the panels share.
    assert [panel.title for panel in figure.plot.panels] == ["x, µm", "y, µm", "z, µm"]
    assert figure.plot.below == "q4, degrees"


def test_no_section_without_a_shape():
    assert unknown_shape_section(None) is None
    assert unknown_shape_section({"stages": {"poses": {"verdict": "adequate", "shape": None}}}) is None


def test_the_shift_of_the_exported_table_is_a_table_with_units():
    shift = {"row": "3", "parameter": "d", "shift": 4.5e-5, "std": 3e-6, "unit": "m", "at_flange_m": 4.5e-5}
    (table,) = exported([shift])
    assert table.rows == (("3", "d", "45.0 ± 3.0 µm", "45.0 µm"),)
    assert exported([]) == []
