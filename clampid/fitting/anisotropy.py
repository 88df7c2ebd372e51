"""Anisotropy of the noise of measured points: ratios of its standard deviations along the instrument's axes.

An instrument's noise is independent between the points of one visit. A missing effect and the robot's repeatability
move these points nearly alike. The ratio is therefore taken from the scatter of a visit's points about their mean;
where each visit has one point, from the scatter of returns to it. A missing sag is then not mistaken for noise in z.
The logarithms of the squares are compared, group by group, so that a few wrong rows do not determine the ratio. If
Hotelling's T² test does not reject equal axes at the level 0.001, the noise is taken as isotropic.

Source: Hotelling, The generalization of Student's ratio, Annals of Mathematical Statistics 2, 1931.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from clampid.stages.rows import Array, Integers, Rows

__all__ = ["relative_axes", "scatter_in_groups"]

ANISOTROPY_FALSE_ALARMS = 1e-3  # chance that isotropic noise is taken as anisotropic
MIN_GROUPS = 20  # visits, or points with returns
AXES = 3
SMALLEST_SQUARE = 1e-30  # added before a logarithm, and the least divisor


def relative_axes(rows: Rows, residual: Array) -> Array:
    """Noise along each axis ``(3,)`` over its rms over the three; ones if the rows do not distinguish the axes.

    Parameters
    ----------
    rows
        Rows of poses.
    residual
        ``(N, m)``, measured less predicted, m.
    """
    level = np.ones(AXES)
    known = rows.used[:, :AXES].all(axis=1)
    white = (rows.in_noise_axes(residual)[:, :AXES] / rows.sigma[:, :AXES])[known]
    squares, freedom = scatter_in_groups(white, _groups(rows)[known])
    if len(squares) < MIN_GROUPS:
        return level
    logs = np.log(squares + SMALLEST_SQUARE)
    contrast = logs[:, : AXES - 1] - logs.mean(axis=1, keepdims=True)
    mean, spread = contrast.mean(axis=0), np.cov(contrast.T) / len(contrast)
    hotelling = float(mean @ np.linalg.pinv(spread) @ mean) * (len(logs) - AXES + 1) / ((len(logs) - 1) * (AXES - 1))
    if stats.f.sf(hotelling, AXES - 1, len(logs) - AXES + 1) > ANISOTROPY_FALSE_ALARMS:
        return level
    ratio = np.exp(logs.mean(axis=0) - logs.mean())
    # Errors common to a group (repeatability, missing effects) are assumed to be isotropic.
    share = min(float(squares.sum() / freedom / AXES / max(np.mean(white**2), SMALLEST_SQUARE)), 1.0)
    return np.asarray(np.sqrt(1.0 - share + share * ratio / ratio.mean()))


def _groups(rows: Rows) -> Integers:
    """Group numbers ``(N,)``: visits if most have several points, else returns to a point."""
    if len(np.unique(rows.unit)) <= 0.5 * len(rows):
        return rows.unit
    same = np.c_[rows.session, rows.fold, rows.signals["target_is"]]
    return np.asarray(np.unique(same, axis=0, return_inverse=True)[1].ravel(), dtype=np.int64)


def scatter_in_groups(errors: Array, group: Integers) -> tuple[Array, int]:
    """Sums of squares about the mean of each group of two rows or more ``(G, 3)``; degrees of freedom of each axis."""
    _, group, count = np.unique(group, return_inverse=True, return_counts=True)
    sums = np.column_stack([np.bincount(group, column) for column in errors.T])
    off = (errors - (sums / count[:, None])[group]) ** 2
    squares = np.column_stack([np.bincount(group, column) for column in off.T])[count > 1]
    return np.asarray(squares, dtype=float), int((count[count > 1] - 1).sum())
