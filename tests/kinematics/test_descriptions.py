"""Every bundled robot loads and has the facts of its source; a bad description is refused with the reason."""

import re
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from kinematics import DescriptionError, forward, load_robot, robot_names
from kinematics import dh as dh_module

KUKA = {
    "kuka_kr20_r1810": (0.520, 0.160, 0.780, 0.150, 0.860, 0.153),
    "kuka_kr16_2": (0.675, 0.260, 0.680, -0.035, 0.670, 0.158),
    "kuka_kr30_3": (0.815, 0.350, 0.850, 0.145, 0.820, 0.170),
}
ABB = {
    "abb_irb4600_40_255": (0.495, 0.175, 1.095, 0.175, 1.270, 0.135),
    "abb_irb2400_12_155": (0.615, 0.100, 0.705, 0.135, 0.755, 0.085),
    "abb_irb1200_5_09": (0.3991, 0.0, 0.448, 0.042, 0.451, 0.082),
}
KR20 = "kuka_kr20_r1810"


def text_of(name: str) -> str:
    return resources.files("appendix_data").joinpath("robots", f"{name}.toml").read_text(encoding="utf-8")


def test_the_list():
    assert set(robot_names()) == {*KUKA, *ABB, "ur10", "staubli_tx40"}


@pytest.mark.parametrize("name", robot_names())
def test_every_bundled_description_loads(name):
    robot = load_robot(name)
    assert robot.name == name
    assert robot.n == 6
    assert robot.screws.shape == (6, 6)
    assert np.all(np.isfinite(robot.lower) & np.isfinite(robot.upper) & (robot.lower < robot.upper))
    assert robot.title
    assert robot.source
    if not robot.has_masses:
        assert any("No masses" in note for note in robot.notes)
    if not robot.transmission_known:
        np.testing.assert_array_equal(robot.transmission, np.eye(6))
    if robot.dh is not None:
        q = np.linspace(-2, 2, 30).reshape(5, 6)
        np.testing.assert_allclose(dh_module.forward(robot.dh, q), forward(robot.screws, robot.flange, q), atol=1e-12)


