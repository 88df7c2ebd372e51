"""
An arm as KUKA machine data have it: a few lengths, frames and the mastering of its axes.

An articulated arm (`#NR`) with a central hand (`#ZEH`) is, in the words of the machine data, with F(frame) the pose of
a frame {X, Y, Z, A, B, C} (R = Rz(A)·Ry(B)·Rx(C)) and a_i = $AXIS_DIR[i]·(q_i + m_i)::

    F($ROBROOT) F($TIRORO) Rz(a1) Tx($LENGTH_A) Ry(a2) Tx($LENGTH_B) Ry(a3) F($TX3P3)
        Rz(a4) D($DH_4) Rz(a5) D($DH_5) Rz(a6) F($TFLWP),        D = Tz(DHART_D) Tx(DHART_A) Rx(DHART_ALPHA).

m_i is what has to be added to the mastering position $MAMES[i]. Axes 1 and 2 are perpendicular, 2 and 3 parallel, and
the wrist's axes perpendicular and through one point: with anything else the controller's inverse has no closed form.

Source: KUKA Roboter GmbH, *KR C2 operating handbook: Machine Data* (KUKA2005), 2.1.7, 2.1.8, 2.1.146 and 2.1.155 to
2.1.161 with figure 18. The handbook does not write the product out; that the data of a KR 210 R2700, as its controller
has them, give that robot's axes and flange by it is tested (tests/kinematics/test_kuka.py).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinematics.fixed_angles import roll_pitch_yaw, rotation_of
from kinematics.robot import RobotDescription
from kinematics.screws import inverse, transform
from kinematics.typing_ import Array, frozen_array

__all__ = [
    "AXES",
    "Hand",
    "MachineData",
    "MachineDataError",
    "forward",
    "frame",
    "frame_numbers",
    "nominal_machine_data",
]

AXES = 6
_QUARTER = np.pi / 2
_NOMINAL = 1e-9  # m and rad: how well a nominal robot has to keep to the form


class MachineDataError(ValueError):
    """A robot that this form cannot describe, or a file that does not hold it."""


@dataclass(frozen=True)
class Hand:
    """One row of the wrist, `DHART`: lengths a and d [m] and angle alpha [rad]."""

    a: float
    d: float
    alpha: float


@dataclass(frozen=True, eq=False)
class MachineData:
    """
    The numbers of the form.

    Attributes
    ----------
    robroot
        $ROBROOT (6,): the robot's base in the world, (X, Y, Z) [m] and (A, B, C) [rad]; other frames alike.
    tiroro
        $TIRORO (6,): axis 1, at the height of axis 2, in the robot's base.
    length_a, length_b
        $LENGTH_A, axis 2 off axis 1, and $LENGTH_B, the link arm [m].
    tx3p3
        $TX3P3 (6,): the wrist's first frame, z along axis 4, in that of axis 3.
    dh_4, dh_5
        $DH_4 and $DH_5.
    tflwp
        $TFLWP (6,): the flange in the wrist's last frame.
    axis_dir
        $AXIS_DIR (6), +1 or -1.
    mastering
        To be added to $MAMES (6,) [rad]: the arm's angle less the controller's.
    """

    robroot: Array
    tiroro: Array
    length_a: float
    length_b: float
    tx3p3: Array
    dh_4: Hand
    dh_5: Hand
    tflwp: Array
    axis_dir: tuple[int, ...]
    mastering: Array

    def __post_init__(self) -> None:
        for name in ("robroot", "tiroro", "tx3p3", "tflwp", "mastering"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))


def frame(numbers: npt.ArrayLike) -> Array:
    """Give the pose (4, 4) [m] of a frame (X, Y, Z, A, B, C) [m, rad], R = Rz(A)·Ry(B)·Rx(C)."""
    numbers = np.asarray(numbers, dtype=np.float64)
    return transform(rotation_of(numbers[:2:-1]), numbers[:3])


def frame_numbers(T: npt.ArrayLike) -> Array:
    """Give the frame (X, Y, Z, A, B, C) [m, rad] of a pose (4, 4) [m]: the inverse of `frame`."""
    T = np.asarray(T, dtype=np.float64)
    return np.concatenate([T[:3, 3], roll_pitch_yaw(T[:3, :3])[::-1]])


def forward(data: MachineData, q: npt.ArrayLike) -> Array:
    """
    Give the pose of the flange by machine data.

    Parameters
    ----------
    data
        The machine data.
    q
        Joint angles of the controller (..., 6), before its mastering is changed [rad].

    Returns
    -------
    Array
        Poses (..., 4, 4) in the world [m]. Source: the module's docstring.

    Raises
    ------
    ValueError
        If there are not six values.
    """
    q = np.asarray(q, dtype=np.float64)
    if q.ndim < 1 or q.shape[-1] != AXES:
        raise ValueError(f"q: expected shape (..., {AXES}), found {q.shape}")
    angle = np.array(data.axis_dir) * (q + data.mastering)
    T = frame(data.robroot) @ frame(data.tiroro) @ _about("z", angle[..., 0]) @ _along_x(data.length_a)
    T = T @ _about("y", angle[..., 1]) @ _along_x(data.length_b) @ _about("y", angle[..., 2]) @ frame(data.tx3p3)
    for i, hand in ((3, data.dh_4), (4, data.dh_5)):
        T = T @ _about("z", angle[..., i]) @ transform(_about("x", np.array(hand.alpha))[:3, :3], [hand.a, 0.0, hand.d])
    return np.asarray(T @ _about("z", angle[..., 5]) @ frame(data.tflwp))


def nominal_machine_data(robot: RobotDescription) -> MachineData:
    """
    Give the machine data of a nominal robot; its base is the world.

    Parameters
    ----------
    robot
        The nominal robot.

    Returns
    -------
    MachineData
        The form that gives the same flange to rounding.

    Raises
    ------
    MachineDataError
        If it is not a six-axis arm with revolute joints whose axes are as the form has them; says which are not.
    """
    w, p = _lines(robot)
    x, y, z = _upright(robot, w)
    signs = [1 if w[0] @ z > 0 else -1, 1 if w[1] @ y > 0 else -1, 1 if w[2] @ y > 0 else -1]
    shoulder = p[0] + z * (z @ (p[1] - p[0]))
    length_a = float(x @ (p[1] - shoulder))
    arm = p[2] - p[1]
    arm = arm - y * (y @ arm)
    length_b = float(np.linalg.norm(arm))
    centre = _wrist_centre(w, p)
    signs.append(-1 if (centre - p[2]) @ w[3] < 0 else 1)
    forearm = signs[3] * w[3]
    angles = [0.0, float(np.arctan2(-arm @ z, arm @ x))]
    angles.append(float(np.arctan2(-forearm @ z, forearm @ x)) - angles[1])
    elbow = shoulder + length_a * x + arm
    third = np.stack([forearm, y, np.cross(forearm, y)], axis=-1)
    tx3p3 = np.array([*(third.T @ (centre - elbow)), 0.0, _QUARTER, 0.0])

    wrist = transform(third, elbow) @ frame(tx3p3)
    signs.append(-1 if w[4] @ wrist[:3, 1] > _NOMINAL else 1)
    across = wrist[:3, :3].T @ (signs[4] * w[4])
    angles.append(float(np.arctan2(across[0], -across[1])))
    wrist = wrist @ _about("z", np.array(angles[3])) @ _about("x", np.array(_QUARTER))
    signs.append(-1 if w[5] @ robot.flange[:3, 2] < 0 else 1)
    along = wrist[:3, :3].T @ (signs[5] * w[5])
    angles.append(float(np.arctan2(-along[0], along[1])))
    wrist = wrist @ _about("z", np.array(angles[4])) @ _about("x", np.array(-_QUARTER))
    mastering = np.array(signs) * np.array([*angles, 0.0])
    return MachineData(
        robroot=np.zeros(6),
        tiroro=_clean(frame_numbers(transform(np.stack([x, y, z], axis=-1), shoulder))),
        length_a=length_a,
        length_b=length_b,
        tx3p3=_clean(tx3p3),
        dh_4=Hand(0.0, 0.0, _QUARTER),
        dh_5=Hand(0.0, 0.0, -_QUARTER),
        tflwp=_clean(frame_numbers(inverse(wrist) @ robot.flange)),
        axis_dir=tuple(signs),
        mastering=_clean(np.pi - np.remainder(np.pi - mastering, 2 * np.pi)),
    )


def _lines(robot: RobotDescription) -> tuple[Array, Array]:
    """Directions and points (6, 3) of the axes, if the arm is one that the form can describe."""
    if robot.n != AXES or any(joint.kind != "revolute" for joint in robot.joints):
        kinds = ", ".join(joint.kind for joint in robot.joints)
        raise MachineDataError(f"{robot.name}: expected six revolute joints, found {robot.n}: {kinds}")
    if not np.array_equal(robot.linkage, np.eye(AXES)):
        raise MachineDataError(f"{robot.name}: its joints are coupled by a linkage, which this form does not describe")
    w, p = robot.screws[:, :3], np.cross(robot.screws[:, :3], robot.screws[:, 3:])
    faults = [
        f"axes {i + 1} and {k + 1} are {np.degrees(np.arccos(min(1.0, abs(w[i] @ w[k])))):.3g} degrees apart"
        for i, k, cosine in ((0, 1, 0.0), (1, 2, 1.0), (2, 3, 0.0), (3, 4, 0.0), (4, 5, 0.0))
        if abs(abs(w[i] @ w[k]) - cosine) > _NOMINAL
    ]
    if faults:
        raise MachineDataError(
            f"{robot.name}: expected an ortho-parallel arm (axis 2 perpendicular to 1 and parallel to 3, the others "
            f"perpendicular to the one before), found {'; '.join(faults)}"
        )
    return w, p


def _upright(robot: RobotDescription, w: Array) -> tuple[Array, Array, Array]:
    """Axes of $TIRORO: z up along axis 1, y along axis 2, x to the side where the flange is."""
    z = w[0] if w[0, 2] > -_NOMINAL else -w[0]
    y = w[1]
    if robot.flange[:3, 3] @ np.cross(y, z) < -_NOMINAL:
        y = -y
    return np.cross(y, z), y, z


def _wrist_centre(w: Array, p: Array) -> Array:
    """Where axes 4, 5 and 6 meet (3,) [m]."""
    normal = np.cross(w[3], w[4])
    centre = p[3] + w[3] * (np.cross(p[4] - p[3], w[4]) @ normal)
    for i in (4, 5):
        off = float(np.linalg.norm(np.cross(centre - p[i], w[i])))
        if off > _NOMINAL:
            raise MachineDataError(
                f"expected a central hand, axes 4, 5 and 6 through one point; axis {i + 1} is {1e3 * off:.3g} mm off it"
            )
    return np.asarray(centre)


def _clean(numbers: Array) -> Array:
    """Take rounding for zero, so that a nominal frame reads as it was meant."""
    return np.where(np.abs(numbers) < 1e-12, 0.0, numbers)


def _about(axis: str, angle: Array) -> Array:
    """Rotations (..., 4, 4) by angles (...) about one axis of a frame."""
    i, k = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    T = np.zeros((*angle.shape, 4, 4))
    T[..., :, :] = np.eye(4)
    T[..., i, i] = T[..., k, k] = np.cos(angle)
    T[..., k, i] = np.sin(angle)
    T[..., i, k] = -T[..., k, i]
    return T


def _along_x(length: float) -> Array:
    return transform(np.eye(3), [length, 0.0, 0.0])
