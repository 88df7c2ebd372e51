"""How much larger the noise of measured points is along one of the instrument's axes than along another.

An instrument's noise differs between the points of one visit, while what a model lacks, and where the robot comes to
rest, move them nearly alike. So the ratio is taken from how points of a visit scatter about their mean, or returns to a
point about theirs where each visit has one point: a sag that the model lacks is then no noise in z. Logarithms of the
squares are compared, group by group, so that a few wrong rows do not set the ratio. If Hotelling's T² test does not
reject equal axes at the level 0.001, the noise is taken as the same along all.

Source: Hotelling, The generalization of Student's ratio, Annals of Mathematical Statistics 2, 1931.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from clampid.stages.rows import Array, Integers, Rows

__all__ = ["relative_axes"]

ANISOTROPY_FALSE_ALARMS = 1e-3  # of isotropic noise taken for another
GROUPS = 20  # at least
AXES = 3
TINY = 1e-30


def relative_axes(rows: Rows, residual: Array) -> Array:
    """Noise along the rows' axes ``(3,)`` over its rms of all three: ones where rows do not separate them.

    Parameters
    ----------
    rows
        Of poses.
    residual
        ``(N, m)``, measured less predicted, m.
    """
    level = np.ones(AXES)
    known = rows.used[:, :AXES].all(axis=1)
    white = (rows.in_noise_axes(residual)[:, :AXES] / rows.sigma[:, :AXES])[known]
    squares, freedom = _scatter(white, _groups(rows)[known])
    if len(squares) < GROUPS:
        return level
    logs = np.log(squares + TINY)
    contrast = logs[:, : AXES - 1] - logs.mean(axis=1, keepdims=True)
    mean, spread = contrast.mean(axis=0), np.cov(contrast.T) / len(contrast)
    hotelling = float(mean @ np.linalg.pinv(spread) @ mean) * (len(logs) - AXES + 1) / ((len(logs) - 1) * (AXES - 1))
    if stats.f.sf(hotelling, AXES - 1, len(logs) - AXES + 1) > ANISOTROPY_FALSE_ALARMS:
        return level
    ratio = np.exp(logs.mean(axis=0) - logs.mean())
    # What groups have in common, the robot's repeatability and what the model lacks, is taken to be alike in all axes.
    share = min(float(squares.sum() / freedom / AXES / max(np.mean(white**2), TINY)), 1.0)
    return np.asarray(np.sqrt(1.0 - share + share * ratio / ratio.mean()))


def _groups(rows: Rows) -> Integers:
    """Groups ``(N,)`` of rows in which the same is measured by the same model: visits, or returns to a point."""
    if len(np.unique(rows.unit)) <= 0.5 * len(rows):
        return rows.unit
    same = np.c_[rows.session, rows.fold, rows.signals["target_is"]]
    return np.asarray(np.unique(same, axis=0, return_inverse=True)[1].ravel(), dtype=np.int64)


def _scatter(white: Array, group: Integers) -> tuple[Array, int]:
    """Squares about the mean of each group of more than one row ``(G, 3)``, and their degrees of freedom an axis."""
    _, group, count = np.unique(group, return_inverse=True, return_counts=True)
    sums = np.column_stack([np.bincount(group, column) for column in white.T])
    off = (white - (sums / count[:, None])[group]) ** 2
    squares = np.column_stack([np.bincount(group, column) for column in off.T])[count > 1]
    return np.asarray(squares, dtype=float), int((count[count > 1] - 1).sum())
