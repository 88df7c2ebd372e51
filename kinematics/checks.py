"""Checks of a robot description: every message names the item, what was expected and what was found."""

import numpy as np

from kinematics import dh, poe
from kinematics.escaping import has_controls
from kinematics.robot import DescriptionError, Joint, RobotDescription
from kinematics.screws import prismatic_screw, screw
from kinematics.typing_ import Array

__all__ = ["validate"]

_UNIT = 1e-9  # tolerance of lengths and rotations that are typed in
_AGREE = 1e-9  # a printed DH table and the axes describe the same nominal robot [m, or rad]


LONGEST_NAME = 200  # characters


def validate(robot: RobotDescription) -> RobotDescription:
    """
    Refuse a description that contradicts itself.

    Parameters
    ----------
    robot
        The description.

    Returns
    -------
    RobotDescription
        The same, so that a call can be wrapped around its making.

    Raises
    ------
    DescriptionError
        With the robot, the place, what was expected and what was found.
    """
    try:
        if not robot.joints:
            raise DescriptionError("expected at least one joint, found none")
        names = [joint.name for joint in robot.joints]
        for text in (robot.name, robot.title, *names):
            if not isinstance(text, str) or has_controls(text) or len(text) > LONGEST_NAME:
                raise DescriptionError(f"expected names of printable text on one line, found {str(text)[:80]!r}")
        if len(set(names)) < len(names):
            raise DescriptionError(f"expected joints of different names, found {names}")
        for i, joint in enumerate(robot.joints):
            _check_joint(f"joint {i + 1} ({joint.name})", joint)
        _check_rigid("flange", robot.flange)
        _check_links(robot)
        _check_transmission(robot)
        if robot.dh is not None:
            _check_dh(robot, robot.dh)
    except DescriptionError as error:
        raise DescriptionError(f"robot {robot.name}: {error}") from None
    return robot


def _check_vector(what: str, value: Array, shape: tuple[int, ...]) -> None:
    if value.shape != shape or not np.all(np.isfinite(value)):
        raise DescriptionError(f"{what}: expected finite numbers of shape {shape}, found {value.tolist()}")


