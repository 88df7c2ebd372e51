"""Downhill: damped Gauss-Newton on scaled normal equations with a prior, within bounds."""

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
# By how much less the least damping is each time that a step without any fails. Along a bent valley none is too little,
# and a fixed least one may be a hundred times too much: steps then creep along it.
LESS_DAMPING = 0.1
# Nielsen's rule, by the share of its promise that a step keeps: Madsen, Nielsen, Tingleff, Methods for non-linear least
# squares problems, 2004, sect. 3.2. Tens up and down instead made every second step fail along a bent valley.
RAISED, LOWERED = 2.0, 1 / 3
IDLE_GAIN, IDLE_STEPS = 1e-6, 3  # so many steps that gain less than this share of the cost end the search
CHORD = 0.1  # of its promise: a step that keeps as much, or exceeds it by no more, was taken by a good enough matrix
NEGLIGIBLE = 1e-3  # a step that promises less than this of a unit of chi-square moves nothing by its error


class Point(Protocol):
    """The cost and its local quadratic model at one parameter vector, prior left out."""

    @property
    def theta(self) -> Array:
        """Where ``(P,)``."""

    @property
    def cost(self) -> float:
        """Sum of the whitened squares."""

    @property
    def count(self) -> int:
        """How many there are."""

    def normal(self) -> tuple[Array, Array]:
        """Normal matrix ``(P, P)`` and downhill gradient ``(P,)`` of half the cost."""


PointT = TypeVar("PointT", bound=Point)


@dataclass(frozen=True)
class Limits:
    """What a search keeps to: sizes that scale it, bounds, and which parameters ``(P,)`` they hold."""

    size: Array
    lower: Array
    upper: Array
    bounded: Bools

    def clipped(self, theta: Array) -> Array:
        """A parameter vector ``(P,)`` brought back within the bounds that hold."""
        return np.where(self.bounded, np.clip(theta, self.lower, self.upper), theta)

    def resting(self, theta: Array) -> Bools:
        """Which parameters ``(P,)`` rest on a bound that holds."""
        return np.asarray(self.bounded & ((theta <= self.lower) | (theta >= self.upper)))


@dataclass
class Chord(Generic[PointT]):
    """The normal matrix of a point passed before, kept for later ones while steps keep their promise.

    Where a model is nearly linear it hardly changes, and it may cost many times what a gradient does. With gradients of
    their own points, searches end where they would with matrices of their own. Source: the chord method, Kelley,
    Iterative methods for linear and nonlinear equations, 1995, sect. 5.4.

    Attributes
    ----------
    gradient
        The downhill gradient ``(P,)`` of half the cost at a point.
    matrix
        ``(P, P)``, without the prior's; None before the first point. It may come from an earlier search.
    """

    gradient: Callable[[PointT], Array]
    matrix: Array | None = None

    def normal(self, point: PointT, kept: float) -> tuple[Array, Array]:
        """Normal matrix and gradient at a point, to which a step has led that has ``kept`` so much of its promise."""
        if self.matrix is not None and abs(kept - 1.0) <= CHORD:
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
    """The lowest point from ``theta`` downhill, prior included, by damped Gauss-Newton; and the iterations it took.

    Parameters
    ----------
    at
        The cost at a parameter vector.
    precision, mean
        The prior: ``(P, P)`` and ``(P,)``.
    chord
        What keeps a normal matrix while it is good enough; by default every point has its own.
    """

    def whole(point: PointT) -> float:
        off = point.theta - mean
        return point.cost + float(off @ precision @ off)

    def normal(point: PointT, kept: float = 1.0) -> tuple[Array, Array]:
        A, g = point.normal() if chord is None else chord.normal(point, kept)
        return A + precision, g - precision @ (point.theta - mean)

    best = at(theta)
    cost, (A, g) = whole(best), normal(best)
    own = chord is None  # whether the matrix is this point's own
    damping, least, raise_by, idle, iteration = 0.0, DAMPING_START, RAISED, 0, 0
    while iteration < ITERATIONS and idle <= IDLE_STEPS and damping < DAMPING_END:
        iteration += 1
        # A parameter that rests on its bound and would leave it stays there, so that the others' step is their own.
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
        kept = (cost - reached) / float(step @ (2.0 * g - A @ step))  # of what the quadratic model promised
        # Where gaps close, the cost has kinks, along which steps zigzag without getting anywhere.
        idle = idle + 1 if reached > cost * (1 - IDLE_GAIN) else 0
        best, cost = trial, reached
        A, g = normal(best, kept)
        own = chord is None or abs(kept - 1.0) > CHORD
        damping, raise_by = damping * max(LOWERED, 1.0 - (2.0 * kept - 1.0) ** 3), RAISED
        damping = damping if damping >= least else 0.0
    return best, iteration


def newton_step(A: Array, g: Array, size: Array, damping: float, free: Bools) -> Array:
    """Solve the normal equations of the free parameters, scaled by what each may amount to and by its column."""
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
    """Inverse of a normal matrix, its columns balanced first.

    The prior makes it definite. A pseudo-inverse would drop, as numerically zero, the directions of which only the
    prior knows anything, and give them no error at all where it is largest.
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
    """Covariance ``(P, P)`` of a fit of independent numbers, of which the residual says the scale.

    Parameters
    ----------
    normal, precision
        Of rows and prior, ``(P, P)``.
    squares, count
        The whitened squares left, and of how many numbers.
    """
    inverse = inverse_of(normal + precision)
    determined = len(inverse) - float(np.sum(inverse * precision))  # parameters that the rows determine, not the prior
    scale = squares / max(count - determined, 1.0)
    return np.asarray(inverse * max(scale, 1e-12))
