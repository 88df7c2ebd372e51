"""Dry friction as a state machine: an element sticks, is wound up by motion, and slips at its limit."""

from __future__ import annotations

import numpy as np

from experiments.virtual_robot.description import Array


def dry_friction(motion: Array, width: Array, start: Array) -> Array:
    """Return the state of dry friction along a motion.

    Parameters
    ----------
    motion
        Position in the order of time, (N, n).
    width
        Motion over which friction builds up from nothing, same unit, (n,).
    start
        State before the first row, −1 … 1, (n,).

    Returns
    -------
    Array
        State in −1 … 1, (N, n): +1 while sliding forward; standing still keeps it.
    """
    state = np.empty_like(motion)
    now = np.asarray(start, dtype=float)
    step = np.diff(motion, axis=0, prepend=motion[:1]) / width
    for i in range(len(motion)):
        now = np.minimum(np.maximum(now + step[i], -1.0), 1.0)
        state[i] = now
    return state


def creeping_friction(motion: Array, step: float, width: Array, creep: Array, start: Array) -> Array:
    """Return the state of dry friction of contacts of several widths, which creep while they stick.

    A contact slips where it is wound up to its limit, as in `dry_friction`; those of a quarter, once, twice and four
    times the width carry equal shares, and the wider creep the slower. Source: generalized Maxwell slip, Al-Bender,
    Lampaert and Swevers, IEEE Trans. Automatic Control 50 (2005); the creep as an element's own relaxation.

    Parameters
    ----------
    motion
        Position at rows ``step`` s apart, rad, (N, n).
    width
        Motion over which the middle contacts slip, rad, (n,).
    creep
        Rate at which they creep, 1/s, (n,).
    start
        State before the first row, −1 … 1, (n,).
    """
    scale = np.array([0.25, 1.0, 2.0, 4.0])[:, None]
    kept = np.exp(-step * creep / scale)
    wound = np.diff(motion, axis=0, prepend=motion[:1]) / width
    now = np.repeat(np.asarray(start, dtype=float)[None], len(scale), axis=0)
    state = np.empty_like(motion)
    for i in range(len(motion)):
        now = np.clip(now * kept + wound[i] / scale, -1.0, 1.0)
        state[i] = now.mean(axis=0)
    return state


def slipping(compliance: Array, limit: Array, torque: Array) -> Array:
    """Return the angle by which slipping elements lag behind the torque, rad, (N, n).

    The elements, compliance (n, k) in rad/Nm, slip at torque changes ``limit`` (n, k) in Nm; their angle has the sign
    of the torque's last change, and is what the spring's deflection lags behind.
    """
    if not compliance.any():
        return np.zeros_like(torque)
    angle = np.zeros_like(torque)
    rest = np.zeros(torque.shape[1])
    for c, r in zip(compliance.T, limit.T, strict=True):
        path = np.vstack([np.zeros_like(torque[:1]), torque])
        angle += c * r * dry_friction(path, r, rest)[1:]
    return angle
