"""Locates an anchor from its distances to points of roughly known places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

__all__ = ["Located", "locate"]

FloatArray = npt.NDArray[np.float64]

ROUGH_M = 2e-3  # by which points of an arm out of calibration are off: beyond, an error counts by its size alone
FEWEST_POINTS = 8  # points: twice as many as numbers of a place and a constant
STARTS_REFINED = 4  # of the starts, those that fit best


@dataclass(frozen=True)
class Located:
    """An anchor located from distances.

    Attributes
    ----------
    place
        ``(3,)`` m, in the frame of the points.
    error
        ``(N,)`` m: measured less calculated distances, the constant apart.
    spread
        ``(3,)``, ascending: how the directions from the anchor to the points spread, 0 to 1; the first is near zero
        where all lie in a plane through the anchor, so its place across that plane is hardly identifiable.
    mirrored
        ``(3,)`` m: another place that fits as well, as of points in a plane; else None.
    constant
        m: a common error of all distances, if it is significant; else 0. Rough, as the points are.
    """

    place: FloatArray
    error: FloatArray
    spread: FloatArray
    mirrored: FloatArray | None
    constant: float = 0.0

    @property
    def size(self) -> float:
        """The median error, m."""
        return float(np.median(np.abs(self.error)))


def locate(points: FloatArray, distances: FloatArray) -> Located:
    """Locate an anchor by lateration.

    The squared distances are linear in the place and its square, which gives a start without a guess. Points in a plane
    leave two places, so both sides of the plane are tried and the better one is taken. Beyond two millimetres errors
    count by their size, not its square, so wrong rows do not decide.

    Parameters
    ----------
    points
        ``(N, 3)`` m, N >= 1.
    distances
        ``(N,)`` m.

    Returns
    -------
    Located
        With fewer than three points, one of the places that the distances leave.
    """
    middle = points.mean(axis=0)
    off = points - middle
    axes = np.linalg.svd(off, full_matrices=True)[2]
    starts = sorted(_starts(off, distances, axes, middle), key=lambda at: _misfit(at, points, distances))
    searched = [_search(points, distances, start) for start in starts[:STARTS_REFINED]]
    searched.sort(key=lambda found: found[0])
    cost, place = searched[0]
    constant, place = _with_constant(points, distances, place)
    error = _errors(place, points, distances) - constant
    unit = _towards(place, points)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(unit.T @ unit / len(unit)), 0.0))
    width = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    alike = [
        at for value, at in searched[1:] if value < 2.0 * cost + 1e-12 and np.linalg.norm(at - place) > 0.1 * width
    ]
    return Located(place, error, spread, alike[0] if alike else None, constant)


def _starts(off: FloatArray, distances: FloatArray, axes: FloatArray, middle: FloatArray) -> list[FloatArray]:
    """The linear solution, and of it and of the mean distance straight off the points' plane either side."""
    A = np.c_[-2.0 * off, np.ones(len(off))]
    b = distances**2 - np.sum(off**2, axis=1)
    scale = np.maximum(np.linalg.norm(A, axis=0), 1e-12)
    linear = (np.linalg.lstsq(A / scale, b, rcond=1e-6)[0] / scale)[:3]
    normal = axes[2]
    flat = linear - (linear @ normal) * normal
    height = np.sqrt(max(float(np.median(distances)) ** 2 - float(flat @ flat), 0.0))
    straight = float(np.median(distances)) * axes
    starts = [linear, flat + height * normal, flat - height * normal, *straight, *-straight]
    return [middle + start for start in starts]


def _search(points: FloatArray, distances: FloatArray, start: FloatArray) -> tuple[float, FloatArray]:
    """The place, or place and constant if the start ``(3,)`` or ``(4,)`` has one, that fits best; and the cost, m^2."""

    def errors(at: FloatArray) -> FloatArray:
        return np.asarray(_errors(at[:3], points, distances) - at[3:].sum())

    found = least_squares(errors, start, lambda at: _slopes(at, points), loss="soft_l1", f_scale=ROUGH_M, max_nfev=200)
    return float(found.cost), np.asarray(found.x)


def _with_constant(points: FloatArray, distances: FloatArray, place: FloatArray) -> tuple[float, FloatArray]:
    """Constant and place with it, if the constant is significant against the residuals; else 0."""
    if len(points) < FEWEST_POINTS:
        return 0.0, place
    _, found = _search(points, distances, np.r_[place, 0.0])
    constant = float(found[3])
    left = float(np.quantile(np.abs(_errors(found[:3], points, distances) - constant), 0.95))
    lever = np.linalg.pinv(_slopes(found, points))[3]
    most = max(left, ROUGH_M) * float(np.abs(lever).sum())  # an arm's errors are systematic
    return (constant, found[:3]) if abs(constant) > most else (0.0, place)


def _slopes(at: FloatArray, points: FloatArray) -> FloatArray:
    """Derivatives ``(N, 3)`` of the errors by the place; ``(N, 4)`` by place and constant if ``at`` has one."""
    return np.asarray(np.c_[_towards(at[:3], points), -np.ones((len(points), len(at) - 3))])


def _towards(place: FloatArray, points: FloatArray) -> FloatArray:
    """Unit vectors ``(N, 3)`` from a place to the points."""
    away = points - place
    return np.asarray(away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12))


def _misfit(place: FloatArray, points: FloatArray, distances: FloatArray) -> float:
    return float(np.median(np.abs(_errors(place, points, distances))))


def _errors(place: FloatArray, points: FloatArray, distances: FloatArray) -> FloatArray:
    return np.asarray(distances - np.linalg.norm(points - place, axis=1))