@pytest.mark.parametrize(("name", "lengths"), KUKA.items())
def test_kuka_geometry(name, lengths):
    d1, a1, a2, a3, d4, d6 = lengths
    robot = load_robot(name)
    x, z = a1 + a2, d1 + a3
    points = [(0, 0, 0), (a1, 0, d1), (x, 0, d1), (x, 0, z), (x + d4, 0, z), (x + d4, 0, z)]
    axes = [(0, 0, -1), (0, 1, 0), (0, 1, 0), (-1, 0, 0), (0, 1, 0), (-1, 0, 0)]
    np.testing.assert_allclose([joint.axis for joint in robot.joints], axes)
    np.testing.assert_allclose([joint.point for joint in robot.joints], points, atol=1e-12)
    np.testing.assert_allclose(robot.flange[:3, 3], (x + d4 + d6, 0, z), atol=1e-12)
    np.testing.assert_allclose(robot.flange[:3, :3], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    assert robot.dh_signs == (-1, 1, 1, 1, 1, 1)


@pytest.mark.parametrize(("name", "lengths"), ABB.items())
def test_abb_geometry(name, lengths):
    d1, a1, a2, a3, d4, d6 = lengths
    robot = load_robot(name)
    z = d1 + a2 + a3
    points = [(0, 0, 0), (a1, 0, d1), (a1, 0, d1 + a2), (a1, 0, z), (a1 + d4, 0, z), (a1 + d4, 0, z)]
    axes = [(0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0)]
    np.testing.assert_allclose([joint.axis for joint in robot.joints], axes)
    np.testing.assert_allclose([joint.point for joint in robot.joints], points, atol=1e-12)
    np.testing.assert_allclose(robot.flange[:3, 3], (a1 + d4 + d6, 0, z), atol=1e-12)


def test_reach_of_kr30_3():
    _, a1, a2, a3, d4, _ = KUKA["kuka_kr30_3"]
    assert a1 + a2 + np.hypot(a3, d4) == pytest.approx(2.033, abs=5e-4)
    assert any("sign" in note for note in load_robot("kuka_kr30_3").unverified)


def test_linkage_of_irb2400():
    robot = load_robot("abb_irb2400_12_155")
    q = np.array([0.1, 0.2, 0.5, 0.4, 0.3, 0.6])
    np.testing.assert_allclose(robot.linkage @ q, [0.1, 0.2, 0.3, 0.4, 0.3, 0.6])
    assert robot.unverified
    np.testing.assert_array_equal(load_robot("ur10").linkage, np.eye(6))


def test_ur10_has_the_printed_dh_table():
    robot = load_robot("ur10")
    a = (0, -0.612, -0.5723, 0, 0, 0)
    d = (0.1273, 0, 0, 0.163941, 0.1157, 0.0922)
    alpha = np.deg2rad((90, 0, 0, 90, -90, 0))
    table = dh_module.DHTable(tuple(dh_module.DHRow(1, 0.0, d[i], a[i], alpha[i]) for i in range(6)))
    q = np.random.default_rng(1).uniform(-3, 3, (20, 6))
    np.testing.assert_allclose(dh_module.forward(table, q), forward(robot.screws, robot.flange, q), atol=1e-14)
    assert sum(link.mass for link in robot.links) == pytest.approx(28.435)
    np.testing.assert_allclose(robot.upper, 2 * np.pi)


def test_tx40_zero_is_upright_and_the_public_frames_are_a_quarter_turn_away():
    robot = load_robot("staubli_tx40")
    np.testing.assert_allclose(robot.flange[:3, 3], [0, 0.035, 0.320 + 0.225 + 0.225 + 0.065])
    q = np.deg2rad([0, 90, -90, 0, 0, 0])  # the zero of the public modified-DH frames
    np.testing.assert_allclose(forward(robot.screws, robot.flange, q)[:3, 3], [0.225, 0.035, 0.610], atol=1e-15)


def test_kr20_limits_speeds_torques_and_masses():
    robot = load_robot(KR20)
    np.testing.assert_allclose(np.rad2deg(robot.lower), [-185, -185, -138, -350, -130, -350])
    np.testing.assert_allclose(np.rad2deg(robot.upper), [185, 65, 175, 350, 130, 350])
    np.testing.assert_allclose(np.rad2deg([j.max_speed for j in robot.joints]), [200, 171.6, 190, 430, 430, 630])
    np.testing.assert_allclose([j.rated_torque for j in robot.joints], [1809.6, 1569.1, 792.7, 249.1, 238.9, 104.6])
    np.testing.assert_allclose([link.mass for link in robot.links], [84.207, 55.407, 35.648, 16.428, 0, 0])


def test_unknown_name_lists_the_known_and_the_nearest():
    with pytest.raises(DescriptionError, match="did you mean kuka_kr20_r1810") as caught:
        load_robot("kuka_kr20_1810")
    assert all(name in str(caught.value) for name in robot_names())


def test_path_is_relative_to_where_the_campaign_says(tmp_path):
    (tmp_path / "mine.toml").write_text(text_of(KR20), encoding="utf-8")
    assert load_robot("mine.toml", relative_to=tmp_path).name == KR20
    assert load_robot(tmp_path / "mine.toml").name == KR20
    with pytest.raises(DescriptionError, match="expected a file, found none"):
        load_robot(Path("missing.toml"), relative_to=tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('format = "clampid-robot/1"', 'format = "other/1"', "format: expected 'clampid-robot/1', found 'other/1'"),
        ("axis = [0.0, 0.0, -1.0]", "axis = [0.0, 0.0, -1.1]", r"joint 1 \(A1\), axis: expected a vector of length 1"),
        (
            "limits_deg = [-185.0, 65.0]",
            "limits_deg = [65.0, -185.0]",
            r"joint 2 \(A2\), limits: expected lower < upper",
        ),
        ("max_speed_deg_s = 200.0", "max_speed_deg_s = -1.0", "maximum speed: expected a positive number"),
        ("max_speed_deg_s = 200.0", "max_sped_deg_s = 200.0", "did you mean 'max_speed_deg_s'"),
        ('name = "A2"', 'name = "A1"', "expected joints of different names"),
        (
            'name = "A2"\n',
            "",
            r"key joint\[2\]\.name: expected printable text .*found no such key",
        ),
        ("x = [0.0, 0.0, -1.0]", "x = [0.1, 0.0, -1.0]", "flange: expected a rigid transform"),
        (
            "mass_kg = 84.207",
            "mass_kg = -84.207",
            r"link\[1\]\.mass_kg: expected .* from 0 to 100000, found -84.207",
        ),
        ('"7/880"', '"880/7"', "diagonal entry 1: expected a reduction.*other way round"),
        ('"7/880"', '"0"', "transmission: expected an invertible matrix"),
        ('"7/880"', '"seven"', "seven"),
        (", 0.56]", "]", "key transmission.motor_spring_Nm_rad: expected 6 finite numbers above 0, found 5 of them"),
        ("d_m = 0.52", "d_m = -0.52", r"row 2 \(its sign\) or row 1: at the zero pose it turns joint 2 \(A2\)"),
        ("sign = -1", "sign = 1", r"row 1 \(its sign\) or the base: at the zero pose it turns joint 1 \(A1\)"),
        ("d_m = -0.153", "d_m = -0.154", "row 6 or the tool: at the zero pose it ends 0.001"),
        ("a_m = 0.78", "a_m = 0.79", r"row 3 \(its sign\) or row 2"),
        (
            "[[dh.row]]\nsign = -1",
            "[[dh.rows]]\nsign = -1",
            "found the unknown key 'rows'; did you mean 'row'",
        ),
        ("notes = [", "notes = ", "mine.toml"),
        (
            "axis = [0.0, 0.0, -1.0]",
            "axis = [0.0, -1.0]",
            r"mine.toml: key joint\[1\]\.axis: expected 3 finite numbers, found 2 of them",
        ),
        ("limits_deg = [-185.0, 185.0]", "limits_deg = 185.0", "mine.toml: "),
        ('"7/880"', '"7/0"', "mine.toml: "),
        ("mass_kg = 84.207", "mass_kg = true", r"link\[1\]\.mass_kg: expected a finite number.*found True"),
        ("mass_kg = 84.207", "mass_kg = 842070", r"mass_kg: expected .*found 842070 \(is it in grams\?\)"),
        ("d_m = 0.52", "d_m = 520", r"dh\.row\[1\]\.d_m: expected .* of m .*found 520 \(is it in millimetres\?\)"),
        ("max_speed_deg_s = 200.0", "max_speed_deg_s = true", "found True"),
        ("limits_deg = [-185.0, 185.0]", "limits_deg = [-3, 3]\nlimits_rad = [-3, 3]", "found both"),
        ("limits_deg = [-185.0, 185.0]", "limits_rad = [-18500, 18500]", r"is it in degrees\?"),
        ("sign = -1", "sign = -1.9", r"dh\.row\[1\]\.sign: expected an integer from -1 to 1, found -1\.9"),
        ("sign = -1", "prismatic = 0", "expected true or false, found 0"),
        ('format = "clampid-robot/1"', 'format = "clampid-robot/2"', r"found 'clampid-robot/2' \(of a newer clampid\)"),
        ("limits_deg = [-185.0, 185.0]\n", "", r"key joint\[1\]: expected limits_deg or limits_rad, found neither"),
    ],
)
def test_bad_descriptions_are_refused_with_the_reason(tmp_path, old, new, message):
    text = text_of(KR20)
    assert old in text
    (tmp_path / "mine.toml").write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(DescriptionError, match=re.compile(message, re.DOTALL)):
        load_robot("mine.toml", relative_to=tmp_path)


