"""Formulas of ISO 9283 for how well a robot reaches a place, and errors split about a sample.

Attained positions x_j of one command, from one side, with barycentre x̄ and l_j = |x_j − x̄|::

    AP  = |x̄ − x_c|                                pose accuracy, unidirectional
    RP  = l̄ + 3 S_l                                pose repeatability, S_l² = Σ (l_j − l̄)² / (n − 1)
    vAP = max over sides h, k of |x̄_h − x̄_k|       multi-directional variation of pose accuracy
    dAP = max over t of |AP_1 − AP_t|               drift, over cycles in the order of time; dRP likewise

and of orientations, about each axis by itself: |ā − a_c|, 3 S_a, max |ā_h − ā_k|. RP of returns from all sides together
is called bidirectional here, after machine tools (ISO 230-2); ISO 9283 has it from one side only.

Source: ISO 9283:1998, 7.2.1 (AP), 7.2.2 (RP), 7.2.3 (vAP), 7.6 (drift). The universal model's P̄, σ_P and P_max are
mean, standard deviation and maximum of the errors' norms. :mod:`experiments.measures.iso9283` takes them over a table.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

__all__ = [
    "accuracy",
    "angle_accuracy",
    "angle_repeatability",
    "angle_variation",
    "drift",
    "norm_metrics",
    "repeatability",
    "split_about",
    "variation",
]

Array = npt.NDArray[np.float64]


def accuracy(attained: Array, command: Array) -> Array:
    """AP ``(...)``, m: how far the barycentre of attained positions ``(..., n, 3)`` is from the command ``(3,)``."""
    return np.asarray(np.linalg.norm(np.mean(attained, axis=-2) - command, axis=-1))


def repeatability(attained: Array) -> Array:
    """RP ``(...)``, m, of attained positions ``(..., n, 3)``, n >= 2.

    Raises
    ------
    ValueError
        There are fewer than two.
    """
    _several(attained)
    off = np.linalg.norm(attained - attained.mean(axis=-2, keepdims=True), axis=-1)
    return np.asarray(off.mean(axis=-1) + 3 * off.std(axis=-1, ddof=1))


def variation(sides: Sequence[Array]) -> Array:
    """VAP ``(...)``, m: the largest distance between barycentres of positions ``(..., n_h, 3)`` from two sides or more.

    Raises
    ------
    ValueError
        There are fewer than two sides.
    """
    return np.asarray(np.linalg.norm(_between(sides), axis=-1).max(axis=(-1, -2)))


def drift(cycles: Sequence[Array], command: Array) -> tuple[Array, Array]:
    """Find dAP and dRP ``(...)``, m, of cycles ``(..., n_t, 3)`` in the order of time; dRP is nan if a cycle has one.

    Raises
    ------
    ValueError
        There are fewer than two cycles.
    """
    if len(cycles) < 2:
        raise ValueError(f"drift: expected two or more cycles, found {len(cycles)}")
    ap = np.array([accuracy(cycle, command) for cycle in cycles])
    d_ap = np.asarray(np.max(np.abs(ap - ap[0]), axis=0))
    if min(cycle.shape[-2] for cycle in cycles) < 2:
        return d_ap, np.full_like(d_ap, np.nan)
    rp = np.array([repeatability(cycle) for cycle in cycles])
    return d_ap, np.asarray(np.max(np.abs(rp - rp[0]), axis=0))


def angle_accuracy(attained: Array, command: Array) -> Array:
    """AP about each axis ``(..., 3)``, rad, of small rotation vectors ``(..., n, 3)`` against ``(3,)``."""
    return np.asarray(np.abs(np.mean(attained, axis=-2) - command))


def angle_repeatability(attained: Array) -> Array:
    """RP about each axis ``(..., 3)``, rad, of small rotation vectors ``(..., n, 3)``, n >= 2: three S.

    Raises
    ------
    ValueError
        There are fewer than two.
    """
    _several(attained)
    return np.asarray(3 * attained.std(axis=-2, ddof=1))


def angle_variation(sides: Sequence[Array]) -> Array:
    """VAP about each axis ``(..., 3)``, rad, of small rotation vectors ``(..., n_h, 3)`` from two sides or more.

    Raises
    ------
    ValueError
        There are fewer than two sides.
    """
    return np.asarray(np.abs(_between(sides)).max(axis=(-2, -3)))


def _several(attained: Array) -> None:
    if attained.shape[-2] < 2:
        raise ValueError(f"repeatability: expected two or more attained positions, found {attained.shape[-2]}")


def _between(sides: Sequence[Array]) -> Array:
    """From each side's barycentre to each other's ``(..., h, k, 3)``."""
    if len(sides) < 2:
        raise ValueError(f"variation: expected two or more sides, found {len(sides)}")
    centres = np.stack([side.mean(axis=-2) for side in sides], axis=-2)
    return np.asarray(centres[..., :, None, :] - centres[..., None, :, :])


def split_about(error: Array, points: Array, centre: Array) -> tuple[Array, Array]:
    """Radial and tangential parts of errors about a point, such as a sample that detectors look at.

    Parameters
    ----------
    error, points
        ``(n, 3)`` m, in one frame.
    centre
        ``(3,)`` m, in that frame; no point may lie there.

    Returns
    -------
    radial
        ``(n,)`` m, outward positive: what changes the distance from the sample.
    along
        ``(n,)`` m: length of what is left, along the sphere; over the distance it is an angle.
    """
    arm = points - centre
    outward = arm / np.linalg.norm(arm, axis=1, keepdims=True)
    radial = np.einsum("ni,ni->n", error, outward)
    return radial, np.linalg.norm(error - radial[:, None] * outward, axis=1)


def norm_metrics(norms: Array) -> dict[str, float | None]:
    """Give the universal model's figures of errors.

    Parameters
    ----------
    norms
        Norms of position errors (N,) [m].

    Returns
    -------
    dict
        ``P_mean``, ``P_std`` (None of a single error) and ``P_max`` [m]. Source: the universal model, its tables.
    """
    spread = float(norms.std(ddof=1)) if len(norms) > 1 else None
    return {"P_mean": float(norms.mean()), "P_std": spread, "P_max": float(norms.max())}
