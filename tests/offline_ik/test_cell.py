"""Cell files: what they say, what they may not say, and what is assumed where they say nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ik_arms import CELL

from kinematics.description import load_robot
from offline_ik.cell import default_cell, read_cell
from offline_ik.errors import CellError

ROBOT = load_robot("kuka_kr20_r1810")


def written(folder: Path, text: str) -> Path:
    path = folder / "cell.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_cell_is_read(tmp_path: Path) -> None:
    cell = read_cell(written(tmp_path, CELL), ROBOT)
    assert cell.convention.sample == (1.4, 0.0, 0.0)
    assert np.allclose(cell.mount[:3, 3], [0, 0, 0.12])
    assert cell.obstacles[0].name == "sample stage"
    assert cell.assumed == ()


def test_what_nobody_said_is_listed() -> None:
    assert "sample" in default_cell(ROBOT).assumed
    assert "no obstacles" in default_cell(ROBOT).to_json()["assumed"]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('robot = "kuka_kr20_r1810"', 'robot = "ur10"', "the model is of 'kuka_kr20_r1810', the cell of 'ur10'"),
        ("clampid-cell/1", "clampid-cell/9", "format"),
        ("mass_kg", "mass_lb", "'mass_lb' is not known; expected mass_kg"),
        ('shape = "box"', 'shape = "cone"', "expected a shape of box"),
        ("size_m = [0.3, 0.3, 0.6]", "size_m = [0.3, 0.3]", "expected 3 finite numbers"),
        ("size_m = [0.3, 0.3, 0.6]", "size_m = [0.3, -0.3, 0.6]", "positive sizes"),
        ("sample_m = [1.4, 0.0, 0.0]", "sample_m = [1.4, nan, 0.0]", "three finite numbers"),
        ('name = "thesis"', 'name = "essay"', "no convention is called 'essay'"),
        ("mass_kg = 12.0", "mass_kg = -1", "at least 0"),
        ("link_C = [28.0,", "link_C = [", "expected 6 finite numbers"),
        ("[tool]", "[tool", "as TOML"),
        ('shape = "box"\nsize_m = [0.3, 0.3, 0.6]', 'shape = "mesh"\nfile = "none.stl"', "expected a mesh at"),
    ],
)
def test_a_wrong_cell_is_refused_by_its_file_and_key(tmp_path: Path, old: str, new: str, says: str) -> None:
    assert old in CELL
    path = written(tmp_path, CELL.replace(old, new))
    with pytest.raises(CellError) as caught:
        read_cell(path, ROBOT)
    assert says in str(caught.value)
    assert str(path) in str(caught.value)


def test_no_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(CellError, match="found none"):
        read_cell(tmp_path / "none.toml", ROBOT)
