"""Faster fits of torque logs: the model is linear in most parameters, such as masses and frictions.

The derivative by a linear parameter is the same at every point. Its columns are therefore computed once for several
searches of the same rows, and whitened once in each search. At each point only the columns of the other parameters
(shapes) are computed and whitened. With C the linear parameters, V the others, and v the residual of V alone,

    r(theta) = r(theta_0) + v(theta_V) - v(theta_0V) - J_C (theta_C - theta_0C)

Source of the division: Golub & Pereyra, Separable nonlinear least squares: the variable projection method and its
applications, Inverse Problems 19, 2003. Unlike there, no parameter is eliminated, so priors apply unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from clampid.fitting.descent import covariance_of
from clampid.fitting.noise import Noise, Whitened, put_columns
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array, Integers

__all__ = ["LinearPart", "PartedLog", "PartedPoint"]


@dataclass(frozen=True, eq=False)
class LinearPart:
    """The part of a log's model that is linear in the parameters C; it depends neither on V nor on weights.

    Attributes
    ----------
    problem
        The problem that it was computed for.
    linear, other
        Numbers of the parameters C and V, among all P + K.
    residual
        Residual at C = 0 less that of V alone ``(N, n)``, Nm.
    columns
        Derivative of the prediction by C ``(N, n, C)``, Nm per SI unit.
    """

    problem: FitProblem
    linear: Integers
    other: Integers
    residual: Array
    columns: Array

    @staticmethod
    def of(problem: FitProblem, at: Array) -> LinearPart:
        """The linear part of a problem of the stage ``free_air``, computed at any parameters ``at`` ``(P + K,)``."""
        bends = np.r_[problem.chain.bends, np.zeros(problem.offsets, dtype=bool)]
        linear, other = np.flatnonzero(~bends), np.flatnonzero(bends)
        residual, jacobian = problem.residual(at)
        columns = jacobian if not len(other) else jacobian[:, :, linear]
        left = residual + columns @ at[linear]
        if len(other):
            left -= _nonlinear(problem).error(np.r_[at[other], np.zeros(problem.offsets)])
        return LinearPart(problem, linear, other, left, columns)

    def serves(self, problem: FitProblem) -> bool:
        """Whether ``problem`` has the same effects and rows; which of the rows are used may differ."""
        mine, theirs = self.problem.rows, problem.rows
        same_rows = mine.signals is theirs.signals and mine.measured is theirs.measured
        return self.problem.chain is problem.chain and same_rows

    def left(self, theta: Array) -> Array:
        """Residual ``(N, n)``, Nm, at parameters ``theta`` ``(P + K,)``, less that of V alone."""
        return np.asarray(self.residual - self.columns @ theta[self.linear])


def _nonlinear(problem: FitProblem) -> FitProblem:
    """The problem with the parameters V only."""
    chain = problem.chain.bent
    return replace(problem, slots=chain.slots, chain=chain)


@dataclass(frozen=True, eq=False)
class PartedLog:
    """A log with the whitened columns of its linear parameters, for one search.

    Attributes
    ----------
    nonlinear
        The problem with the parameters V only.
    noise
        The noise that whitens the rows.
    part
        The linear part of the model.
    start
        Initial parameters ``(P + K,)``, SI.
    white
        At the initial parameters, whitened: the residual less that of V alone ``(M,)``, the columns of C ``(M, C)``.
    """

    nonlinear: FitProblem
    noise: Noise
    part: LinearPart
    start: Array
    white: Whitened

    @staticmethod
    def of(problem: FitProblem, noise: Noise, start: Array, part: LinearPart | None = None) -> PartedLog:
        """The log of a problem of the stage ``free_air`` with linear parameters; ``part`` is computed if not given."""
        part = part or LinearPart.of(problem, start)
        white = noise.whiten(problem.rows, part.left(start), part.columns)
        return PartedLog(_nonlinear(problem), noise, part, start, white)

    def at(self, theta: Array) -> PartedPoint:
        """The log at parameters ``theta`` ``(P + K,)``."""
        step = (theta - self.start)[self.part.linear]
        own, derivative = self.nonlinear.derivative(np.r_[theta[self.part.other], np.zeros(self.nonlinear.offsets)], 0)
        white = self.noise.whiten(self.nonlinear.rows, own, derivative)
        left = self.white.residual - self.white.jacobian @ step + white.residual
        columns = _Columns(self, white.jacobian)
        there = Whitened(left, columns, self.white.entry, self.white.channel)
        return PartedPoint(theta, own, there, columns)


@dataclass(frozen=True, eq=False)
class _Columns:
    """The whitened Jacobian of a point, computed when used; see :class:`clampid.fitting.noise.Late`.

    ``own`` ``(M, V)``: whitened columns of the parameters V.
    """

    log: PartedLog
    own: Array

    def dense(self) -> Array:
        """The whole Jacobian J ``(M, P + K)``."""
        out = np.empty((len(self.own), len(self.log.start)))
        put_columns(out, self.log.part.linear, self.log.white.jacobian)
        put_columns(out, self.log.part.other, self.own)
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
        Parameters ``(P + K,)``, SI.
    own
        Residual of the parameters V alone ``(N, n)``, Nm.
    white
        Residual and Jacobian, whitened.
    columns
        The Jacobian's parts.
    """

    theta: Array
    own: Array
    white: Whitened
    columns: _Columns

    @cached_property
    def residual(self) -> Array:
        """Residual ``(N, n)``, Nm; computed when first used, which is only at the end of a search."""
        return np.asarray(self.columns.log.part.left(self.theta) + self.own)

    @property
    def cost(self) -> float:
        """Sum of squares of the whitened residual."""
        return float(self.white.residual @ self.white.residual)

    @property
    def count(self) -> int:
        """Number of entries of the whitened residual."""
        return len(self.white.residual)

    def normal(self) -> tuple[Array, Array]:
        """Normal matrix ``(P + K, P + K)`` and downhill gradient ``(P + K,)``."""
        gradient, log = np.empty(len(self.theta)), self.columns.log
        gradient[log.part.linear] = log.white.jacobian.T @ self.white.residual
        gradient[log.part.other] = self.columns.own.T @ self.white.residual
        return self.white.normal, gradient

    def covariance(self, precision: Array) -> Array:
        """Covariance ``(P + K, P + K)`` of a fit with its minimum here; ``precision`` is that of the prior."""
        return covariance_of(self.white.normal, precision, self.cost, self.count)
