"""A torque log while parameters are searched of which most are linear: masses and frictions beside a few shapes.

By a linear parameter the derivative is the same at every point, and so are its whitened columns and their products:
they are made once for several searches of the same rows, and whitened once a search. At a point only the others'
columns are made and whitened. With C the linear parameters, V the others, and v the residual of these alone,

    r(theta) = r(theta_0) + v(theta_V) - v(theta_0V) - J_C (theta_C - theta_0C)

Source of the division: Golub & Pereyra, Separable nonlinear least squares: the variable projection method and its
applications, Inverse Problems 19, 2003; nothing is eliminated here, so that priors stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from clampid.fitting.descent import covariance_of
from clampid.fitting.noise import Noise, Whitened
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array, Integers

__all__ = ["LinearPart", "PartedLog", "PartedPoint"]


@dataclass(frozen=True, eq=False)
class LinearPart:
    """What the linear parameters C of a log do, which neither the other parameters nor weights change.

    Attributes
    ----------
    linear, other
        Which of the parameters ``(P + K,)`` are C and V.
    residual
        ``(N, n)``, Nm, at C = 0, less that of V alone.
    columns
        ``(N, n, C)``, Nm: the prediction's derivative.
    """

    problem: FitProblem
    linear: Integers
    other: Integers
    residual: Array
    columns: Array

    @staticmethod
    def of(problem: FitProblem, at: Array) -> LinearPart:
        """The linear part of a problem of ``free_air``, found at any parameters ``(P + K,)``."""
        bends = np.r_[problem.chain.bends, np.zeros(problem.offsets, dtype=bool)]
        linear, other = np.flatnonzero(~bends), np.flatnonzero(bends)
        residual, jacobian = problem.residual(at)
        columns = jacobian if not len(other) else jacobian[:, :, linear]
        left = residual + columns @ at[linear]
        if len(other):
            left -= _bent(problem).error(np.r_[at[other], np.zeros(problem.offsets)])
        return LinearPart(problem, linear, other, left, columns)

    def serves(self, problem: FitProblem) -> bool:
        """Whether another problem has the same effects and rows, of which others may be used."""
        mine, theirs = self.problem.rows, problem.rows
        same_rows = mine.signals is theirs.signals and mine.measured is theirs.measured
        return self.problem.chain is problem.chain and same_rows

    def left(self, theta: Array) -> Array:
        """The residual ``(N, n)``, Nm, at parameters ``(P + K,)``, less that of V alone."""
        return np.asarray(self.residual - self.columns @ theta[self.linear])


def _bent(problem: FitProblem) -> FitProblem:
    """The problem with the parameters V alone."""
    chain = problem.chain.bent
    return replace(problem, slots=chain.slots, chain=chain)


@dataclass(frozen=True, eq=False)
class PartedLog:
    """A log about the start of a search.

    Attributes
    ----------
    bent
        The problem with the parameters V alone.
    part
        What the others do.
    start
        ``(P + K,)``.
    white
        The residual there less that of V alone ``(M,)``, and the columns of C ``(M, C)``, whitened.
    """

    bent: FitProblem
    noise: Noise
    part: LinearPart
    start: Array
    white: Whitened

    @staticmethod
    def of(problem: FitProblem, noise: Noise, start: Array, part: LinearPart | None = None) -> PartedLog:
        """The log of a problem of ``free_air`` that has linear parameters, of which the ``part`` may be known."""
        part = part or LinearPart.of(problem, start)
        white = noise.whiten(problem.rows, part.left(start), part.columns)
        return PartedLog(_bent(problem), noise, part, start, white)

    def at(self, theta: Array) -> PartedPoint:
        """The log at other parameters ``(P + K,)``."""
        step = (theta - self.start)[self.part.linear]
        own, derivative = self.bent.derivative(np.r_[theta[self.part.other], np.zeros(self.bent.offsets)], 0)
        white = self.noise.whiten(self.bent.rows, own, derivative)
        left = self.white.residual - self.white.jacobian @ step + white.residual
        columns = _Columns(self, white.jacobian)
        there = Whitened(left, columns, self.white.entry, self.white.channel)
        return PartedPoint(theta, own, there, columns)


@dataclass(frozen=True, eq=False)
class _Columns:
    """The whitened Jacobian of a point, ``own`` those of the parameters V: :class:`clampid.fitting.noise.Late`."""

    log: PartedLog
    own: Array

    def dense(self) -> Array:
        """J ``(M, P + K)``."""
        out = np.empty((len(self.own), len(self.log.start)))
        out[:, self.log.part.linear], out[:, self.log.part.other] = self.log.white.jacobian, self.own
        return out

    def normal(self) -> Array:
        """J'J ``(P + K, P + K)``."""
        C, V = self.log.part.linear, self.log.part.other
        out = np.empty((len(self.log.start), len(self.log.start)))
        across = self.log.white.jacobian.T @ self.own
        out[np.ix_(C, C)], out[np.ix_(V, V)] = self.log.white.normal, self.own.T @ self.own
        out[np.ix_(C, V)], out[np.ix_(V, C)] = across, across.T
        return out


@dataclass(frozen=True, eq=False)
class PartedPoint:
    """A log at one parameter vector.

    Attributes
    ----------
    theta
        ``(P + K,)``.
    own
        The residual of the parameters V alone ``(N, n)``, Nm.
    white
        The residual and its Jacobian, whitened.
    """

    theta: Array
    own: Array
    white: Whitened
    columns: _Columns

    @cached_property
    def residual(self) -> Array:
        """The residual ``(N, n)``, Nm: made where it is asked for, as it is at the end of a search alone."""
        return np.asarray(self.columns.log.part.left(self.theta) + self.own)

    @property
    def cost(self) -> float:
        """Sum of the whitened squares."""
        return float(self.white.residual @ self.white.residual)

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.white.residual)

    def normal(self) -> tuple[Array, Array]:
        """Normal matrix ``(P + K, P + K)`` and downhill gradient ``(P + K,)``."""
        gradient, log = np.empty(len(self.theta)), self.columns.log
        gradient[log.part.linear] = log.white.jacobian.T @ self.white.residual
        gradient[log.part.other] = self.columns.own.T @ self.white.residual
        return self.white.normal, gradient

    def covariance(self, precision: Array) -> Array:
        """Covariance of a fit that has ended here, with a prior of ``precision`` ``(P + K, P + K)``."""
        return covariance_of(self.white.normal, precision, self.cost, self.count)