def _check_joint(where: str, joint: Joint) -> None:
    if joint.kind not in ("revolute", "prismatic", "helical"):
        raise DescriptionError(f"{where}: expected kind revolute, prismatic or helical, found {joint.kind!r}")
    _check_vector(f"{where}, axis", joint.axis, (3,))
    _check_vector(f"{where}, point", joint.point, (3,))
    length = float(np.linalg.norm(joint.axis))
    if abs(length - 1) > _UNIT:
        raise DescriptionError(
            f"{where}, axis: expected a vector of length 1, found length {length:.9g} of {joint.axis.tolist()}"
        )
    if (joint.kind == "helical") != (joint.pitch != 0.0):
        raise DescriptionError(f"{where}, pitch: expected zero except for helical joints, found {joint.pitch!r}")
    if not joint.lower < joint.upper:
        raise DescriptionError(f"{where}, limits: expected lower < upper, found {joint.lower!r} and {joint.upper!r}")
    for what, value in (("maximum speed", joint.max_speed), ("rated torque", joint.rated_torque)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise DescriptionError(f"{where}, {what}: expected a positive number, found {value!r}")


def _check_rigid(what: str, T: Array) -> None:
    _check_vector(what, T, (4, 4))
    R = T[:3, :3]
    error = float(np.abs(R.T @ R - np.eye(3)).max())
    if error > _UNIT or np.linalg.det(R) < 0 or not np.array_equal(T[3], (0.0, 0.0, 0.0, 1.0)):
        raise DescriptionError(
            f"{what}: expected a rigid transform (a right-handed rotation, last row 0 0 0 1), found {T.tolist()}"
        )


def _check_links(robot: RobotDescription) -> None:
    if len(robot.links) not in (0, robot.n):
        raise DescriptionError(f"links: expected none or {robot.n}, one per joint, found {len(robot.links)}")
    for i, link in enumerate(robot.links):
        where = f"link {i + 1}"
        # Zero is allowed: a wrist whose links are lumped into the one before them has nothing left.
        if not (np.isfinite(link.mass) and link.mass >= 0):
            raise DescriptionError(f"{where}, mass: expected a number of kg, not negative, found {link.mass!r}")
        _check_vector(f"{where}, com", link.com, (3,))
        if link.inertia is not None:
            _check_vector(f"{where}, inertia", link.inertia, (3, 3))
            if not np.allclose(link.inertia, link.inertia.T) or np.linalg.eigvalsh(link.inertia).min() < 0:
                raise DescriptionError(f"{where}, inertia: expected a symmetric matrix without negative eigenvalue")
    if robot.links and sum(link.mass for link in robot.links) <= 0:
        raise DescriptionError("links: expected masses, found only zeros; leave the links out if they are unknown")


def _check_transmission(robot: RobotDescription) -> None:
    n = robot.n
    for what, matrix in (("transmission", robot.transmission), ("linkage", robot.linkage)):
        _check_vector(what, matrix, (n, n))
        scale = np.abs(matrix).max(axis=1, keepdims=True)
        if np.any(scale == 0) or np.linalg.cond(matrix / scale) > 1e9:
            raise DescriptionError(f"{what}: expected an invertible matrix, found {matrix.tolist()}")
    for i, ratio in enumerate(np.abs(np.diag(robot.transmission))):
        if not 0 < ratio <= 1:
            raise DescriptionError(
                f"transmission, diagonal entry {i + 1}: expected a reduction (joint turns per motor turn, at most 1), "
                f"found {robot.transmission[i, i]!r}; is the matrix the other way round?"
            )
    k = robot.motor_spring
    if k is not None and (k.shape != (n,) or not np.all(np.isfinite(k) & (k > 0))):
        raise DescriptionError(f"motor springs: expected {n} positive constants, found {k.tolist()}")


def _check_dh(robot: RobotDescription, table: dh.DHTable) -> None:
    """Compare axis by axis at the zero pose, so that the message can name the row; then everything at random poses."""
    if len(table.rows) != robot.n:
        raise DescriptionError(f"DH table: expected {robot.n} rows, one per joint, found {len(table.rows)}")
    _check_rigid("DH table, base", table.base)
    _check_rigid("DH table, tool", table.tool)
    frame = table.base
    for i, (row, joint) in enumerate(zip(table.rows, robot.joints, strict=True)):
        if row.sign not in (1, -1):
            raise DescriptionError(f"DH table, row {i + 1}: expected sign 1 or −1, found {row.sign!r}")
        axis = row.sign * frame[:3, 2]
        found = prismatic_screw(axis) if row.prismatic else screw(axis, frame[:3, 3])
        error = float(np.abs(found - joint.screw).max())
        if error > _AGREE:
            culprit = f"row {i + 1} (its sign) or row {i}" if i else "row 1 (its sign) or the base"
            raise DescriptionError(
                f"DH table, {culprit}: at the zero pose it turns joint {i + 1} ({joint.name}) by the screw "
                f"{np.round(found, 6).tolist()}, but the joint has {np.round(joint.screw, 6).tolist()}"
            )
        frame = frame @ dh.row_transform(row, 0.0)
    error = float(np.abs(frame @ table.tool - robot.flange).max())
    if error > _AGREE:
        raise DescriptionError(
            f"DH table, row {robot.n} or the tool: at the zero pose it ends {error:.3g} (m or rad) from the flange, at "
            f"{np.round(frame @ table.tool, 6).tolist()} instead of {np.round(robot.flange, 6).tolist()}"
        )
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (20, robot.n))
    error = float(np.abs(dh.forward(table, q) - poe.forward(robot.screws, robot.flange, q)).max())
    if error > 10 * _AGREE:
        raise DescriptionError(f"DH table: it differs from the joints by {error:.3g} (m or rad) at random poses")
