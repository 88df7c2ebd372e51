"""The chain of KUKA machine data: its frames against a published file, and fits of arms to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinematics.description import load_robot
from kinematics.kuka import MachineDataError, forward, frame, frame_numbers, nominal_machine_data
from kinematics.kuka_text import machine_data_text, read_machine_data
from kinematics.poe import forward as poe_forward
from kinematics.screws import screw, transform

# What the controller of a KR 210 R2700 extra has, by a public back-up; its declarations and remarks are shortened.
KR210 = """\
DEFDAT  $MACHINE PUBLIC
DECL MAIN_AXIS $MAIN_AXIS=#NR ;GRUNDACHSENKENNUNG
FRAME $ROBROOT={X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0} ;ROBOTER IM WELTKOORDINATENSYSTEM [MM,GRAD]
INT $AXIS_DIR[12] ;DREHRICHTUNG
$AXIS_DIR[1]=-1
$AXIS_DIR[2]=1
$AXIS_DIR[3]=1
$AXIS_DIR[4]=-1
$AXIS_DIR[5]=-1
$AXIS_DIR[6]=-1
$AXIS_DIR[7]=0
FRAME $TIRORO={X 0.0,Y 0.0,Z 675.000,A 0.0,B 0.0,C 0.0}
FRAME $TFLWP={X 0.0,Y 0.0,Z 215.000,A 0.0,B 0.0,C 0.0}
FRAME $TX3P3={X 1200.00,Y 0.0,Z -41.0000,A 0.0,B 90.0000,C 0.0} ;ANBRINGUNG DER ROBOTERHAND
REAL $LENGTH_A=350.000 ;GRUNDACHSLAENGE A
REAL $LENGTH_B=1150.00
DECL DHART $DH_4={DHART_A 0.0,DHART_D 0.0,DHART_ALPHA 90.0000} ;A = LAENGE A
DECL DHART $DH_5={DHART_A 0.0,DHART_D 0.0,DHART_ALPHA -90.0000}
ENDDAT
"""


def postures(count: int = 50) -> np.ndarray:
    return np.random.default_rng(2).uniform(-np.pi, np.pi, (count, 6))


def test_the_data_of_a_controller_give_the_axes_that_kuka_arms_have() -> None:
    axes = [[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]]
    height = 0.675 - 0.041
    points = [[0, 0, 0], [0.35, 0, 0.675], [1.5, 0, 0.675], [1.5, 0, height], [2.7, 0, height], [2.7, 0, height]]
    flange = transform([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], [2.7 + 0.215, 0, height])
    q = postures()
    there = poe_forward(screw(np.array(axes, dtype=float), points), flange, q)
    np.testing.assert_allclose(forward(read_machine_data(KR210), q), there, atol=1e-12)


@pytest.mark.parametrize(
    "name", ["kuka_kr20_r1810", "kuka_kr16_2", "kuka_kr30_3", "abb_irb4600_40_255", "staubli_tx40"]
)
def test_nominal_machine_data_are_the_robot(name: str) -> None:
    robot, q = load_robot(name), postures()
    data = nominal_machine_data(robot)
    np.testing.assert_allclose(forward(data, q), poe_forward(robot.screws, robot.flange, q), atol=1e-14)
    if name.startswith("kuka"):
        like = read_machine_data(KR210)
        assert data.axis_dir == like.axis_dir
        assert not data.mastering.any()
        np.testing.assert_allclose(data.tx3p3[3:], like.tx3p3[3:], atol=1e-15)


@pytest.mark.parametrize(
    ("name", "words"),
    [("ur10", "axes 3 and 4 are 0 degrees apart"), ("abb_irb2400_12_155", "coupled by a linkage")],
)
def test_another_kind_of_arm_is_refused_with_the_reason(name: str, words: str) -> None:
    with pytest.raises(MachineDataError, match=words):
        nominal_machine_data(load_robot(name))


def test_other_numbers_of_joints_and_wrists_that_do_not_meet_are_refused() -> None:
    robot = load_robot("kuka_kr20_r1810")
    with pytest.raises(MachineDataError, match="expected six revolute joints, found 5"):
        nominal_machine_data(
            replace(robot, joints=robot.joints[:5], transmission=np.eye(5), linkage=np.eye(5), dh=None)
        )
    last = replace(robot.joints[5], point=robot.joints[5].point + np.array([0, 0, 0.002]))
    with pytest.raises(MachineDataError, match="axis 6 is 2 mm off"):
        nominal_machine_data(replace(robot, joints=(*robot.joints[:5], last), dh=None))


numbers = st.floats(-3.0, 3.0)


@given(st.lists(numbers, min_size=6, max_size=6))
def test_frames_split_and_join(values: list[float]) -> None:
    T = frame(values)
    np.testing.assert_allclose(frame(frame_numbers(T)), T, atol=1e-13)


@given(st.lists(numbers, min_size=32, max_size=32))
def test_what_is_written_is_read(values: list[float]) -> None:
    v = np.array(values)
    data = replace(
        read_machine_data(KR210), robroot=v[:6], tiroro=v[6:12], tx3p3=v[12:18], tflwp=v[18:24],
        length_a=values[24], length_b=values[25], mastering=v[26:32],
    )  # fmt: skip
    back = read_machine_data(machine_data_text(data, {"tflwp": np.abs(v[:6])}, ["a remark"]))
    np.testing.assert_allclose(forward(back, postures(5)), forward(data, postures(5)), atol=1e-10)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("#NR", "#SS", r"\$MAIN_AXIS: expected #NR"),
        ("$LENGTH_B", "$LENGTH_X", r"\$LENGTH_B: expected it once.* found it 0 times"),
        ("ENDDAT", "REAL $LENGTH_A=1.0", r"\$LENGTH_A: expected it once.* found it 2 times"),
        ("REAL $LENGTH_A=350.000", "REAL $LENGTH_A=long", r"\$LENGTH_A: expected it once"),
        ("Z 675.000,", "", r"\$TIRORO: expected X, Y, Z, A, B, C, found X, Y, A, B, C"),
        ("$AXIS_DIR[4]=-1", "$AXIS_DIR[4]=0", r"\$AXIS_DIR\[4\]: expected it once"),
    ],
)
def test_a_file_that_does_not_hold_it_is_refused(old: str, new: str, words: str) -> None:
    assert old in KR210
    with pytest.raises(MachineDataError, match=words):
        read_machine_data(KR210.replace(old, new))
