"""Numbers of poses and visits, and directions of approach, where files do not have them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["SAME_POSE_RAD", "directions", "postures", "returns"]

FloatArray = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

# Returns to a pose agree within the robot's repeatability, 1e-4 rad or less; 1e-2 rad is 10 mm at 1 m, another pose.
SAME_POSE_RAD = 1e-2
# A joint that is not told to move holds its place within its encoder's noise, far below this.
MOVED_RAD = 1e-3


def postures(angles: FloatArray) -> Integers:
    """Numbers ``(rows,)`` from 1 of postures ``(rows, n)``, in the order in which they first come."""
    known: list[FloatArray] = []
    out = np.empty(len(angles), dtype=np.int64)
    for row, q in enumerate(angles):
        near = np.abs(np.array(known) - q).max(axis=1) <= SAME_POSE_RAD if known else np.zeros(0, dtype=bool)
        if not near.any():
            known.append(q)
        out[row] = int(np.flatnonzero(near)[0]) + 1 if near.any() else len(known)
    return out


def returns(poses: Integers) -> Integers:
    """Visits ``(rows,)`` from 1: each time that a pose comes again after another one is one more visit."""
    out, count = np.empty(len(poses), dtype=np.int64), dict.fromkeys(poses.tolist(), 0)
    for row, pose in enumerate(poses.tolist()):
        if row == 0 or pose != poses[row - 1]:
            count[pose] += 1
        out[row] = count[pose]
    return out


def directions(angles: FloatArray) -> Integers:
    """Directions ``(rows, n)`` in which joints last moved to postures ``(rows, n)`` gone to one after the other.

    Each joint goes straight from one to the next. 0 until a joint has moved.
    """
    out = np.zeros(angles.shape, dtype=np.int64)
    for row in range(1, len(angles)):
        step = angles[row] - angles[row - 1]
        out[row] = np.where(np.abs(step) > MOVED_RAD, np.sign(step), out[row - 1])
    return out
