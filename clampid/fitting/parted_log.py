"""A torque log while parameters are searched of which most are linear: masses and frictions beside a few shapes.

By a linear parameter the derivative is the same at every point, and so are its whitened columns and their products:
they are made once a search. At a point only the others' columns are made and whitened. With C the linear parameters, V
the others, and v the residual of these alone,

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
from clampid.stages.experiment import Experiment
from clampid.stages.rows import Array, Integers

__all__ = ["PartedLog", "PartedPoint"]


@dataclass(frozen=True, eq=False)
class PartedLog:
    """A log about the start of a search.

    Attributes
    ----------
    bent
        The experiment with the parameters V alone.
    linear, other
        Which parameters are C and V.
    start
        ``(P + K,)``.
    residual, columns
        ``(N, n)`` there, less that of V alone; and ``(N, n, C)``, Nm.
    white
        The same residual ``(M,)`` and columns ``(M, C)``, whitened.
    """

    bent: Experiment
    noise: Noise
    linear: Integers
    other: Integers
    start: Array
    residual: Array
    columns: Array
    white: Whitened

    @staticmethod
    def of(experiment: Experiment, noise: Noise, start: Array) -> PartedLog:
        """The log of an experiment of ``free_air`` that has linear parameters."""
        bends = np.r_[experiment.chain.bends, np.zeros(experiment.offsets, dtype=bool)]
        linear, other = np.flatnonzero(~bends), np.flatnonzero(bends)
        chain = experiment.chain.bent
        bent = replace(experiment, slots=chain.slots, chain=chain)
        residual, jacobian = experiment.residual(start)
        left = residual - bent.error(np.r_[start[other], np.zeros(experiment.offsets)])
        columns = jacobian[:, :, linear]
        white = noise.whiten(experiment.rows, left, columns)
        return PartedLog(bent, noise, linear, other, start, left, columns, white)

    def at(self, theta: Array) -> PartedPoint:
        """The log at other parameters ``(P + K,)``."""
        step = theta[self.linear] - self.start[self.linear]
        own, derivative = self.bent.derivative(np.r_[theta[self.other], np.zeros(self.bent.offsets)], 0)
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
        out[:, self.log.linear], out[:, self.log.other] = self.log.white.jacobian, self.own
        return out

    def normal(self) -> Array:
        """J'J ``(P + K, P + K)``."""
        C, V = self.log.linear, self.log.other
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
        log = self.columns.log
        step = self.theta[log.linear] - log.start[log.linear]
        return np.asarray(log.residual - log.columns @ step + self.own)

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
        gradient[log.linear] = log.white.jacobian.T @ self.white.residual
        gradient[log.other] = self.columns.own.T @ self.white.residual
        return self.white.normal, gradient

    def covariance(self, precision: Array) -> Array:
        """Covariance of a fit that has ended here, with a prior of ``precision`` ``(P + K, P + K)``."""
        return covariance_of(self.white.normal, precision, self.cost, self.count)
