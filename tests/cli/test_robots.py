"""`clampid robots`: what is bundled, how a description is understood, what is assumed, and the drawing."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from cli_runner import Clampid

from clampid.report.robot_drawing import robot_drawing
from clampid.screen import HEIGHT, WIDTH, laid_out
from clampid.verbs.robots import _one, assumptions, understood
from kinematics import load_robot, robot_names
from kinematics.masses import usual_links
from kinematics.poe import forward
from kinematics.urdf import write_urdf

DH_ONLY = """
format = "clampid-robot/1"
name = "planar"
title = "Two links"
source = "a test"
joint = [{name = "a", limits_deg = [-90, 90]}, {name = "b", limits_deg = [-120, 120]}]
[dh]
row = [{d_m = 0.3, a_m = 0.5}, {d_m = 0.0, a_m = 0.4, alpha_deg = 90, sign = -1}]
"""


def test_the_list_has_every_bundled_robot(clampid: Clampid) -> None:
    ran = clampid("robots", "--json", "-")
    assert ran.code == 0
    assert [robot["name"] for robot in ran.json] == list(robot_names())


@pytest.mark.parametrize("name", robot_names())
def test_every_description_fits_one_screen(name: str) -> None:
    lines = laid_out(_one(name, load_robot(name), None))
    assert len(lines) <= HEIGHT
    assert max(len(line.text) for line in lines) <= WIDTH


def test_what_is_not_described_is_said_to_be_assumed(tmp_path: Path, clampid: Clampid) -> None:
    described, geometry_only = load_robot("kuka_kr20_r1810"), load_robot("abb_irb1200_5_09")
    assert assumptions(described) == ()
    text = " ".join(assumptions(geometry_only))
    mass = sum(link.mass for link in usual_links(geometry_only))
    assert f"{mass:.0f} kg" in text
    for what in ("Masses", "transmission", "springs", "Rated torque"):
        assert what in text
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(write_urdf(described.screws, described.flange, described))
    ran = clampid("robots", urdf, "--json", "-")
    assert ran.code == 0, ran.err
    assert ran.json["masses_described"]
    assert not ran.json["transmission_known"]
    assert any("transmission" in sentence for sentence in ran.json["assumed"])


def test_gears_and_coupling_are_those_of_the_transmission() -> None:
    robot = load_robot("kuka_kr20_r1810")
    said = understood(robot)
    motor = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    moved = robot.transmission.T @ motor  # θ_joint = Tᵀ·θ_motor
    assert {j for i, j in said["coupled_joints"] if i == 4} == set(np.flatnonzero(moved) + 1) - {4}
    assert said["joints"][3]["gear_ratio"] == pytest.approx(1.0 / moved[3])


def test_a_drawing_is_whole_and_to_scale() -> None:
    robot = load_robot("ur10")
    root = ElementTree.fromstring(robot_drawing(robot))
    lines = [e.attrib["points"] for e in root.iter() if e.tag.endswith("polyline")]
    side = np.array([[float(n) for n in pair.split(",")] for pair in lines[0].split()])
    points = np.array([np.zeros(3), *(joint.point for joint in robot.joints), robot.flange[:3, 3]])
    scale = np.ptp(side[:, 0]) / np.ptp(points[:, 0])
    np.testing.assert_allclose(np.diff(side, axis=0), np.diff(points[:, [0, 2]], axis=0) * [scale, -scale], atol=0.2)
    labels = [e.text for e in root.iter() if e.tag.endswith("text")]
    assert [labels.count(str(k)) for k in range(1, 7)] == [2] * 6


@pytest.mark.slow
def test_a_drawing_is_written_where_it_is_asked_for(tmp_path: Path, clampid: Clampid) -> None:
    for _ in range(2):  # the second time over the first drawing
        ran = clampid("robots", "ur10", "--svg", tmp_path / "ur10.svg")
        assert ran.code == 0, ran.err
    assert (tmp_path / "ur10.svg").read_text().startswith("<svg")
    assert "did you mean ur10" in clampid("robots", "ur1O").complaint
    assert re.search(r"--svg: expected the robot", clampid("robots", "--svg", tmp_path / "x.svg").complaint)


def test_a_dh_table_alone_describes_a_robot(tmp_path: Path) -> None:
    path = tmp_path / "planar.toml"
    path.write_text(DH_ONLY)
    robot = load_robot(path)
    q = np.array([0.3, -0.7])
    flange = forward(robot.screws, robot.flange, q)
    expected = 0.5 * np.array([np.cos(0.3), np.sin(0.3)]) + 0.4 * np.array([np.cos(0.3 + 0.7), np.sin(0.3 + 0.7)])
    np.testing.assert_allclose(flange[:2, 3], expected, atol=1e-12)
    np.testing.assert_allclose(robot.joints[1].axis, [0, 0, -1])
