"""Cell files: what they say, what they may not say, and what is assumed where they say nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ik_arms import CELL

from kinematics.description import load_robot
from offline_ik.cell.cell import default_cell, read_cell
from offline_ik.errors import CellError
from offline_ik.inverse.opening import open_detector

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


@pytest.mark.parametrize("stated", ['format = "clampid-cell"\n', ""])
def test_a_cell_without_a_version_is_version_1(tmp_path: Path, stated: str) -> None:
    assert read_cell(written(tmp_path, CELL.replace('format = "clampid-cell/1"\n', stated)), ROBOT).tool_mass == 12.0


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
        (
            'robot = "kuka_kr20_r1810"',
            'robot = "ur10"',
            "key robot: expected 'kuka_kr20_r1810', which the model is of, found 'ur10'",
        ),
        ("clampid-cell/1", "clampid-cell/9", "key format: expected 'clampid-cell/1', found 'clampid-cell/9'"),
        (
            "mass_kg",
            "mass_lb",
            "tool.mass_lb: expected one of mass_kg, com_m, found the unknown key 'mass_lb'; did you mean 'mass_kg'?",
        ),
        ('shape = "box"', 'shape = "cone"', "obstacle[1].shape: expected one of box, cylinder"),
        ("size_m = [0.3, 0.3, 0.6]", "size_m = [0.3, 0.3]", "expected 3 finite numbers"),
        (
            "size_m = [0.3, 0.3, 0.6]",
            "size_m = [0.3, -0.3, 0.6]",
            "obstacle[1].size_m: expected 3 finite numbers of m above 0",
        ),
        ("sample_m = [1.4, 0.0, 0.0]", "sample_m = [1.4, nan, 0.0]", "convention.sample_m: expected 3 finite numbers"),
        ('name = "thesis"', 'name = "essay"', "key convention.name: expected one of thesis"),
        ("mass_kg = 12.0", "mass_kg = -1", "tool.mass_kg: expected a finite number of kg from 0 to 2000, found -1"),
        ("link_C = [28.0,", "link_C = [", "expected 6 finite numbers"),
        ("[tool]", "[tool", "as TOML"),
        ("sample_m = [1.4, 0.0, 0.0]", "sample_m = [1400, 0, 0]", "found [1400, 0, 0] (is it in millimetres?)"),
        ('name = "thesis"', 'name = ["thesis"]', "convention.name: expected one of thesis"),
        (
            "position_m = [0.0, 0.0, 0.12]",
            "position_m = [0, 0, 120]",
            "detector.position_m: expected 3 finite numbers of m from -3 to 3, found [0, 0, 120] (is it in mill",
        ),
        (
            "size_m = [0.2, 0.2, 0.1]",
            "size_m = [0.2, -0.2, 0.1]",
            "detector.size_m: expected 3 finite numbers of m above 0",
        ),
        ("size_m = [0.2, 0.2, 0.1]", 'size_m = ["1", "1", "1"]', "detector.size_m: expected 3 finite numbers"),
        (
            "mass_kg = 12.0",
            "mass_kg = 12000",
            "tool.mass_kg: expected a finite number of kg from 0 to 2000, found 12000 (is it in grams?)",
        ),
        ("com_m = [0.0, 0.0, 0.08]", "com_m = [0, 0, 80]", "found [0, 0, 80] (is it in millimetres?)"),
        (
            "link_C = [28.0,",
            "link_C = [301.0,",
            "temperature.link_C: expected 6 finite numbers of °C from -273.15 to 200, found [301.0",
        ),
        (
            "[[obstacle]]",
            "[safety]\nlimit_margin_rad = 5\n[[obstacle]]",
            "limit_margin_rad: expected a finite number of rad from 0 to 0.5, found 5 (is it in degrees?)",
        ),
        (
            "[[obstacle]]",
            "[safety]\nclearance_m = 20\n[[obstacle]]",
            "safety.clearance_m: expected a finite number of m from 0 to 1, found 20 (is it in millimetres?)",
        ),
        (
            "[[obstacle]]",
            "[safety]\nspeed = 30\n[[obstacle]]",
            "safety.speed: expected a finite number above 0 and not above 1, found 30",
        ),
        (
            "[[obstacle]]",
            "[robot_shape]\nbase_radius_m = 200\n[[obstacle]]",
            "robot_shape.base_radius_m: expected a finite number of m above 0 and not above 3, found 200",
        ),
        ("[0.0, 0.0, -9.81]", "[0.0, 0.0, 0.0]", "gravity_m_s2: expected a vector of about 9.81 m/s2"),
        ("[0.0, 0.0, -9.81]", "[0.0, 0.0, -9810]", "gravity_m_s2: expected a vector of about 9.81 m/s2"),
        ("[convention]", "session = 1.5\n[convention]", "session: expected an integer from 1, found 1.5"),
        ('shape = "box"', 'shape = ["box"]', "obstacle[1].shape: expected one of box, cylinder"),
        ('shape = "box"', 'shape = "box"\nholds_sample = "no"', "holds_sample: expected true or false, found 'no'"),
        ("[[obstacle]]", "[obstacle]", "expected tables [[obstacle]]"),
        (
            "[[obstacle]]",
            '[[obstacle]]\nname = "sample stage"\nshape = "sphere"\nsize_m = [0.1]\n[[obstacle]]',
            "obstacle[2].name: expected a name of its own, found 'sample stage' twice",
        ),
        ("[tool]", "targets_m = [[0.1, 0, 0.12]]\n[tool]", "detector.targets_m: expected a table"),
        (
            'name = "thesis"',
            'name = "thesis"\ngamma_sign = true',
            "gamma_sign: expected an integer from -1 to 1, found True",
        ),
        (
            "[tool]",
            "targets_m = {T1 = [0.1, 0, 0], T2 = [0, 0.1, 0]}\n[tool]",
            "detector.targets_m: expected at least three targets, found 2",
        ),
        (
            "[tool]",
            "targets_m = {T1 = [0.1, 0, 0], T2 = [0.2, 0, 0], T3 = [0.3, 0, 0]}\n[tool]",
            "detector.targets_m: expected targets at least 5 mm",
        ),
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
