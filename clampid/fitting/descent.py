"""Minimisation by damped Gauss-Newton steps on scaled normal equations, with a prior and bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from scipy import linalg

from clampid.stages.rows import Array, Bools

__all__ = [
    "ITERATIONS",
    "NEGLIGIBLE",
    "Chord",
    "Limits",
    "Point",
    "covariance_of",
    "descend",
    "inverse_of",
    "newton_step",
]

ITERATIONS = 30
DAMPING_START, DAMPING_END = 1e-3, 1e8
# Factor on the smallest damping each time that an undamped step fails. In a curved valley undamped steps are too long,
# but a fixed smallest damping may be a hundred times too large: the steps are then very short.
LESS_DAMPING = 0.1
# Factors on the damping by Nielsen's rule, which uses the gain ratio (actual over predicted decrease): Madsen, Nielsen,
# Tingleff, Methods for non-linear least squares problems, 2004, sect. 3.2. With factors of ten instead, every second
# step failed along a curved valley.
RAISED, LOWERED = 2.0, 1 / 3
IDLE_GAIN, IDLE_STEPS = 1e-6, 3  # a search ends after so many steps that lower the cost by less than this share
CHORD_TOLERANCE = 0.1  # difference of the gain ratio from 1 up to which the previous normal matrix is kept
NEGLIGIBLE = 1e-3  # predicted decrease, in units of chi-square: smaller steps are far within the standard errors


class Point(Protocol):
    """The cost and its local quadratic model at one parameter vector, without the prior."""

    @property
    def theta(self) -> Array:
        """The parameter vector ``(P,)``, SI."""

    @property
    def cost(self) -> float:
        """Sum of squares of the whitened residual."""

    @property
    def count(self) -> int:
        """Number of entries of the whitened residual."""

    def normal(self) -> tuple[Array, Array]:
        """Normal matrix ``(P, P)`` and downhill gradient ``(P,)`` of half the cost."""


PointT = TypeVar("PointT", bound=Point)


@dataclass(frozen=True)
class Limits:
    """Scaling and bounds of a search.

    Attributes
    ----------
    size
        Reasonable sizes ``(P,)``, which scale the equations, SI.
    lower, upper
        Bounds ``(P,)``, SI.
    bounded
        ``(P,)``: to which parameters the bounds apply.
    """

    size: Array
    lower: Array
    upper: Array
    bounded: Bools

    def clipped(self, theta: Array) -> Array:
        """A parameter vector ``(P,)`` clipped to the bounds that apply."""
        return np.where(self.bounded, np.clip(theta, self.lower, self.upper), theta)

    def resting(self, theta: Array) -> Bools:
        """Which parameters ``(P,)`` are at a bound that applies."""
        return np.asarray(self.bounded & ((theta <= self.lower) | (theta >= self.upper)))


@dataclass
class Chord(Generic[PointT]):
    """The chord method: an earlier point's normal matrix is kept while the decrease is as predicted.

    For a nearly linear model the matrix hardly changes, and it may cost many times as much as a gradient. Because each
    point has its own gradient, searches converge to the same minimum. Source: Kelley, Iterative methods for linear and
    nonlinear equations, 1995, sect. 5.4.

    Attributes
    ----------
    gradient
        Function that gives the downhill gradient ``(P,)`` of half the cost at a point.
    matrix
        ``(P, P)``, without the prior; None before the first point. It may come from an earlier search.
    """

    gradient: Callable[[PointT], Array]
    matrix: Array | None = None

    def normal(self, point: PointT, gain_ratio: float) -> tuple[Array, Array]:
        """Normal matrix and gradient at a point, reached by a step with this ratio of actual to predicted decrease."""
        if self.matrix is not None and abs(gain_ratio - 1.0) <= CHORD_TOLERANCE:
            return self.matrix, self.gradient(point)
        self.matrix, g = point.normal()
        return self.matrix, g


def descend(
    at: Callable[[Array], PointT],
    theta: Array,
    precision: Array,
    mean: Array,
    limits: Limits,
    chord: Chord[PointT] | None = None,
) -> tuple[PointT, int]:
    """The local minimum of cost and prior that damped Gauss-Newton steps reach from ``theta``; and their number.

    Parameters
    ----------
    at
        Gives the cost at a parameter vector ``(P,)``.
    theta
        Initial values ``(P,)``, SI.
    precision, mean
        The prior: ``(P, P)`` and ``(P,)``.
    limits
        Scaling and bounds.
    chord
        Keeps a normal matrix while it is accurate enough; by default it is computed at every point.
    """

    def whole(point: PointT) -> float:
        off = point.theta - mean
        return point.cost + float(off @ precision @ off)

    def normal(point: PointT, gain_ratio: float = 1.0) -> tuple[Array, Array]:
        A, g = point.normal() if chord is None else chord.normal(point, gain_ratio)
        return A + precision, g - precision @ (point.theta - mean)

    best = at(theta)
    cost, (A, g) = whole(best), normal(best)
    own = chord is None  # whether the matrix was computed at this point
    damping, least, raise_by, idle, iteration = 0.0, DAMPING_START, RAISED, 0, 0
    while iteration < ITERATIONS and idle <= IDLE_STEPS and damping < DAMPING_END:
        iteration += 1
        # A parameter at its bound whose gradient points outside is kept there, so that the others' step is optimal.
        on_bound = ((best.theta <= limits.lower) & (g < 0)) | ((best.theta >= limits.upper) & (g > 0))
        step = newton_step(A, g, limits.size, damping, ~(limits.bounded & on_bound))
        if float(g @ step) < NEGLIGIBLE * max(1.0, cost / max(best.count, 1)):
            break
        moved = best.theta + step
        trial = at(limits.clipped(moved))
        reached = whole(trial)
        if reached > cost and chord is not None and not own:
            (A, g), own = normal(best, 0.0), True
            continue
        if reached > cost:
            if damping == 0.0:
                damping, least = least, LESS_DAMPING * least
            else:
                damping *= raise_by
            raise_by *= RAISED
            continue
        gain_ratio = (cost - reached) / float(step @ (2.0 * g - A @ step))  # actual over predicted decrease
        # Where clearances close, the cost has kinks, along which steps zigzag with little gain.
        idle = idle + 1 if reached > cost * (1 - IDLE_GAIN) else 0
        best, cost = trial, reached
        A, g = normal(best, gain_ratio)
        own = chord is None or abs(gain_ratio - 1.0) > CHORD_TOLERANCE
        damping, raise_by = damping * max(LOWERED, 1.0 - (2.0 * gain_ratio - 1.0) ** 3), RAISED
        damping = damping if damping >= least else 0.0
    return best, iteration


def newton_step(A: Array, g: Array, size: Array, damping: float, free: Bools) -> Array:
    """Solve the normal equations of the free parameters; the step ``(P,)``, zero for the others.

    Parameters
    ----------
    A, g
        Normal matrix ``(P, P)`` and downhill gradient ``(P,)``.
    size
        Reasonable sizes ``(P,)``; they and the columns' lengths balance the equations.
    damping
        Added to the diagonal of the balanced matrix.
    free
        ``(P,)``: which parameters may move.
    """
    out = np.zeros_like(g)
    A, g, size = A[np.ix_(free, free)], g[free], size[free]
    balance = size / np.sqrt(np.maximum(np.diag(A) * size**2, 1e-300))
    scaled = A * np.outer(balance, balance) + damping * np.eye(len(g))
    try:
        step = linalg.cho_solve(linalg.cho_factor(scaled), g * balance)
    except linalg.LinAlgError:
        step = linalg.pinvh(scaled) @ (g * balance)
    out[free] = step * balance
    return out


def inverse_of(A: Array) -> Array:
    """Inverse ``(P, P)`` of a normal matrix that includes the prior, its columns balanced first.

    The prior makes it positive definite. A pseudo-inverse would treat directions that only the prior determines as
    numerically zero, and report a standard error of zero where it is largest.
    """
    balance = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    scaled = A * np.outer(balance, balance)
    try:
        inverse = linalg.cho_solve(linalg.cho_factor(scaled), np.eye(len(A)))
    except linalg.LinAlgError:
        inverse = linalg.pinvh(scaled)
    inverse = 0.5 * (inverse + inverse.T)
    return np.asarray(inverse * np.outer(balance, balance))


def covariance_of(normal: Array, precision: Array, squares: float, count: int) -> Array:
    """Covariance ``(P, P)`` of a fit with independent noise, whose variance is estimated from the residual.

    Parameters
    ----------
    normal, precision
        Normal matrix of the rows and precision of the prior, ``(P, P)``.
    squares, count
        Sum of squares of the whitened residual, and the number of its entries.
    """
    inverse = inverse_of(normal + precision)
    determined = len(inverse) - float(np.sum(inverse * precision))  # parameters that the rows determine, not the prior
    scale = squares / max(count - determined, 1.0)
    return np.asarray(inverse * max(scale, 1e-12))