def test_a_sign_that_only_shows_when_moving_is_found(tmp_path):
    """The thesis' error in row 6 does not move the flange at the zero pose; the axis gives it away."""
    text = text_of(KR20)
    head, last = text.rsplit("[[dh.row]]\nsign = 1", 1)
    (tmp_path / "mine.toml").write_text(f"{head}[[dh.row]]\nsign = -1{last}", encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"row 6 \(its sign\) or row 5"):
        load_robot("mine.toml", relative_to=tmp_path)


SCARA = """
format = "clampid-robot/1"
name = "scara"
title = "A four-axis arm"
source = "made up"
[[joint]]
name = "1"
axis = [0, 0, 1]
point_m = [0, 0, 0]
limits_deg = [-150, 150]
[[joint]]
name = "2"
axis = [0, 0, 1]
point_m = [0.4, 0, 0]
limits_rad = [-2.5, 2.5]
[[joint]]
name = "3"
kind = "prismatic"
axis = [0, 0, -1]
point_m = [0.7, 0, 0]
limits_m = [0, 0.2]
max_speed_m_s = 1.1
[[joint]]
name = "4"
kind = "helical"
axis = [0, 0, -1]
point_m = [0.7, 0, 0]
pitch_m_rad = 0.003
limits_deg = [-360, 360]
[flange]
position_m = [0.7, 0, 0.2]
x = [1, 0, 0]
z = [0, 0, -1]
"""


def test_other_numbers_and_kinds_of_joints(tmp_path):
    (tmp_path / "scara.toml").write_text(SCARA, encoding="utf-8")
    robot = load_robot("scara.toml", relative_to=tmp_path)
    assert robot.n == 4
    assert (robot.lower[2], robot.upper[2]) == (0.0, 0.2)
    pose = forward(robot.screws, robot.flange, [0, 0, 0.1, np.pi])
    np.testing.assert_allclose(pose[:3, 3], [0.7, 0, 0.1 - 0.003 * np.pi], atol=1e-15)
    (tmp_path / "scara.toml").write_text(SCARA.replace("pitch_m_rad = 0.003\n", ""), encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"joint 4 \(4\), pitch"):
        load_robot("scara.toml", relative_to=tmp_path)
