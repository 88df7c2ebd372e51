"""
Physically consistent bodies: the pseudo-inertia matrix of the ten parameters is positive definite.

P = ∫ (r, 1)·(r, 1)ᵀ dm = [[Σ, h], [hᵀ, m]] with Σ = ½ tr(I)·1 − I holds mass m, first moment h and inertia I about one
point. A distribution of positive mass has P ≻ 0, and to every P ≻ 0 there is one; that is more than m > 0 and I ≻ 0,
and more than the triangle inequality of I about that point: it is that of I about the centre of mass.
Source: Traversaro, Brossette, Escande and Nori 2016 (physical consistency); Wensing, Kim and Slotine 2018, eqs. 7-12.
"""

import numpy as np
import numpy.typing as npt

from kinematics.screws import hat3

__all__ = ["BASIS", "about_centre", "is_consistent", "parameters_of", "pseudo_inertia"]

Array = npt.NDArray[np.float64]

_PLACES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def _basis() -> Array:
    out = np.zeros((10, 4, 4))
    out[0, 3, 3] = 1.0
    for axis in range(3):
        out[1 + axis, axis, 3] = out[1 + axis, 3, axis] = 1.0
    for k, (i, j) in enumerate(_PLACES, start=4):
        inertia = np.zeros((3, 3))
        inertia[i, j] = inertia[j, i] = 1.0
        out[k, :3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    return out


BASIS = _basis()
"""Matrices (10, 4, 4) with P = Σ φ_k·BASIS[k], φ = (m, h_x, h_y, h_z, Ixx, Iyy, Izz, Ixy, Ixz, Iyz)."""


def pseudo_inertia(phi: npt.ArrayLike) -> Array:
    """
    Give the pseudo-inertia matrices of bodies.

    Parameters
    ----------
    phi
        (…, 10): mass, first moment and inertia about one point, in one frame [kg, kg m, kg m²]; order as in `BASIS`.

    Returns
    -------
    Array
        P (…, 4, 4). Source: the module's docstring.

    Raises
    ------
    ValueError
        If there are not ten numbers to a body.
    """
    phi = np.asarray(phi, dtype=np.float64)
    if phi.shape[-1:] != (10,):
        raise ValueError(f"phi: expected shape (…, 10), found {phi.shape}")
    return np.asarray(np.tensordot(phi, BASIS, axes=(-1, 0)))


def parameters_of(P: npt.ArrayLike) -> Array:
    """
    Give the ten numbers (…, 10) of pseudo-inertia matrices (…, 4, 4); the inverse of `pseudo_inertia`.

    Source: I = tr(Σ)·1 − Σ, Wensing, Kim and Slotine 2018.
    """
    P = np.asarray(P, dtype=np.float64)
    sigma = P[..., :3, :3]
    inertia = np.trace(sigma, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - sigma
    entries = [inertia[..., i, j] for i, j in _PLACES]
    return np.stack([P[..., 3, 3], P[..., 0, 3], P[..., 1, 3], P[..., 2, 3], *entries], axis=-1)


def is_consistent(phi: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Whether a body can have such numbers (…,): P ≻ 0. Source: Traversaro et al. 2016."""
    return np.asarray(np.linalg.eigvalsh(pseudo_inertia(phi))[..., 0] > 0.0)


def about_centre(phi: npt.ArrayLike) -> tuple[float, Array, Array]:
    """
    Give mass [kg], centre of mass (3,) from the point [m] and inertia (3, 3) about the centre [kg m²] of one body.

    Source: Lynch & Park, Modern Robotics, theorem 8.2 (Steiner).

    Raises
    ------
    ValueError
        If the mass is not positive.
    """
    phi = np.asarray(phi, dtype=np.float64)
    if not phi[0] > 0.0:
        raise ValueError(f"mass: expected a positive number, found {phi[0]:g} kg")
    centre = phi[1:4] / phi[0]
    inertia = np.diag(phi[4:7])
    for value, (i, j) in zip(phi[7:], _PLACES[3:], strict=True):
        inertia[i, j] = inertia[j, i] = value
    d = hat3(centre)
    return float(phi[0]), centre, np.asarray(inertia + phi[0] * (d @ d))
