"""URDF written here is read by pinocchio as the same robot."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from kinematics import DescriptionError, forward, gravity_torque, load_robot, robot_names
from kinematics.masses import usual_links
from kinematics.robot import Joint
from kinematics.screws import exp_se3, exp_so3, inverse, screw
from kinematics.urdf import read_urdf, write_urdf


def calibrated(robot, rng, size=1e-3):
    S = np.array(
        [
            screw(exp_so3(size * rng.normal(size=3)) @ joint.axis, joint.point + size * rng.normal(size=3))
            for joint in robot.joints
        ]
    )
    return S, robot.flange @ exp_se3(size * rng.normal(size=6))


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-3])
@pytest.mark.parametrize("name", robot_names())
def test_pinocchio_reads_the_calibrated_robot(name, size, rng):
    robot = load_robot(name)
    S, home = calibrated(robot, rng, size)
    model = pin.buildModelFromXML(write_urdf(S, home, robot))
    data = model.createData()
    frame = model.getFrameId("flange")
    assert list(model.names)[1:] == [joint.name for joint in robot.joints]
    for q in rng.uniform(-3, 3, (20, robot.n)):
        pin.framesForwardKinematics(model, data, q)
        np.testing.assert_allclose(data.oMf[frame].homogeneous, forward(S, home, q), atol=1e-12)


def test_base_is_a_fixed_joint(rng):
    robot = load_robot("ur10")
    base = exp_se3(rng.normal(size=6))
    model = pin.buildModelFromXML(write_urdf(robot.screws, robot.flange, robot, base))
    data = model.createData()
    q = rng.normal(size=6)
    pin.framesForwardKinematics(model, data, q)
    seen = data.oMf[model.getFrameId("flange")].homogeneous
    np.testing.assert_allclose(seen, base @ forward(robot.screws, robot.flange, q), atol=1e-12)
    np.testing.assert_allclose(data.oMf[model.getFrameId("base_link")].homogeneous, base, atol=1e-14)


@pytest.mark.parametrize("name", robot_names())
def test_round_trip(name, tmp_path, rng):
    robot = load_robot(name)
    S, home = calibrated(robot, rng)
    path = tmp_path / "robot.urdf"
    path.write_text(write_urdf(S, home, robot), encoding="utf-8")
    back = load_robot(path)
    np.testing.assert_allclose(back.screws, S, atol=1e-12)
    np.testing.assert_allclose(back.flange, home, atol=1e-12)
    np.testing.assert_allclose(back.lower, robot.lower)
    np.testing.assert_allclose(back.upper, robot.upper)
    assert [j.max_speed for j in back.joints] == pytest.approx([j.max_speed for j in robot.joints])
    assert [j.rated_torque for j in back.joints] == pytest.approx([j.rated_torque for j in robot.joints])
    assert back.has_masses == robot.has_masses
    if robot.has_masses:
        q = rng.normal(size=6)
        np.testing.assert_allclose(gravity_torque(back, q), gravity_torque(robot_with(robot, S, home), q), atol=1e-9)


def robot_with(robot, S, home):
    joints = tuple(
        replace(joint, axis=s[:3], point=np.cross(s[:3], s[3:])) for joint, s in zip(robot.joints, S, strict=True)
    )
    return replace(robot, joints=joints, flange=home)


def test_slides_and_endless_joints(tmp_path, rng):
    robot = replace(
        load_robot("ur10"),
        links=(),
        transmission=np.eye(3),
        linkage=np.eye(3),
        dh=None,
        joints=(
            Joint("turn", "revolute", np.array([0.0, 0.6, 0.8]), np.array([0.1, 0.2, 0.3])),
            Joint("slide", "prismatic", np.array([0.8, 0.0, 0.6]), np.array([0.1, 0.2, 0.3]), lower=0.0, upper=0.4),
            Joint("last", "revolute", np.array([1.0, 0.0, 0.0]), np.array([0.4, 0.2, 0.3]), lower=-1.0, upper=1.0),
        ),
    )
    path = tmp_path / "robot.urdf"
    path.write_text(write_urdf(robot.screws, robot.flange, robot), encoding="utf-8")
    back = read_urdf(path)
    np.testing.assert_allclose(back.screws, robot.screws, atol=1e-14)
    assert [joint.kind for joint in back.joints] == ["revolute", "prismatic", "revolute"]
    assert back.upper[0] == np.inf
    assert (back.lower[1], back.upper[1]) == (0.0, 0.4)


FOREIGN = """<robot name="foreign">
  <link name="base"/><link name="one"/><link name="two"/><link name="flange"/><link name="tool0"/>
  <joint name="j1" type="revolute"><parent link="base"/><child link="one"/><origin xyz="0 0 1" rpy="0 0 1.0"/>
    <axis xyz="0 0 2"/><limit lower="-1" upper="1" effort="5" velocity="2"/></joint>
  <joint name="j2" type="revolute"><parent link="{parent}"/><child link="two"/><origin xyz="0.5 0 0" rpy="1.0 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="5" velocity="2"/></joint>
  <joint name="f1" type="fixed"><parent link="two"/><child link="flange"/><origin xyz="0 0.1 0.3" rpy="0 0 0"/></joint>
  <joint name="f2" type="fixed"><parent link="flange"/><child link="tool0"/><origin xyz="0 0 0" rpy="0 1.57 0"/></joint>
