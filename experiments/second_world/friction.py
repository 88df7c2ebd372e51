"""
Friction of drives, with laws that differ from those of the effects.

Coulomb friction is either smooth in speed, F·tanh(w/w_s), or elastic before it slips (Dahl, 1968):
dF/dθ = σ·(1 − F·sign(w)/F_c). Both are constant at speed. Viscous friction is a power of speed, the exponent of which
is 1 in a robot that hides nothing.
"""

import numpy as np

from experiments.second_world.arrays import Array

__all__ = ["coulomb", "dahl", "direction", "viscous"]


def direction(qd: Array, max_speeds: Array) -> Array:
    """Smooth direction of motion (S, n) in (−1, 1): tanh of speed over three thousandths of the largest speed."""
    return np.asarray(np.tanh(qd / (3e-3 * max_speeds)))


def coulomb(qd: Array, max_speeds: Array, level_Nm: Array) -> Array:
    """Coulomb friction (S, n), Nm, of joint speeds (S, n), rad/s, with the level (n,) of each drive."""
    return np.asarray(level_Nm * direction(qd, max_speeds))


def dahl(q: Array, level_Nm: Array, slip_rad: float) -> Array:
    """
    Coulomb friction with elastic presliding, along a path.

    Parameters
    ----------
    q
        Angles along the path (S, n), rad, finely sampled or not: each step is solved exactly.
    level_Nm
        Coulomb level (n,).
    slip_rad
        Angle in which the friction comes within 1/e of its level.

    Returns
    -------
    Array
        Friction (S, n), Nm. At rest it keeps its last value, as a held drive does.
    """
    z = np.zeros(q.shape)
    step = np.diff(q, axis=0, prepend=q[:1])
    for k in range(1, len(q)):
        s = np.sign(step[k])
        z[k] = np.where(s == 0, z[k - 1], s + (z[k - 1] - s) * np.exp(-np.abs(step[k]) / slip_rad))
    return np.asarray(level_Nm * z)


def viscous(qd: Array, max_speeds: Array, at_full_speed_Nm: Array, exponent: float) -> Array:
    """Viscous friction (S, n), Nm: its value at full speed (n,) times a power of the relative speed."""
    return np.asarray(at_full_speed_Nm * np.sign(qd) * np.abs(qd / max_speeds) ** exponent)
