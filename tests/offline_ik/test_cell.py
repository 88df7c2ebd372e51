"""Cell files: what they say, what they may not say, and what is assumed where they say nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ik_arms import CELL

from kinematics.description import load_robot
from offline_ik.cell import default_cell, read_cell
from offline_ik.detector import open_detector
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
    assert cell.assumed == (
        "link radii from the arm's reach", "base radius from the arm's reach", "clearance of 20 mm",
        "speed of 0.3 of the greatest",
    )  # fmt: skip


def test_a_cell_that_says_everything_leaves_nothing_to_assume(tmp_path: Path) -> None:
    shape = "[robot_shape]\nradius_m = [0.2, 0.1, 0.1, 0.1, 0.1, 0.1]\nbase_radius_m = 0.2\n"
    more = CELL + shape + "[safety]\nclearance_m = 0.02\nspeed = 0.3\n"
    assert read_cell(written(tmp_path, more), ROBOT).assumed == ()


def test_a_description_without_gears_or_speeds_is_said() -> None:
    assert not any("gears" in what or "speed is" in what for what in default_cell(ROBOT).assumed)
    assumed = default_cell(load_robot("kuka_kr30_3")).assumed
    assert "motors turn as joints do (no gears are described)" in assumed
    assert "joints of 180 deg/s where no greatest speed is described" in assumed
    assert "motors turn as joints do (no gears are described)" in default_cell(load_robot("ur10")).assumed


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
        ("sample_m = [1.4, 0.0, 0.0]", "sample_m = [1.4, nan, 0.0]", "convention.sample_m: expected 3 finite numbers"),
        ('name = "thesis"', 'name = "essay"', "no convention is called 'essay'"),
        ("mass_kg = 12.0", "mass_kg = -1", "at least 0"),
        ("link_C = [28.0,", "link_C = [", "expected 6 finite numbers"),
        ("[tool]", "[tool", "as TOML"),
        ("sample_m = [1.4, 0.0, 0.0]", "sample_m = [1400, 0, 0]", "convention.sample_m: expected metres of at most 10"),
        ('name = "thesis"', 'name = ["thesis"]', "convention.name: expected a text, found ['thesis']"),
        ("position_m = [0.0, 0.0, 0.12]", "position_m = [0, 0, 120]", "detector.position_m: expected metres of at"),
        ("size_m = [0.2, 0.2, 0.1]", "size_m = [0.2, -0.2, 0.1]", "detector.size_m: expected positive sizes"),
        ("size_m = [0.2, 0.2, 0.1]", 'size_m = ["1", "1", "1"]', "detector.size_m: expected 3 finite numbers"),
        ("mass_kg = 12.0", "mass_kg = 12000", "tool.mass_kg: expected kilograms"),
        ("com_m = [0.0, 0.0, 0.08]", "com_m = [0, 0, 80]", "tool.com_m: expected metres of at most 3"),
        ("link_C = [28.0,", "link_C = [301.0,", "temperature.link_C: expected degC from -273.15 to 200"),
        ("[[obstacle]]", "[safety]\nlimit_margin_rad = 5\n[[obstacle]]", "limit_margin_rad: expected radians"),
        ("[[obstacle]]", "[safety]\nclearance_m = 20\n[[obstacle]]", "safety.clearance_m: expected metres"),
        ("[[obstacle]]", "[safety]\nspeed = 30\n[[obstacle]]", "safety.speed: expected a share"),
        ("[[obstacle]]", "[robot_shape]\nbase_radius_m = 200\n[[obstacle]]", "base_radius_m: expected metres"),
        ("[0.0, 0.0, -9.81]", "[0.0, 0.0, 0.0]", "gravity_m_s2: expected a vector of about 9.81 m/s2"),
        ("[0.0, 0.0, -9.81]", "[0.0, 0.0, -9810]", "gravity_m_s2: expected a vector of about 9.81 m/s2"),
        ("[convention]", "session = 1.5\n[convention]", "session: expected a whole number from 1, found 1.5"),
        ('shape = "box"', 'shape = ["box"]', "expected a shape of box"),
        ('shape = "box"', 'shape = "box"\nholds_sample = "no"', "holds_sample: expected true or false, found 'no'"),
        ("[[obstacle]]", "[obstacle]", "expected tables [[obstacle]]"),
        ("[[obstacle]]", '[[obstacle]]\nname = "sample stage"\nshape = "sphere"\nsize_m = [0.1]\n[[obstacle]]',
         "obstacle sample stage: expected a name of its own"),
        ("[tool]", "targets_m = [[0.1, 0, 0.12]]\n[tool]", "detector.targets_m: expected a table"),
        ("[tool]", "targets_m = {T1 = [0.1, 0, 0], T2 = [0, 0.1, 0]}\n[tool]", "at least three targets, found 2"),
        ("[tool]", "targets_m = {T1 = [0.1, 0, 0], T2 = [0.2, 0, 0], T3 = [0.3, 0, 0]}\n[tool]",
         "detector.targets_m: expected targets at least 5 mm"),
        ('shape = "box"\nsize_m = [0.3, 0.3, 0.6]', 'shape = "mesh"\nfile = "none.stl"', "expected a mesh at"),
    ],
)  # fmt: skip
def test_a_wrong_cell_is_refused_by_its_file_and_key(tmp_path: Path, old: str, new: str, says: str) -> None:
    assert old in CELL
    path = written(tmp_path, CELL.replace(old, new))
    with pytest.raises(CellError) as caught:
        read_cell(path, ROBOT)
    assert says in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_margin_that_leaves_a_joint_no_range_is_refused(tmp_path: Path) -> None:
    joints = tuple(replace(j, lower=-0.3, upper=0.3) if k == 4 else j for k, j in enumerate(ROBOT.joints))
    path = written(tmp_path, CELL.replace("[[obstacle]]", "[safety]\nlimit_margin_rad = 0.3\n[[obstacle]]"))
    assert read_cell(path, ROBOT).limit_margin == 0.3
    with pytest.raises(CellError, match=f"leave {joints[4].name} no range"):
        read_cell(path, replace(ROBOT, joints=joints))


def test_what_only_the_model_can_tell_of_a_cell_names_its_file_too(tmp_path: Path, model_file: Path) -> None:
    unknown = "targets_m = {A = [0.1, 0, 0], B = [0, 0.1, 0], C = [0, 0, 0]}\n[tool]"
    path = written(tmp_path, CELL.replace("[tool]", unknown))
    with pytest.raises(CellError, match="the model knows no target 'A'") as caught:
        open_detector(model_file, path)
    assert str(caught.value).startswith(str(path))


def test_no_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(CellError, match="found none"):
        read_cell(tmp_path / "none.toml", ROBOT)
