"""Least squares from sums: normal equations that add up over blocks of rows, and their solution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clampid.fitting.descent import ITERATIONS, NEGLIGIBLE, newton_step
from clampid.stages.rows import Array, Bools, Integers

__all__ = ["LogPoint", "Moments", "minimise"]


@dataclass
class Moments:
    """Sums over rows of whitened residual r, at parameters ``at``, and design X.

    Attributes
    ----------
    at
        ``(P,)``.
    normal, slope, squares
        XᵀX ``(P, P)``, Xᵀr ``(P,)`` and rᵀr.
    count
        How many rows.
    """

    at: Array
    normal: Array
    slope: Array
    squares: float = 0.0
    count: int = 0

    @staticmethod
    def none(at: Array) -> Moments:
        """No rows yet; at ``at`` ``(P,)``."""
        return Moments(at, np.zeros((len(at), len(at))), np.zeros(len(at)))

    def add(self, columns: Integers, both: Array, sigma: float = 1.0) -> None:
        """Add rows ``(k, p + 1)``, the columns of X that are not zero and r, all in units of ``sigma``."""
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
        """The same sums at other parameters."""
        step = theta - self.at
        slope = self.slope - self.normal @ step
        return Moments(theta, self.normal, slope, self.squares - float(step @ (self.slope + slope)), self.count)


@dataclass(frozen=True)
class LogPoint:
    """A log at one parameter vector, from its sums, as `clampid.fitting.descent.descend` sees it."""

    moments: Moments

    @property
    def theta(self) -> Array:
        """Where the sums are ``(P,)``."""
        return self.moments.at

    @property
    def cost(self) -> float:
        """The whitened squares."""
        return self.moments.squares

    @property
    def count(self) -> int:
        """How many rows."""
        return self.moments.count

    def normal(self) -> tuple[Array, Array]:
        """XᵀX ``(P, P)`` and Xᵀr ``(P,)``."""
        return self.moments.normal, self.moments.slope


def minimise(
    moments: Moments, theta: Array, precision: Array, mean: Array, size: Array, free: Bools | None = None
) -> Moments:
    """Least squares with prior by the steps of `clampid.fitting.solve.solve`; the sums at the solution.

    Parameters
    ----------
    theta
        Start ``(P,)``, kept where no step is worth being made.
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
