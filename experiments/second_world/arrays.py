"""Types of arrays, seeded streams of random numbers, and rotations of many vectors at once."""

import zlib
from functools import cache

import numpy as np
import numpy.typing as npt

__all__ = ["Array", "exp_so3", "rpy_of", "rpy_rotation", "signed_log_normal", "stream", "unit"]

Array = npt.NDArray[np.float64]


def stream(seed: int, label: str) -> np.random.Generator:
    """
    Make the generator of random numbers that belongs to a seed and a purpose.

    Parameters
    ----------
    seed
        The seed of the robot or of the measurement.
    label
        What the numbers are for. Two purposes never share numbers, so that a hidden effect does not change the noise.

    Returns
    -------
    numpy.random.Generator
        The same in every process.
    """
    return np.random.default_rng([seed, zlib.crc32(label.encode())])


def unit(v: Array) -> Array:
    """Unit vectors along the last axis (..., 3)."""
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def exp_so3(v: Array) -> Array:
    """
    Rotation matrices of rotation vectors, by Rodrigues' formula.

    Parameters
    ----------
    v
        Rotation vectors (..., 3), rad.

    Returns
    -------
    Array
        Rotations (..., 3, 3).
    """
    if not v.any():  # most joints neither tilt nor turn
        return np.broadcast_to(np.eye(3), (*v.shape[:-1], 3, 3))
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    small = angle < 1e-9
    safe = np.where(small, 1.0, angle)
    K = np.zeros((*v.shape[:-1], 3, 3))
    K[..., 0, 1], K[..., 0, 2] = -v[..., 2], v[..., 1]
    K[..., 1, 0], K[..., 1, 2] = v[..., 2], -v[..., 0]
    K[..., 2, 0], K[..., 2, 1] = -v[..., 1], v[..., 0]
    first = np.where(small, 1.0, np.sin(safe) / safe)
    second = np.where(small, 0.5, 2.0 * (np.sin(safe / 2.0) / safe) ** 2)
    return np.asarray(np.eye(3) + first * K + second * (K @ K))


def rpy_rotation(rpy: Array) -> Array:
    """Rotation Rz(yaw)·Ry(pitch)·Rx(roll) (3, 3) of roll, pitch and yaw (3,), rad: the order of URDF."""
    return _rpy_rotation(*(float(angle) for angle in rpy))


@cache
def _rpy_rotation(roll: float, pitch: float, yaw: float) -> Array:
    x, y, z = np.eye(3)
    R = np.asarray(exp_so3(z * yaw) @ exp_so3(y * pitch) @ exp_so3(x * roll))
    R.flags.writeable = False  # the same one for all who ask
    return R


def rpy_of(R: Array) -> Array:
    """Roll, pitch and yaw (3,), rad, of a rotation (3, 3); at a pitch of ±90° the roll is set to zero."""
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    if abs(np.cos(pitch)) < 1e-9:
        return np.array([0.0, pitch, np.arctan2(-R[0, 1], R[1, 1])])
    return np.array([np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])


def signed_log_normal(
    rng: np.random.Generator, median: float, spread: float, low: float, high: float, shape: tuple[int, ...]
) -> Array:
    """
    Numbers whose size is log-normal within bounds and whose sign is even.

    Parameters
    ----------
    rng
        Source of the numbers.
    median, spread
        Median of the size, in its unit, and standard deviation of its logarithm.
    low, high
        Bounds of the size; what lies outside is moved to the bound.
    shape
        Shape of the result.

    Returns
    -------
    Array
        Numbers of that shape.
    """
    size = np.clip(median * np.exp(spread * rng.standard_normal(shape)), low, high)
    return np.asarray(size * rng.choice([-1.0, 1.0], size=shape))
