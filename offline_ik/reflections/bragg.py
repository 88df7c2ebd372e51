"""The sample's position from known Bragg reflections found at known detector positions.

A powder ring or an oriented grain's reflection with the spacing d appears at the scattering angle 2 theta,
sin theta = lambda / (2 d). Where the ray from the sample s through the detector's point p makes another angle with the
beam b, the sample is elsewhere::

    f(s) = acos(b . (p - s)/|p - s|) - 2 theta

Generalised least squares by Gauss and Newton over the reflections. Their errors have the covariance S: each its own
angle's, and those of the points, which points found by one robot share. The covariance of s is (J' S^-1 J)^-1. One
reflection tells one direction, along which its ring moves: at least three that are not alike are needed. The sample's
place along the beam needs rings of different angles, or detectors at different distances. (The thesis' future work.)

Whether the reflections agree is tested by chi-square; which one does not, by Baarda (1968), A testing procedure for use
in geodetic networks: w_i = (Q f)_i / sqrt(Q_ii) with Q = S^-1 - S^-1 J (J' S^-1 J)^-1 J' S^-1 is standard normal, and
chi-square without reflection i is less by w_i².
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular
from scipy.special import chdtrc

from offline_ik.cell.coordinates import Convention
from offline_ik.errors import TargetError

__all__ = ["FALSE_ALARM", "Reflection", "SamplePosition", "sample_position", "scattering_angle"]

Array = npt.NDArray[np.float64]

MAX_STEPS, MAX_HALVINGS = 50, 20
POINT_SETTLED = 1e-9  # m
UNDETERMINED = 1e-2  # m, standard error from which on a direction is not identified by the reflections
FALSE_ALARM = 0.01
"""How often reflections whose errors are as stated are said not to agree."""
_UNCHECKED = 1e-9  # share of a reflection's error that others check, below which there is no check


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
        ``(3, 3)`` of the point, m², of this reflection alone; zero where it is well known.
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
        ``(3,)``, convention's frame, m; as given along directions that are not identified.
    covariance
        ``(3, 3)``, m², from the stated errors; where the reflections do not agree, times ``misfit`` squared.
    chi_square, freedom
        Sum of squares of residuals over their stated errors, and its degrees of freedom.
    residuals
        ``(N,)``: angle of the spacing less angle found, rad.
    stated
        ``(N,)``: standard errors of the same before the fit, rad.
    checks
        ``(N,)``: by how many standard errors each reflection misses what the others say; not a number where they say
        nothing of it.
    undetermined
        ``(k, 3)``: directions that the reflections do not determine, or not to within a centimetre.
    """

    sample: Array
    covariance: Array
    chi_square: float
    freedom: int
    residuals: Array
    stated: Array
    checks: Array
    undetermined: Array

    @property
    def std(self) -> Array:
        """``(3,)``, m."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def misfit(self) -> float:
        """Root mean square of residuals over their stated errors: about 1 where these are as stated; 0 unchecked."""
        return math.sqrt(self.chi_square / self.freedom) if self.freedom else 0.0

    @property
    def p_value(self) -> float:
        """How probable so large a misfit is where errors are as stated; 1 where nothing checks them."""
        return float(chdtrc(self.freedom, self.chi_square)) if self.freedom else 1.0

    @property
    def fits(self) -> bool:
        """Whether the reflections agree within their stated errors, wrongly denied once in a hundred tables."""
        return self.p_value >= FALSE_ALARM

    @property
    def suspects(self) -> tuple[int, ...]:
        """Those without any one of which the others agree, from 0, the worst first; none where all agree."""
        if self.fits:
            return ()
        squares = np.nan_to_num(self.checks) ** 2
        left = np.maximum(self.chi_square - squares, 0.0)
        agree = chdtrc(self.freedom - 1, left) >= FALSE_ALARM if self.freedom > 1 else squares > 0
        return tuple(int(i) for i in np.argsort(-squares, kind="stable") if agree[i])

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "sample_m": self.sample.tolist(),
            "std_m": self.std.tolist(),
            "covariance_m2": self.covariance.tolist(),
            "not_told": self.undetermined.tolist(),
            "misfit": self.misfit,
            "chi_square": self.chi_square,
            "degrees_of_freedom": self.freedom,
            "p_value": self.p_value,
            "false_alarm": FALSE_ALARM,
            "fits": self.fits,
            "suspects": [i + 1 for i in self.suspects],
            "residuals_rad": self.residuals.tolist(),
            "stated_rad": self.stated.tolist(),
            "checks": [None if math.isnan(c) else c for c in self.checks.tolist()],
        }


def scattering_angle(wavelength: float, spacing: float) -> float:
    """2 theta of a spacing, rad; both in the same unit.

    Raises
    ------
    TargetError
        The wavelength is more than twice the spacing, or one of them is not positive and finite.
    """
    if not (0 < wavelength < math.inf and 0 < spacing < math.inf):
        raise TargetError(f"expected a positive wavelength and spacing, found {wavelength:g} and {spacing:g}")
    sine = wavelength / (2 * spacing)
    if sine > 1:
        raise TargetError(
            f"a spacing of {spacing:g} does not reflect a wavelength of {wavelength:g}: more than twice it"
        )
    return 2 * math.asin(sine)


def sample_position(
    convention: Convention, reflections: Sequence[Reflection], common: Array | None = None
) -> SamplePosition:
    """The scattering point that explains the reflections, from the convention's sample as a start.

    Parameters
    ----------
    common
        ``(3 N, 3 N)``, m²: covariance of all points together, beside that of each one alone.

    Raises
    ------
    TargetError
        Fewer than three reflections, numbers that are not finite or not positive, reflections too alike, or a search
        that does not settle.
    """
    problem = _problem(convention, reflections, common)
    sample = np.asarray(convention.sample, dtype=float).copy()
    moved = math.inf
    for _ in range(MAX_STEPS):
        _, A, b, L = problem.whitened(sample)
        U, size, Vt = np.linalg.svd(A, full_matrices=False)
        known = _determined(size)
        sample, moved = problem.stepped(sample, Vt[known].T @ ((U[:, known].T @ b) / size[known]), b, L)
        if moved < POINT_SETTLED:
            break
    else:
        raise TargetError(
            f"the search for the scattering point did not settle within {MAX_STEPS} steps (the last {moved:.1e} m): "
            "one of the reflections or the cell's sample, where it began, may be far off"
        )
    return _found(problem, sample)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Points ``(N, 3)``, angles ``(N,)``, their standard errors, and the covariance ``(N, 3, N, 3)`` of the points."""

    beam: Array
    points: Array
    wanted: Array
    sigma: Array
    spread: Array

    def whitened(self, sample: Array) -> tuple[Array, Array, Array, Array]:
        """Residuals ``(N,)``, J and residuals in units of their errors, and L with L L' their covariance."""
        residual, J = _angles(self.points - sample, self.beam, self.wanted)
        S = np.diag(self.sigma**2) + np.einsum("ni,nimj,mj->nm", J, self.spread, J)
        L = np.linalg.cholesky(S)
        both = solve_triangular(L, np.column_stack([J, residual]), lower=True)
        return residual, both[:, :3], both[:, 3], L

    def stepped(self, sample: Array, step: Array, misses: Array, L: Array) -> tuple[Array, float]:
        """The end of a step, halved until the residuals by L are no larger than ``misses``, and how far it asked, m."""
        asked = float(np.abs(step).max())
        for _ in range(MAX_HALVINGS):
            residual, _ = _angles(self.points - (sample + step), self.beam, self.wanted)
            found = solve_triangular(L, residual, lower=True)
            if float(found @ found) <= (1.0 + 1e-9) * float(misses @ misses) + 1e-12:
                break
            step = 0.5 * step
        return sample + step, asked


