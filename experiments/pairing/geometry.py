"""How far paired points are from a rigid body on the nominal arm.

Of ``p = t + R (f + F c)`` (flange at ``f`` with orientation ``F``) the base ``R, t`` and the target ``c`` are free, so
that neither has to be known. Points far off weigh little, so that they do not draw the fit to themselves.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["MIN_CONFIRMED", "OUTLIER", "rigid_residuals"]

FloatArray = npt.NDArray[np.float64]
Array = npt.NDArray[np.floating[Any]]

MIN_CONFIRMED = 12  # pairs, of 9 unknowns in 36 equations
OUTLIER = 8.0  # medians: 12 standard deviations of an axis; errors of an uncalibrated arm are not normal
PAIRING_ROUNDS = 60


def rigid_residuals(points: FloatArray, flanges: FloatArray) -> FloatArray:
    """Distances ``(P,)`` m of points from where a rigid body on the flange would carry them.

    Parameters
    ----------
    points
        ``(P, 3)`` m, in any frame.
    flanges
        ``(P, 4, 4)``: the flange in the base frame.
    """
    f, F = flanges[:, :3, 3], flanges[:, :3, :3]
    c: Array = np.zeros(3)
    weight: Array = np.ones(len(points))
    off: Array = np.zeros(len(points))
    for _ in range(PAIRING_ROUNDS):
        carried = f + F @ c
        R, t = _rigid(carried, points, weight)
        back = (points - t) @ R - f  # F c should be this
        root = np.sqrt(weight)
        A = (root[:, None, None] * F).reshape(-1, 3)
        # With the base's shift free as well: the target and it go together where the orientation hardly changes.
        A = np.hstack([A, np.repeat(root, 3)[:, None] * np.tile(np.eye(3), (len(points), 1))])
        c = np.linalg.lstsq(A, (root[:, None] * back).ravel(), rcond=None)[0][:3]
        carried = f + F @ c
        R, t = _rigid(carried, points, weight)
        off = np.linalg.norm(points - carried @ R.T - t, axis=1)
        weight = 1.0 / (1.0 + (off / max(float(np.median(off)), 1e-12) / 2) ** 2) ** 2
    return np.asarray(off, dtype=np.float64)


def _rigid(a: Array, b: Array, weight: Array) -> tuple[Array, Array]:
    """Rotation and translation that take ``a`` to ``b`` (Kabsch 1976)."""
    w = weight / weight.sum()
    ma, mb = w @ a, w @ b
    U, _, Vt = np.linalg.svd((w[:, None] * (a - ma)).T @ (b - mb))
    D = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(U @ Vt)))])
    R = Vt.T @ D @ U.T
    return R, mb - R @ ma
