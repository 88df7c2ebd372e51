"""
Denavit–Hartenberg tables: base · A_1 ⋯ A_n · tool is the flange.

    A_i = Rz(sign·q_i + theta_offset) · Tz(d) · Tx(a) · Rx(alpha) · Ry(beta)

A row with beta = 0 is standard (Denavit & Hartenberg 1955). A row with d = 0 and beta free is Hayati's, for an axis
that is nearly parallel to the next one, where d of a standard row grows without bound (Hayati 1985). A prismatic
joint adds its value to d instead. The conversions from and to screws are in `kinematics.dh_conversion`.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from kinematics.screws import transform
from kinematics.typing_ import Array, frozen_array

__all__ = ["Convention", "DHRow", "DHTable", "forward", "row_transform"]

Convention = Literal["standard", "hayati"]


@dataclass(frozen=True)
class DHRow:
    """
    One row of a table.

    Attributes
    ----------
    sign
        +1 or −1: the sense in which the joint value enters.
    theta_offset, alpha, beta
        [rad].
    d, a
        [m].
    prismatic
        Whether the joint value is added to d instead of the angle.
    """

    sign: int
    theta_offset: float
    d: float
    a: float
    alpha: float
    beta: float = 0.0
    prismatic: bool = False


@dataclass(frozen=True, eq=False)
class DHTable:
    """
    A table with the constant transforms before and behind it.

    Attributes
    ----------
    rows
        One row per joint.
    base
        Pose (4, 4) of the frame of the first row in the base frame [m].
    tool
        Pose (4, 4) of the flange in the frame of the last row [m].
    convention
        "standard" if beta is zero everywhere by definition, else "hayati".
    """

    rows: tuple[DHRow, ...]
    base: Array = field(default_factory=lambda: np.eye(4))
    tool: Array = field(default_factory=lambda: np.eye(4))
    convention: Convention = "standard"

    def __post_init__(self) -> None:
        object.__setattr__(self, "base", frozen_array(self.base))
        object.__setattr__(self, "tool", frozen_array(self.tool))


def row_transform(row: DHRow, q: npt.ArrayLike) -> Array:
    """
    Give A_i of one row.

    Parameters
    ----------
    row
        The row.
    q
        Values of its joint (...,) [rad, or m].

    Returns
    -------
    Array
        Transforms (..., 4, 4) [m]. Source: the module's docstring.
    """
    q = row.sign * np.asarray(q, dtype=np.float64)
    theta = np.full_like(q, row.theta_offset) if row.prismatic else q + row.theta_offset
    d = q + row.d if row.prismatic else np.full_like(q, row.d)
    c, s = np.cos(theta), np.sin(theta)
    Rz = np.zeros((*q.shape, 3, 3))
    Rz[..., 0, 0] = Rz[..., 1, 1] = c
    Rz[..., 1, 0], Rz[..., 0, 1], Rz[..., 2, 2] = s, -s, 1.0
    ca, sa, cb, sb = np.cos(row.alpha), np.sin(row.alpha), np.cos(row.beta), np.sin(row.beta)
    Rx = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    Ry = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    return transform(Rz @ (Rx @ Ry), np.stack([c * row.a, s * row.a, d], axis=-1))


def forward(table: DHTable, q: npt.ArrayLike) -> Array:
    """
    Give the pose of the flange by a table.

    Parameters
    ----------
    table
        The table of n rows.
    q
        Joint values (..., n) [rad, or m].

    Returns
    -------
    Array
        Poses in the base frame (..., 4, 4) [m]. Source: the module's docstring.

    Raises
    ------
    ValueError
        If there is not one value per row.
    """
    q = np.asarray(q, dtype=np.float64)
    if q.ndim < 1 or q.shape[-1] != len(table.rows):
        raise ValueError(f"q: expected shape (..., {len(table.rows)}), one value per row, found {q.shape}")
    T = np.broadcast_to(table.base, (*q.shape[:-1], 4, 4))
    for i, row in enumerate(table.rows):
        T = T @ row_transform(row, q[..., i])
    return np.asarray(T @ table.tool)