def _problem(convention: Convention, reflections: Sequence[Reflection], common: Array | None) -> _Problem:
    count = len(reflections)
    if count < 3:
        raise TargetError(f"expected at least three reflections, found {count}: each determines one direction")
    points = np.array([r.point for r in reflections], dtype=float)
    wanted = np.array([r.two_theta for r in reflections], dtype=float)
    sigma = np.array([r.std_angle for r in reflections], dtype=float)
    if not (np.isfinite(points).all() and np.isfinite(wanted).all()) or points.shape[1:] != (3,):
        raise TargetError("expected points of three finite numbers and finite angles")
    if not ((sigma > 0) & np.isfinite(sigma)).all() or not ((wanted > 0) & (wanted < np.pi)).all():
        raise TargetError("expected angles between 0 and pi, with positive standard deviations")
    spread = np.zeros((count, 3, count, 3)) if common is None else np.reshape(common, (count, 3, count, 3)).copy()
    for n, reflection in enumerate(reflections):
        if reflection.covariance is not None:
            spread[n, :, n, :] += reflection.covariance
    if not np.isfinite(spread).all():
        raise TargetError("expected finite covariances of the points")
    return _Problem(np.asarray(convention.beam), points, wanted, sigma, spread)


def _determined(size: Array) -> npt.NDArray[np.bool_]:
    """Which directions are, by singular values ``(3,)``, 1/m; never fewer than two."""
    known = size > 1.0 / UNDETERMINED
    if known.sum() < 2:
        raise TargetError(
            f"the reflections do not determine the sample's place to within {1e3 * UNDETERMINED:g} mm in more than "
            f"{'one direction' if known.any() else 'no direction at all'}: they are too much alike; add rings of "
            "another angle, or detector positions on another side"
        )
    return np.asarray(known)


def _found(problem: _Problem, sample: Array) -> SamplePosition:
    residual, A, b, L = problem.whitened(sample)
    U, size, Vt = np.linalg.svd(A, full_matrices=False)
    known = _determined(size)
    U = U[:, known]
    left = b - U @ (U.T @ b)
    freedom, chi_square = len(b) - int(known.sum()), float(left @ left)
    inverse = solve_triangular(L, np.eye(len(L)), lower=True)
    Q = inverse.T @ inverse - (inverse.T @ U) @ (inverse.T @ U).T
    share = np.diag(Q) * np.einsum("ij,ij->i", L, L)
    checks = np.where(share > _UNCHECKED, (inverse.T @ left) / np.sqrt(np.maximum(np.diag(Q), 1e-300)), np.nan)
    covariance = (Vt.T / np.maximum(size, 1e-9) ** 2) @ Vt
    stated = np.sqrt(np.einsum("ij,ij->i", L, L))
    found = SamplePosition(sample, covariance, chi_square, freedom, residual, stated, checks, Vt[~known])
    if found.fits:
        return found
    scaled = covariance * found.misfit**2
    return SamplePosition(sample, scaled, chi_square, freedom, residual, stated, checks, Vt[~known])


def _angles(v: Array, beam: Array, wanted: Array) -> tuple[Array, Array]:
    """Wanted less found angle ``(N,)``, and d found / d sample ``(N, 3)``, of rays ``v`` ``(N, 3)``."""
    length = np.linalg.norm(v, axis=1, keepdims=True)
    u = v / length
    along = u @ beam
    across = beam - along[:, None] * u
    sine = np.maximum(np.linalg.norm(across, axis=1), 1e-12)
    # d angle / d u = -beam / sine; du = -(1 - u u') ds / |v|.
    return wanted - np.arctan2(sine, along), across / (sine[:, None] * length)
