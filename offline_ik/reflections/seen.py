"""The gamma and delta of a detector pixel, with their uncertainty, also as a file for pyFAI.

A pixel (i, j), both from 0, lies in row i along the slow axis and column j along the fast one; its middle is at (i +
1/2, j + 1/2) pixels. As in :mod:`offline_ik.cell.pyfai` the slow axis is against the detector's x, the fast one along
its y, and the middle of all pixels is the frame's origin. With the covariance S of the detector's pose and the pixel's
displacement t + ω × p, dγ = e_γ·(t + ω × p) / (ρ |∂u/∂γ|): e_γ and e_δ are perpendicular to each other and to u.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from offline_ik.cell.cell import MOST_PIXELS
from offline_ik.cell.coordinates import Convention, detector_angles, detector_pose
from offline_ik.cell.pyfai import PyfaiGeometry, pyfai_geometry
from offline_ik.errors import TargetError

if TYPE_CHECKING:
    from offline_ik.inverse.detector import Detector

__all__ = ["Seen", "Spread", "check_pixels", "pixel_of", "poni_text", "spread_of"]

Array = npt.NDArray[np.float64]

DIFFERENCE_STEP = 1e-6  # rad


@dataclass(frozen=True)
class Spread:
    """Standard deviations of a direction from the sample, rad, and of the distance, m.

    The outer angle's is infinite at the pole of the inner circle.
    """

    gamma: float
    delta: float
    r: float

    def to_json(self) -> dict[str, float | None]:
        """For programs."""
        named = {"gamma_std_rad": self.gamma, "delta_std_rad": self.delta, "r_std_m": self.r}
        return {name: value if math.isfinite(value) else None for name, value in named.items()}


@dataclass(frozen=True)
class Seen:
    """What a pixel sees.

    Attributes
    ----------
    gamma, delta, two_theta
        rad, from the sample; ``two_theta`` is from the beam.
    distance
        From the sample, m.
    two_theta_std
        Standard deviation, rad.
    """

    gamma: float
    delta: float
    two_theta: float
    distance: float
    spread: Spread
    two_theta_std: float

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "gamma_rad": self.gamma,
            "delta_rad": self.delta,
            "two_theta_rad": self.two_theta,
            "distance_m": self.distance,
            **self.spread.to_json(),
            "two_theta_std_rad": self.two_theta_std,
        }


def check_pixels(pixels: object) -> tuple[int, int]:
    """Rows and columns.

    Raises
    ------
    TargetError
        They are not two whole numbers of 1 to :data:`MOST_PIXELS`, or nobody said any.
    """
    if pixels is None:
        raise TargetError("expected the detector's pixels: pixels=ROWS,COLUMNS, or pixels in the cell's [detector]")
    found = np.asarray(pixels, dtype=float).ravel()
    if len(found) != 2 or not all(1 <= v <= MOST_PIXELS and v == round(v) for v in found.tolist()):
        raise TargetError(f"pixels: expected ROWS,COLUMNS, whole numbers of 1 to {MOST_PIXELS}, found {found.tolist()}")
    return int(found[0]), int(found[1])


def pixel_of(
    detector: Detector, pose: Array, covariance: Array, pixel: tuple[float, float], pixels: tuple[int, int]
) -> Seen:
    """What a pixel sees.

    Parameters
    ----------
    pose
        ``(4, 4)`` of the detector, the convention's frame, m.
    covariance
        ``(6, 6)`` of the pose, as :class:`offline_ik.inverse.uncertainty.Uncertainty` has it.
    pixel
        (i, j); parts of a pixel may be meant.
    pixels
        Rows and columns, of :func:`check_pixels`.

    Raises
    ------
    TargetError
        There is no such pixel.
    """
    for name, at, most in zip("ij", pixel, pixels, strict=True):
        if not -0.5 <= at <= most - 0.5:
            raise TargetError(f"{name}: expected a pixel from 0 to {most - 1}, found {at:g}")
    convention, size = detector.cell.convention, detector.cell.pixel
    slow, fast = ((at + 0.5 - 0.5 * most) * size for at, most in zip(pixel, pixels, strict=True))
    there = pose.copy()
    there[:3, 3] = pose[:3, 3] + pose[:3, :3] @ np.array([-slow, fast, 0.0])
    angles = detector_angles(convention, there)
    u = (there[:3, 3] - np.asarray(convention.sample)) / angles.r
    beam = convention.lab[:, 2]
    away = beam - (beam @ u) * u  # d cos(2θ) = away · du
    sine = float(np.linalg.norm(away))
    two_theta = math.atan2(sine, float(beam @ u))
    cov = _displaced(detector, pose, there[:3, 3], covariance)
    axis = away / sine if sine > 0 else pose[:3, 0]
    two_theta_std = math.sqrt(max(float(axis @ cov @ axis), 0.0)) / angles.r
    spread = _spread(convention, angles.gamma, angles.delta, angles.r, cov)
    return Seen(angles.gamma, angles.delta, two_theta, angles.r, spread, two_theta_std)


def spread_of(detector: Detector, pose: Array, point: Array, covariance: Array) -> Spread:
    """How uncertain a point ``(3,)`` of the detector at ``pose`` ``(4, 4)`` is on the sphere; arguments as above."""
    there = pose.copy()
    there[:3, 3] = point
    at = detector_angles(detector.cell.convention, there)
    cov = _displaced(detector, pose, point, covariance)
    return _spread(detector.cell.convention, at.gamma, at.delta, at.r, cov)


def _displaced(detector: Detector, pose: Array, point: Array, covariance: Array) -> Array:
    """Covariance ``(3, 3)`` of a point's place, axes of the convention's frame, m²."""
    at = detector_angles(detector.cell.convention, pose)
    straight = detector_pose(detector.cell.convention, at.gamma, at.delta, at.r, at.roll)
    axes = detector.towards(detector.to_base(straight), at.roll)
    if detector.cell.convention.frame != "base":
        axes = detector.arm.base[:3, :3] @ axes
    x, y, z = (point - pose[:3, 3]).tolist()
    turned = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # ω × p = turned @ ω
    J = np.hstack([axes, turned @ axes])
    return np.asarray(J @ covariance @ J.T)


def _spread(convention: Convention, gamma: float, delta: float, r: float, cov: Array) -> Spread:
    g = np.array([gamma + DIFFERENCE_STEP, gamma - DIFFERENCE_STEP, gamma, gamma, gamma])
    d = np.array([delta, delta, delta + DIFFERENCE_STEP, delta - DIFFERENCE_STEP, delta])
    u = -detector_pose(convention, g, d, 1.0)[:, :3, 2]
    found = []
    for along in ((u[0] - u[1]) / (2 * DIFFERENCE_STEP), (u[2] - u[3]) / (2 * DIFFERENCE_STEP)):
        length = float(along @ along)
        found.append(math.sqrt(max(float(along @ cov @ along), 0.0)) / (r * length) if length > 1e-12 else math.inf)
    return Spread(found[0], found[1], math.sqrt(max(float(u[4] @ cov @ u[4]), 0.0)))


def poni_text(
    convention: Convention, pose: Array, pixel: float, pixels: tuple[int, int], wavelength: float | None = None
) -> str:
    """A ``.poni`` file for pyFAI of a detector at ``pose`` ``(4, 4)``.

    Parameters
    ----------
    pixel
        Its edge, m.
    pixels
        Rows and columns.
    wavelength
        m; left out where nobody says.
    """
    geometry: PyfaiGeometry = pyfai_geometry(convention, pose)
    rows, columns = pixels
    config = {"pixel1": pixel, "pixel2": pixel, "max_shape": [rows, columns], "orientation": 3}
    lines = [
        "# Written by clampid from the identified robot; poni is counted from the first pixel's corner",
        "poni_version: 2.1",
        "Detector: Detector",
        f"Detector_config: {json.dumps(config)}",
        f"Distance: {geometry.dist!r}",
        f"Poni1: {geometry.poni1 + 0.5 * rows * pixel!r}",
        f"Poni2: {geometry.poni2 + 0.5 * columns * pixel!r}",
        f"Rot1: {geometry.rot1!r}",
        f"Rot2: {geometry.rot2!r}",
        f"Rot3: {geometry.rot3!r}",
    ]
    if wavelength is not None:
        lines.append(f"Wavelength: {wavelength!r}")
    return "\n".join(lines) + "\n"