</robot>"""


def test_foreign_file(tmp_path, rng):
    path = tmp_path / "foreign.urdf"
    path.write_text(FOREIGN.format(parent="one"), encoding="utf-8")
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    q = rng.uniform(-1, 1, 2)
    pin.framesForwardKinematics(model, data, q)
    for robot, frame in ((read_urdf(path), "tool0"), (read_urdf(path, "flange"), "flange")):
        expected = data.oMf[model.getFrameId(frame)].homogeneous
        np.testing.assert_allclose(forward(robot.screws, robot.flange, q), expected, atol=1e-14)
    assert not read_urdf(path).has_masses
    tools = inverse(read_urdf(path, "flange").flange) @ read_urdf(path).flange
    assert tools[0, 2] == pytest.approx(np.sin(1.57))


def test_refusals_say_why(tmp_path):
    path = tmp_path / "bad.urdf"
    path.write_text("not xml", encoding="utf-8")
    with pytest.raises(DescriptionError, match="expected a URDF"):
        load_robot(path)
    path.write_text(FOREIGN.format(parent="base"), encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"expected a serial chain.*j2"):
        load_robot(path)
    path.write_text('<robot name="a"><link name="l"/></robot>', encoding="utf-8")
    with pytest.raises(DescriptionError, match="at least one moving joint"):
        load_robot(path)
    path.write_text(FOREIGN.format(parent="one"), encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"expected a frame 'hand', found .*tool0"):
        read_urdf(path, "hand")
    robot = load_robot("ur10")
    with pytest.raises(DescriptionError, match=r"expected screws of shape \(6, 6\), found \(5, 6\)"):
        write_urdf(robot.screws[:5], robot.flange, robot)
    helical = np.array(robot.screws)
    helical[0, 5] = 0.01
    with pytest.raises(DescriptionError, match=r"shoulder_pan: URDF has no helical joint, found a pitch of 0\.01"):
        write_urdf(helical, robot.flange, robot)


@pytest.mark.parametrize("name", robot_names())
def test_joints_stay_where_the_file_has_them(name, tmp_path):
    """Screws do not say where along its axis a bearing sits, and links are as long as from bearing to bearing."""
    robot = load_robot(name)
    path = tmp_path / "robot.urdf"
    path.write_text(write_urdf(robot.screws, robot.flange, robot), encoding="utf-8")
    back = read_urdf(path)
    for was, joint in zip(robot.joints, back.joints, strict=True):
        np.testing.assert_allclose(joint.point, was.point, atol=1e-12)
    masses = [sum(link.mass for link in usual_links(replace(r, links=()))) for r in (robot, back)]
    assert masses[1] == pytest.approx(masses[0], rel=1e-9)


def test_an_arm_of_one_joint_is_read(tmp_path):
    path = tmp_path / "one.urdf"
    path.write_text(
        '<robot name="one"><link name="a"/><link name="b"/><joint name="turn" type="revolute"><parent link="a"/>'
        '<child link="b"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    robot = read_urdf(path)
    assert robot.n == 1
    assert np.allclose(robot.screws, [[0, 0, 1, 0, 0, 0]])


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (b"turn", b"t\xc5rn", "expected a URDF in UTF-8"),
        (b"0 0 1", b"0 0 1e-320", "expected"),
        (b"0 0 1", b"0 0 1e300", "expected"),
        (b"<link", b"\0<link", "expected a URDF"),
    ],
)
def test_a_urdf_of_no_utf_8_or_without_an_axis_is_refused_in_words(old, new, says, tmp_path):
    path = tmp_path / "one.urdf"
    good = (
        b'<robot name="one"><link name="a"/><link name="b"/><joint name="turn" type="revolute"><parent link="a"/>'
        b'<child link="b"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    path.write_bytes(good.replace(old, new, 1))
    with pytest.raises(DescriptionError, match=says) as raised:
        read_urdf(path)
    assert str(path) in str(raised.value)
