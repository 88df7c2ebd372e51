"""
URDF in and out. Reading goes through pinocchio, whose model it is checked against anyway; writing is text only.

Written links have the axes of the base frame at the zero pose, so that no rotation has to be split into angles except
the flange's.
"""

import contextlib
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import numpy.typing as npt

from kinematics.checks import validate
from kinematics.fixed_angles import roll_pitch_yaw
from kinematics.reading import read_text
from kinematics.robot import DescriptionError, Joint, JointKind, Link, RobotDescription
from kinematics.typing_ import Array

__all__ = ["read_urdf", "write_urdf"]

_PITCH = 1e-12  # m/rad: what rounding may leave of a revolute joint's pitch


def read_urdf(path: str | Path, flange: str | None = None) -> RobotDescription:
    """
    Read a serial arm from URDF.

    Parameters
    ----------
    path
        The file.
    flange
        Name of the link or frame that is the flange; by default the first that exists of tool0 (ROS-Industrial's,
        whose z points out, unlike that of its own flange), flange, ee_link and tool, else the last link.

    Returns
    -------
    RobotDescription
        The description in the frame of the file's root link. Source: the screws are the columns of the base-frame
        Jacobian at the zero pose; Lynch & Park, Modern Robotics, section 4.2.

    Raises
    ------
    DescriptionError
        If the file cannot be read, is not a serial chain, or has no such frame.
    """
    import pinocchio as pin  # takes a while, and only this needs it

    path = Path(path)
    try:
        text = read_text(path)  # pinocchio would take names that are no UTF-8
        with _silent():
            model = pin.buildModelFromXML(text)
    except UnicodeDecodeError as error:
        raise DescriptionError(
            f"{path}: expected a URDF in UTF-8, found a byte that is not, at {error.start}"
        ) from None
    except OSError as error:
        raise DescriptionError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, RuntimeError) as error:
        raise DescriptionError(f"{path}: expected a URDF, but pinocchio says: {str(error).strip()}") from None
    if model.njoints < 2:
        raise DescriptionError(f"{path}: expected at least one moving joint, found none")
    data = model.createData()
    q = pin.neutral(model)
    J = np.reshape(pin.computeJointJacobians(model, data, q), (6, -1))  # of one joint it is a vector
    pin.framesForwardKinematics(model, data, q)
    joints, links = [], []
    for i in range(1, model.njoints):
        name = model.names[i]
        if model.parents[i] != i - 1 or model.joints[i].nv != 1:
            raise DescriptionError(f"{path}: expected a serial chain of joints of one axis; {name} breaks it")
        origin = np.array(data.oMi[i].translation)
        joints.append(_joint(path, model, i, np.concatenate([J[3:, i - 1], J[:3, i - 1]]), origin))
        moved = data.oMi[i].act(model.inertias[i])
        links.append(Link(float(moved.mass), np.array(moved.lever), np.array(moved.inertia)))
    frame = _flange_frame(model, path, flange)
    known = any(link.mass > 0 for link in links)
    return validate(
        RobotDescription(
            name=str(model.name),
            title=str(model.name),
            joints=tuple(joints),
            flange=np.array(data.oMf[frame].homogeneous),
            links=tuple(links) if known else (),
            notes=("A URDF says nothing of the transmission: it is the identity here.",),
            source=str(path),
        )
    )


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Keep the parser's own lines from stderr: what is wrong is said once, in the error."""
    try:
        kept = os.dup(2)
    except OSError:  # there is no stderr
        yield
        return
    try:
        with open(os.devnull, "wb") as nothing:
            sys.stderr.flush()
            os.dup2(nothing.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _joint(path: Path, model: Any, i: int, S: Array, origin: Array) -> Joint:
    """Make a joint of pinocchio's number i, whose screw at the zero pose is S.

    Its point is the joint's own origin: where along its axis a bearing sits, and how long links are, no screw tells.
    """
    moving = model.joints[i]
    turns = float(np.linalg.norm(S[:3])) > 0.5
    axis = S[:3] if turns else S[3:]
    length = float(np.linalg.norm(axis))
    if not 0.0 < length < np.inf:  # NaN neither
        raise DescriptionError(f"{path}: joint {model.names[i]}: expected an axis of finite length, found {length:g}")
    pitch = float(S[:3] @ S[3:])
    kind: JointKind = "prismatic" if not turns else "helical" if abs(pitch) > _PITCH else "revolute"
    endless = moving.nq == 2  # pinocchio holds a continuous joint as cosine and sine
    speed, effort = float(model.velocityLimit[moving.idx_v]), float(model.effortLimit[moving.idx_v])
    return Joint(
        name=str(model.names[i]),
        kind=kind,
        axis=axis / length,
        point=origin,
        pitch=pitch if kind == "helical" else 0.0,
        lower=-np.inf if endless else float(model.lowerPositionLimit[moving.idx_q]),
        upper=np.inf if endless else float(model.upperPositionLimit[moving.idx_q]),
        max_speed=speed if 0 < speed < np.inf else None,
        rated_torque=effort if 0 < effort < np.inf else None,
    )


def _flange_frame(model: Any, path: Path, wanted: str | None) -> int:
    names = [str(frame.name) for frame in model.frames]
    if wanted is not None:
        if wanted not in names:
            raise DescriptionError(f"{path}: expected a frame {wanted!r}, found {', '.join(names)}")
        return names.index(wanted)
    for name in ("tool0", "flange", "ee_link", "tool"):
        if name in names and int(model.frames[names.index(name)].parentJoint) == model.njoints - 1:
            return names.index(name)
    return max(i for i, frame in enumerate(model.frames) if int(frame.parentJoint) == model.njoints - 1)


def write_urdf(
    screws: npt.ArrayLike, home: npt.ArrayLike, robot: RobotDescription, base: npt.ArrayLike | None = None
) -> str:
    """
    Write calibrated screws as URDF.

    Parameters
    ----------
    screws
        Screws (n, 6) of revolute or prismatic joints in the base frame at the zero pose, (omega, v) [1, m].
    home
        The flange's home pose (4, 4) in the base frame [m].
    robot
        Names, limits and masses.
    base
        Pose (4, 4) of the base frame in the frame `world` of the file (that of an instrument, say) [m]; the identity
        if none.

    Returns
    -------
    str
        The file's text: links `world`, `base_link`, `link_1` … and `flange`; fixed joints `base_joint` and
        `flange_joint` (pinocchio finds a frame by name only if no joint has the same).
        Numbers have all their digits. Source: the URDF specification; each link's frame lies on its joint's axis,
        Lynch & Park, Modern Robotics, section 4.2.

    Raises
    ------
    DescriptionError
        If the screws are not n, or one is neither revolute nor prismatic.
    """
    S, home = np.asarray(screws, dtype=np.float64), np.asarray(home, dtype=np.float64)
    if S.shape != (robot.n, 6):
        raise DescriptionError(f"{robot.name}: expected screws of shape ({robot.n}, 6), found {S.shape}")
    name = re.sub(r"\W+", "_", robot.name)
    lines = ['<?xml version="1.0"?>', f'<robot name="{name}">', '  <link name="world"/>', '  <link name="base_link"/>']
    lines += _fixed(
        "base_joint", "world", "base_link", np.eye(4) if base is None else np.asarray(base, dtype=np.float64)
    )
    parent, last = "base_link", np.zeros(3)
    for i, (joint, screw) in enumerate(zip(robot.joints, S, strict=True), 1):
        child, (kind, axis, point) = f"link_{i}", _axis_and_point(joint, screw, last)
        lines += _link(child, robot.links[i - 1] if robot.has_masses else None, point)
        endless = not np.isfinite([joint.lower, joint.upper]).all()
        limits = "" if endless else f'lower="{joint.lower!r}" upper="{joint.upper!r}" '
        lines += [
            f'  <joint name={quoteattr(joint.name)} type="{"continuous" if endless and kind == "revolute" else kind}">',
            f'    <parent link="{parent}"/>',
            f'    <child link="{child}"/>',
            f'    <origin xyz="{_numbers(point - last)}" rpy="0 0 0"/>',
            f'    <axis xyz="{_numbers(axis)}"/>',
            f'    <limit {limits}effort="{joint.rated_torque or 0.0!r}" velocity="{joint.max_speed or 0.0!r}"/>',
            "  </joint>",
        ]
        parent, last = child, point
    flange = home.copy()
    flange[:3, 3] -= last
    lines += ['  <link name="flange"/>', *_fixed("flange_joint", parent, "flange", flange), "</robot>", ""]
    return "\n".join(lines)


def _axis_and_point(joint: Joint, S: Array, last: Array) -> tuple[str, Array, Array]:
    """Give the kind, the axis and a point on it; a slide has no place of its own and stays at the last joint's."""
    w, v = S[:3], S[3:]
    if joint.kind == "prismatic":
        return "prismatic", v, last
    pitch = float(w @ v) / float(w @ w)
    if abs(pitch) > _PITCH:
        raise DescriptionError(f"{joint.name}: URDF has no helical joint, found a pitch of {pitch:.3g} m/rad")
    # Of the axis' points, the one nearest to the nominal point keeps the written file readable.
    foot = np.cross(w, v) / float(w @ w)
    return "revolute", w, foot + w * float(w @ (joint.point - foot)) / float(w @ w)


def _numbers(values: Array) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)


def _fixed(name: str, parent: str, child: str, T: Array) -> list[str]:
    return [
        f'  <joint name="{name}" type="fixed">',
        f'    <parent link="{parent}"/>',
        f'    <child link="{child}"/>',
        f'    <origin xyz="{_numbers(T[:3, 3])}" rpy="{_numbers(roll_pitch_yaw(T[:3, :3]))}"/>',
        "  </joint>",
    ]


def _link(name: str, link: Link | None, origin: Array) -> list[str]:
    if link is None or link.mass == 0:
        return [f'  <link name="{name}"/>']
    inertia = np.zeros((3, 3)) if link.inertia is None else link.inertia
    entries = (("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2))
    return [
        f'  <link name="{name}">',
        "    <inertial>",
        f'      <origin xyz="{_numbers(link.com - origin)}" rpy="0 0 0"/>',
        f'      <mass value="{link.mass!r}"/>',
        "      <inertia " + " ".join(f'{key}="{float(inertia[i, j]) + 0.0!r}"' for key, i, j in entries) + "/>",
        "    </inertial>",
        "  </link>",
    ]
