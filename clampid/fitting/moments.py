"""Least squares from sums: normal equations accumulated over blocks of rows, and their solution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clampid.fitting.descent import ITERATIONS, NEGLIGIBLE, newton_step
from clampid.stages.rows import Array, Bools, Integers

__all__ = ["LogPoint", "Moments", "minimise"]


@dataclass
class Moments:
    """Sums over rows of products of the whitened design X and residual r.

    Attributes
    ----------
    at
        Parameters ``(P,)`` at which r is the residual, SI.
    normal, slope, squares
        XᵀX ``(P, P)``, Xᵀr ``(P,)`` and rᵀr.
    count
        Number of rows.
    """

    at: Array
    normal: Array
    slope: Array
    squares: float = 0.0
    count: int = 0

    @staticmethod
    def none(at: Array) -> Moments:
        """Sums over no rows, at the parameters ``at`` ``(P,)``."""
        return Moments(at, np.zeros((len(at), len(at))), np.zeros(len(at)))

    def add(self, columns: Integers, both: Array, sigma: float = 1.0) -> None:
        """Add rows ``both`` ``(k, p + 1)``: the columns of X with numbers ``columns``, then r; divided by ``sigma``."""
        gram = (both.T @ both) / sigma**2
        self.normal[np.ix_(columns, columns)] += gram[:-1, :-1]
        self.slope[columns] += gram[:-1, -1]
        self.squares += float(gram[-1, -1])
        self.count += len(both)

    def __add__(self, other: Moments) -> Moments:
        return Moments(
            self.at,
            self.normal + other.normal,
            self.slope + other.slope,
            self.squares + other.squares,
            self.count + other.count,
        )

    def moved(self, theta: Array) -> Moments:
        """The sums at other parameters ``(P,)``, for a linear design."""
        step = theta - self.at
        slope = self.slope - self.normal @ step
        return Moments(theta, self.normal, slope, self.squares - float(step @ (self.slope + slope)), self.count)


@dataclass(frozen=True)
class LogPoint:
    """A log at one parameter vector, from its sums, as a point of `clampid.fitting.descent.descend`."""

    moments: Moments

    @property
    def theta(self) -> Array:
        """Parameters ``(P,)`` of the sums."""
        return self.moments.at

    @property
    def cost(self) -> float:
        """Sum of squares of the whitened residual."""
        return self.moments.squares

    @property
    def count(self) -> int:
        """Number of rows."""
        return self.moments.count

    def normal(self) -> tuple[Array, Array]:
        """XᵀX ``(P, P)`` and Xᵀr ``(P,)``."""
        return self.moments.normal, self.moments.slope


def minimise(
    moments: Moments, theta: Array, precision: Array, mean: Array, size: Array, free: Bools | None = None
) -> Moments:
    """Least squares with a prior, by undamped steps; the sums at the solution.

    Parameters
    ----------
    moments
        The sums, at any parameters.
    theta
        Initial values ``(P,)``, SI; they are kept if a step would change them by far less than their standard errors.
    precision, mean
        The prior: ``(P, P)`` and ``(P,)``.
    size
        Reasonable sizes ``(P,)``, which scale the equations.
    free
        Which parameters ``(P,)`` may move; by default all.
    """
    free = np.ones(len(theta), dtype=bool) if free is None else free
    for _ in range(ITERATIONS):
        moments = moments.moved(theta)
        off = theta - mean
        downhill = moments.slope - precision @ off
        cost = moments.squares + float(off @ precision @ off)
        step = newton_step(moments.normal + precision, downhill, size, 0.0, free)
        if float(downhill @ step) < NEGLIGIBLE * max(1.0, cost / max(moments.count, 1)):
            break
        theta = theta + step
    return moments.moved(theta)
