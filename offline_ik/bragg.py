"""Where the sample must be, if known Bragg reflections were found at these detector positions.

A powder ring or an oriented grain's reflection with the spacing d appears at the scattering angle 2 theta,
sin theta = lambda / (2 d). Where the ray from the sample s through the detector's point p makes another angle with the
beam b, the sample is elsewhere::

    f(s) = acos(b . (p - s)/|p - s|) - 2 theta

Least squares by Gauss and Newton over the reflections, weighed by their angular errors and by those of the points;
the covariance is (J' W J)^-1. One reflection tells one direction, along which its ring moves: at least three that are
not alike are needed. The sample's place along the beam needs rings of different angles, or detectors at different
distances. (The thesis' future work.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from offline_ik.coordinates import Convention
from offline_ik.errors import TargetError

__all__ = ["Reflection", "SamplePosition", "sample_position", "scattering_angle"]

Array = npt.NDArray[np.float64]

STEPS = 50
SETTLED = 1e-12  # m
UNTOLD = 1e-2  # m, standard error beyond which a direction is not told by the reflections


@dataclass(frozen=True, eq=False)
class Reflection:
    """One reflection found on the detector.

    Attributes
    ----------
    point
        ``(3,)``: where it hit the detector, in the convention's frame, m.
    two_theta
        The angle that its spacing gives, rad.
    std_angle
        Of the angle (width of the peak, energy), rad.
    covariance
        ``(3, 3)`` of the point, m²; zero where it is well known.
    """

    point: Array
    two_theta: float
    std_angle: float
    covariance: Array | None = None


@dataclass(frozen=True, eq=False)
class SamplePosition:
    """The scattering point.

    Attributes
    ----------
    sample
        ``(3,)``, convention's frame, m.
    covariance
        ``(3, 3)``, m², from the stated errors; not scaled by the misfit.
    misfit
        Root mean square of residuals over their stated errors: about 1 where the errors are as stated.
    """

    sample: Array
    covariance: Array
    misfit: float
    residuals: Array

    @property
    def std(self) -> Array:
        """``(3,)``, m."""
        return np.sqrt(np.diag(self.covariance))

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "sample_m": self.sample.tolist(),
            "std_m": self.std.tolist(),
            "covariance_m2": self.covariance.tolist(),
            "misfit": self.misfit,
            "residuals_rad": self.residuals.tolist(),
        }


def scattering_angle(wavelength: float, spacing: float) -> float:
    """2 theta of a spacing, rad; both in the same unit.

    Raises
    ------
    TargetError
        The wavelength is more than twice the spacing, or one of them is not positive.
    """
    if not (wavelength > 0 and spacing > 0):
        raise TargetError(f"expected a positive wavelength and spacing, found {wavelength:g} and {spacing:g}")
    sine = wavelength / (2 * spacing)
    if sine > 1:
        raise TargetError(
            f"a spacing of {spacing:g} does not reflect a wavelength of {wavelength:g}: more than twice it"
        )
    return 2 * float(np.arcsin(sine))


def sample_position(convention: Convention, reflections: Sequence[Reflection]) -> SamplePosition:
    """The scattering point that explains the reflections, from the convention's sample as a start.

    Raises
    ------
    TargetError
        Fewer than three reflections, numbers that are not finite or not positive, or reflections too alike.
    """
    if len(reflections) < 3:
        raise TargetError(f"expected at least three reflections, found {len(reflections)}: each tells one direction")
    points = np.array([r.point for r in reflections], dtype=float)
    wanted = np.array([r.two_theta for r in reflections])
    sigma = np.array([r.std_angle for r in reflections])
    if not (np.isfinite(points).all() and np.isfinite(wanted).all()) or points.shape[1:] != (3,):
        raise TargetError("expected points of three finite numbers and finite angles")
    if not (sigma > 0).all() or not ((wanted > 0) & (wanted < np.pi)).all():
        raise TargetError("expected angles between 0 and pi, with positive standard deviations")
    spread = np.array([np.zeros((3, 3)) if r.covariance is None else r.covariance for r in reflections])
    beam, sample = np.asarray(convention.beam), np.asarray(convention.sample, dtype=float).copy()
    for _ in range(STEPS):
        residual, J = _angles(points - sample, beam, wanted)
        weight = 1.0 / np.sqrt(sigma**2 + np.einsum("ni,nij,nj->n", J, spread, J))
        A = J * weight[:, None]
        if np.linalg.matrix_rank(A, tol=1.0 / UNTOLD) < 3:
            raise TargetError(
                "the reflections do not tell the sample's place: they are too much alike; add rings of another angle, "
                "or detector positions on another side"
            )
        step, *_ = np.linalg.lstsq(A, residual * weight, rcond=None)
        sample += step
        if np.abs(step).max() < SETTLED:
            break
    residual, J = _angles(points - sample, beam, wanted)
    weight = 1.0 / np.sqrt(sigma**2 + np.einsum("ni,nij,nj->n", J, spread, J))
    A = J * weight[:, None]
    freedom = max(len(reflections) - 3, 1)
    misfit = float(np.sqrt(np.sum((residual * weight) ** 2) / freedom)) if len(reflections) > 3 else 0.0
    return SamplePosition(sample, np.linalg.inv(A.T @ A), misfit, residual)


def _angles(v: Array, beam: Array, wanted: Array) -> tuple[Array, Array]:
    """Wanted less found angle ``(N,)``, and d found / d sample ``(N, 3)``, of rays ``v`` ``(N, 3)``."""
    length = np.linalg.norm(v, axis=1, keepdims=True)
    u = v / length
    along = u @ beam
    across = beam - along[:, None] * u
    sine = np.maximum(np.linalg.norm(across, axis=1), 1e-12)
    # d angle / d u = -beam / sine; du = -(1 - u u') ds / |v|.
    return wanted - np.arctan2(sine, along), across / (sine[:, None] * length)
