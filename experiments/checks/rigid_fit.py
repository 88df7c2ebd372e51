"""Fits base frame and targets so that nominal points lie on measured ones, by the sum of absolute residuals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.spatial.transform import Rotation

from experiments.checks.finding import Finding
from experiments.columns import QUATERNION
from kinematics.screws import nearest_rotation

__all__ = [
    "FEW_ROWS",
    "FLAT",
    "FloatArray",
    "RigidFit",
    "fit_rigid",
    "near_points",
    "orientation_findings",
    "spread_of",
]

FloatArray = npt.NDArray[np.float64]


# No arm reaches this multiple of the distance within which half of its points lie. A few such points are wrong rows,
# which are reported one by one, and no wrong unit.
FAR_OFF = 20.0


FEW_ROWS = 0.05


# Orientation errors of real arms are milliradians; the base frame adds a few more.
ORIENTATION_WRONG_RAD = 0.05


# Gauss–Newton converges in three or four steps from the closed-form frame; dropping bad rows takes a few more.
_ITERATIONS = 8


# Points on a line do not determine the base's rotation about the line, so a fit needs several starting rotations.
TURNS_TRIED = 12


# Thickness over extent: an error across the plane that only the thickness shows is twenty times larger.
FLAT = 0.05


def near_points(measured: FloatArray) -> npt.NDArray[np.bool_]:
    """The points (rows, 3) that are used: all but a few that are far from the rest."""
    off = np.linalg.norm(measured - np.median(measured, axis=0), axis=1)
    near = np.asarray(off <= FAR_OFF * np.median(off))
    return near if np.mean(near) >= 1.0 - FEW_ROWS else np.ones(len(near), dtype=bool)


def spread_of(points: FloatArray) -> float:
    """Root of the mean square of distances of points ``(rows, 3)`` from their middle, in metres."""
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))


@dataclass(frozen=True)
class RigidFit:
    """How nominal points lie on measured ones: distance (rows,) [m], base's turn, shift, offset of all targets."""

    distance: FloatArray
    base: FloatArray
    shift: FloatArray
    offset: FloatArray

    def place(self, pose: FloatArray, point: FloatArray) -> FloatArray:
        """Where a point of the flange at a pose (4, 4) should be measured (3,)."""
        return np.asarray(self.base @ (pose[:3, 3] + pose[:3, :3] @ (point + self.offset)) + self.shift)


def fit_rigid(poses: FloatArray, points: FloatArray, measured: FloatArray) -> RigidFit:
    """Fit nominal points to measured ones; wrong rows do not bias the fit.

    Fitted are the base frame and one offset common to all targets, since neither is known to better than centimetres
    on a real cell: first the frame in closed form, then both by Gauss–Newton. For points on a line the closed form does
    not determine the rotation about it: several are tried.
    """
    turn = poses[:, :3, :3]
    nominal = poses[:, :3, 3] + np.einsum("rij,rj->ri", turn, points)
    near = near_points(measured)
    here, there = nominal[near].mean(axis=0), measured[near].mean(axis=0)
    first = nearest_rotation(nominal[near] - here, measured[near] - there)
    _, extent, axes = np.linalg.svd(measured[near] - there)
    starts = [first]
    if len(extent) == 3 and extent[1] < FLAT * extent[0]:
        angles = 2.0 * np.pi / TURNS_TRIED * np.arange(1, TURNS_TRIED)
        starts += [Rotation.from_rotvec(angle * axes[0]).as_matrix() @ first for angle in angles]
    fits = [_descended(turn, nominal, measured, start, there - start @ here) for start in starts]
    return min(fits, key=lambda fit: float(np.median(fit.distance)))


def _descended(
    turn: FloatArray, nominal: FloatArray, measured: FloatArray, base: FloatArray, shift: FloatArray
) -> RigidFit:
    """The best frame and offset from a frame on, by Gauss–Newton over the rows that are not far off."""
    offset = np.zeros(3)
    for _ in range(_ITERATIONS):
        turned = (nominal + turn @ offset) @ base.T  # (rows, 3)
        error = measured - turned - shift
        distance = np.linalg.norm(error, axis=1)
        keep = distance <= 3.0 * np.median(distance) + 1e-9
        x, y, z = turned[keep].T
        o = np.zeros_like(x)
        rotation = np.stack([np.stack(row, -1) for row in ((o, z, -y), (-z, o, x), (y, -x, o))], -2)  # −[turned]×
        jacobian = np.concatenate([rotation, np.broadcast_to(np.eye(3), rotation.shape), base @ turn[keep]], axis=2)
        step = np.linalg.lstsq(jacobian.reshape(-1, 9), error[keep].ravel(), rcond=1e-10)[0]
        base = Rotation.from_rotvec(step[:3]).as_matrix() @ base
        shift, offset = shift + step[3:6], offset + step[6:]
    distance = np.linalg.norm(measured - (nominal + turn @ offset) @ base.T - shift, axis=1)
    return RigidFit(np.asarray(distance), base, shift, offset)


def orientation_findings(table: str, frame: pd.DataFrame, poses: FloatArray, base: FloatArray) -> Iterator[Finding]:
    """Compare orientations in the base frame (3, 3) that the positions gave; the tool's own turn is left free.

    With a free base, components in the wrong order would not be noticed: every orthogonal map of quaternions is
    q → a·q·b or a·q*·b.
    """
    quaternion = frame[list(QUATERNION)].to_numpy(dtype=np.float64)
    scalar_last = Rotation.from_quat(quaternion[:, [1, 2, 3, 0]])  # scipy's own order
    readings = {
        "": scalar_last,
        "they fit as scalar last, the contract has the scalar first": Rotation.from_quat(quaternion),
        "they fit when inverted, the contract wants the flange in the instrument's frame": scalar_last.inv(),
    }
    nominal = Rotation.from_matrix(base @ poses[:, :3, :3])
    error = {}
    for words, measured in readings.items():
        tool = nominal.inv() * measured
        error[words] = float(np.median((tool.mean().inv() * tool).magnitude()))
    if error[""] > ORIENTATION_WRONG_RAD:
        best = min(error, key=lambda words: error[words])
        fits = error[best] < ORIENTATION_WRONG_RAD
        reason = best if fits else "order or sign of the components?"
        message = f"orientations differ from nominal by {error['']:.2g} rad (median) with any tool frame: {reason}"
        yield Finding("error" if fits else "warning", table, "qw", None, message)
