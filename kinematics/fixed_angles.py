"""Rotations as the three angles about fixed axes x, y, z in which robot descriptions and controllers give them."""

import numpy as np
import numpy.typing as npt

from kinematics.typing_ import Array

__all__ = ["roll_pitch_yaw", "rotation_of"]


def roll_pitch_yaw(R: npt.ArrayLike) -> Array:
    """
    Split a rotation into angles, R = Rz(yaw)·Ry(pitch)·Rx(roll), exactly even where pitch is ±90°.

    There yaw is ill-determined; pitch and roll are taken after undoing it, so that whatever it is, the three fit
    together.

    Parameters
    ----------
    R
        Rotation (3, 3).

    Returns
    -------
    Array
        Roll, pitch and yaw (3,) [rad]. Source: Lynch & Park, Modern Robotics, appendix B.1.1.
    """
    R = np.asarray(R, dtype=np.float64)
    yaw = np.arctan2(R[1, 0], R[0, 0]) if np.hypot(R[1, 0], R[0, 0]) > 1e-12 else 0.0
    c, s = np.cos(yaw), np.sin(yaw)
    M = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ R
    return np.array([np.arctan2(-M[1, 2], M[1, 1]), np.arctan2(-M[2, 0], M[0, 0]), yaw])


def rotation_of(rpy: npt.ArrayLike) -> Array:
    """
    Put a rotation together from its angles, R = Rz(yaw)·Ry(pitch)·Rx(roll): the inverse of `roll_pitch_yaw`.

    Parameters
    ----------
    rpy
        Roll, pitch and yaw (3,) [rad].

    Returns
    -------
    Array
        Rotation (3, 3). Source: Lynch & Park, Modern Robotics, appendix B.1.1.
    """
    (cx, cy, cz), (sx, sy, sz) = np.cos(rpy), np.sin(rpy)
    Rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    Ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    Rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(Rz @ Ry @ Rx)
