"""Positions and orientations as instruments write them: polar readings, Euler angles, quaternions, matrices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from experiments.foreign.units import to_si

__all__ = ["ORIENTATIONS", "POSITIONS", "Orientation", "Position", "euler_axes", "points", "quaternions"]

FloatArray = npt.NDArray[np.float64]

POSITIONS = ("spherical", "xyz")
ORIENTATIONS: dict[str, tuple[int, bool]] = {
    "kuka": (3, True),
    "euler": (3, True),
    "rotation_vector": (3, True),
    "quaternion_wxyz": (4, False),
    "quaternion_xyzw": (4, False),
    "matrix": (9, False),
}
"""Kind → how many columns, and whether they are angles."""
# Printed with three digits, a rotation's columns are of length one within this.
ROTATION_TOLERANCE = 2e-3


@dataclass(frozen=True)
class Position:
    """Columns of a position.

    ``spherical``: range, azimuth, elevation. The elevation counts from the horizon, or as a ``zenith`` angle from the
    vertical; the azimuth turns from x to y, or, as a theodolite's, ``clockwise``. ``xyz``: x, y, z.
    """

    kind: str
    columns: tuple[str | int, ...]
    length: str
    angle: str
    zenith: bool
    clockwise: bool
    key: str


@dataclass(frozen=True)
class Orientation:
    """Columns of an orientation, that of the flange in the instrument's frame or its ``inverse``.

    ``kuka``: A, B, C, that is ``euler`` with the axes ZYX. ``euler``: angles in the order of ``axes``; capitals turn
    about the axes as they are by then, small letters about fixed ones. ``rotation_vector``: axis times angle.
    ``matrix``: nine columns, row by row.
    """

    kind: str
    columns: tuple[str | int, ...]
    axes: str
    unit: str
    inverse: bool
    key: str


def euler_axes(axes: str) -> bool:
    """Whether these are axes of Euler angles: three letters, no two neighbours equal, all capital or all small."""
    return (
        len(axes) == 3
        and (set(axes) <= set("xyz") or set(axes) <= set("XYZ"))
        and axes[0] != axes[1]
        and axes[1] != axes[2]
    )


def points(position: Position, numbers: FloatArray) -> FloatArray:
    """Points ``(rows, 3)`` m from the numbers of their columns ``(rows, 3)``."""
    if position.kind == "xyz":
        return to_si(numbers, position.length)
    r = to_si(numbers[:, 0], position.length)
    azimuth, elevation = to_si(numbers[:, 1:], position.angle).T
    azimuth = -azimuth if position.clockwise else azimuth
    elevation = np.pi / 2 - elevation if position.zenith else elevation
    level = r * np.cos(elevation)
    return np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), r * np.sin(elevation)])


def quaternions(orientation: Orientation, numbers: FloatArray) -> tuple[FloatArray, npt.NDArray[np.bool_], str]:
    """Unit quaternions ``(rows, 4)``, scalar first and not negative.

    Returns
    -------
    quaternions
        Meaningless in rows that are wrong.
    wrong
        ``(rows,)``: no rotation.
    expected
        What such a row should have been.
    """
    wrong, expected = np.zeros(len(numbers), dtype=bool), ""
    match orientation.kind:
        case "matrix":
            matrix = numbers.reshape(-1, 3, 3)
            off = np.abs(matrix @ np.swapaxes(matrix, 1, 2) - np.eye(3)).max(axis=(1, 2))
            wrong = (off > ROTATION_TOLERANCE) | (np.linalg.det(matrix) < 0)
            expected = "a rotation matrix (orthogonal, right-handed)"
            rotation = Rotation.from_matrix(np.where(wrong[:, None, None], np.eye(3), matrix))
        case "quaternion_wxyz" | "quaternion_xyzw":
            last = numbers[:, [1, 2, 3, 0]] if orientation.kind == "quaternion_wxyz" else numbers
            wrong = np.abs(np.linalg.norm(last, axis=1) - 1.0) > ROTATION_TOLERANCE
            expected = "a unit quaternion"
            rotation = Rotation.from_quat(np.where(wrong[:, None], [0.0, 0.0, 0.0, 1.0], last))
        case "rotation_vector":
            rotation = Rotation.from_rotvec(to_si(numbers, orientation.unit))
        case kind:
            axes = "ZYX" if kind == "kuka" else orientation.axes
            rotation = Rotation.from_euler(axes, to_si(numbers, orientation.unit))
    rotation = rotation.inv() if orientation.inverse else rotation
    return rotation.as_quat(canonical=True)[:, [3, 0, 1, 2]], wrong, expected
