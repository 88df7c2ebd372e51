"""Faster fits of torque logs: the model is linear in most parameters, such as masses and frictions.

The derivative by a linear parameter is the same at every point. Its columns are therefore computed once for several
searches of the same rows, and whitened once in each search. At each point only the columns of the other parameters
(shapes) are computed and whitened. With C the linear parameters, V the others, and v the residual of V alone,

    r(theta) = r(theta_0) + v(theta_V) - v(theta_0V) - J_C (theta_C - theta_0C)

A gain g of a motor's reading scales L, the torque that the arm asks of it, which is linear in C. At each point the
columns of C that are part of L are those without gain times 1 + g, and the column of g is L itself.

Source of the division: Golub & Pereyra, Separable nonlinear least squares: the variable projection method and its
applications, Inverse Problems 19, 2003. Unlike there, no parameter is eliminated, so priors apply unchanged.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

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
        Numbers of the parameters C and V, among all P + K; gains of readings are in neither.
    residual
        Residual at C = 0 without gains, less that of V alone ``(N, n)``, Nm.
    columns
        Derivative of the prediction by C without gains ``(N, n, C)``, Nm per SI unit.
    loaded
        Numbers of the columns that are part of the torque that gains scale.
    load
        That torque at C = 0 ``(N, n)``, Nm; zero of motors without gain.
    """

    problem: FitProblem
    linear: Integers
    other: Integers
    residual: Array
    columns: Array
    loaded: Integers
    load: Array

    @staticmethod
    def of(problem: FitProblem, at: Array) -> LinearPart:
        """The linear part of a problem of the stage ``free_air``, computed at any parameters ``at`` ``(P + K,)``."""
        chain, kinds = problem.chain, np.zeros(len(at), dtype=int)
        number, motor, loaded = chain.gains
        kinds[: len(chain.slots)][chain.bends], kinds[number] = 1, 2
        linear, other = np.flatnonzero(kinds == 0), np.flatnonzero(kinds == 1)
        at = np.where(kinds == 2, 0.0, at)
        residual, jacobian = problem.residual(at)
        columns = jacobian if len(linear) == len(at) else jacobian[:, :, linear]
        left = residual + columns @ at[linear]
        if len(other):
            left -= _nonlinear(problem).error(np.r_[at[other], np.zeros(problem.offsets)])
        loads = np.searchsorted(linear, np.flatnonzero(loaded))
        part = LinearPart(problem, linear, other, left, columns, loads, np.zeros_like(left))
        for k, c in zip(number, motor, strict=True):
            part.load[:, c] = jacobian[:, c, k] - columns[:, c, part.loaded] @ at[linear[part.loaded]]
        return part

    def serves(self, problem: FitProblem) -> bool:
        """Whether ``problem`` has the same effects and rows; which of the rows are used may differ."""
        mine, theirs = self.problem.rows, problem.rows
        same_rows = mine.signals is theirs.signals and mine.measured is theirs.measured
        return self.problem.chain is problem.chain and same_rows

    def left(self, theta: Array) -> Array:
        """Residual ``(N, n)``, Nm, at parameters ``theta`` ``(P + K,)``, less that of V alone."""
        left = self.residual - self.columns @ theta[self.linear]
        for k, c in zip(*self.problem.chain.gains[:2], strict=True):
            left[:, c] -= theta[k] * self.scaled(theta, c)
        return np.asarray(left)

    def scaled(self, theta: Array, motor: int) -> Array:
        """The torque that a gain of this motor scales ``(N,)``, Nm."""
        return np.asarray(self.load[:, motor] + self.columns[:, motor, self.loaded] @ theta[self.linear[self.loaded]])


def _nonlinear(problem: FitProblem) -> FitProblem:
    """The problem with the parameters V only."""
    chain = problem.chain.bent
    return replace(problem, slots=chain.slots, chain=chain)


class _Channel(NamedTuple):
    """One motor's whitened rows.

    ``rows``: which they are. ``linear`` ``(m, C)`` and ``normal`` ``(C, C)``: their columns of C without gain, and the
    product of these. ``gain``: number of the motor's gain among all parameters, or None.
    """

    rows: slice
    linear: Array
    normal: Array
    gain: int | None


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
        Initial parameters ``(P + K,)``, SI, gains zero.
    white
        There, whitened: the residual less that of V alone ``(M,)``, the columns of C ``(M, C)``.
    load
        There, whitened: the torque that gains scale ``(M,)``; empty without gains.
    """

    nonlinear: FitProblem
    noise: Noise
    part: LinearPart
    start: Array
    white: Whitened
    load: Array

    @staticmethod
    def of(problem: FitProblem, noise: Noise, start: Array, part: LinearPart | None = None) -> PartedLog:
        """The log of a problem of the stage ``free_air`` with linear parameters; ``part`` is computed if not given."""
        part = part or LinearPart.of(problem, start)
        start = start.copy()
        start[problem.chain.gains.number] = 0.0
        white = noise.whiten(problem.rows, part.left(start), part.columns)
        load = np.zeros(0)
        if len(problem.chain.gains.motor):
            torque = np.zeros_like(part.load)
            for c in problem.chain.gains.motor:
                torque[:, c] = part.scaled(start, c)
            load = noise.whiten(problem.rows, torque, np.zeros((*torque.shape, 0))).residual
        return PartedLog(_nonlinear(problem), noise, part, start, white, load)

    @cached_property
    def channels(self) -> list[_Channel]:
        """The whitened rows motor by motor."""
        number, motor, _ = self.part.problem.chain.gains
        gains = dict(zip(motor.tolist(), number.tolist(), strict=True))
        edges = np.flatnonzero(np.diff(self.white.channel, prepend=-1, append=-1))
        found = []
        for a, b in pairwise(edges.tolist()):
            own = self.white.jacobian[a:b]
            found.append(_Channel(slice(a, b), own, own.T @ own, gains.get(int(self.white.channel[a]))))
        return found

    def at(self, theta: Array) -> PartedPoint:
        """The log at parameters ``theta`` ``(P + K,)``."""
        step = (theta - self.start)[self.part.linear]
        left, load = self.white.residual - self.white.jacobian @ step, self.load
        own, white = np.zeros_like(self.part.residual), np.zeros((len(left), 0))
        if len(self.part.other):
            of_v = np.r_[theta[self.part.other], np.zeros(self.nonlinear.offsets)]
            own, derivative = self.nonlinear.residual(of_v)
            found = self.noise.whiten(self.nonlinear.rows, own, derivative[:, :, : len(self.part.other)])
            left += found.residual
            white = found.jacobian
        if len(load):
            of_load = np.zeros_like(step)  # a product with all columns takes less time than to gather some
            of_load[self.part.loaded] = step[self.part.loaded]
            load = load + self.white.jacobian @ of_load
        for channel in self.channels:
            if channel.gain is not None:
                left[channel.rows] -= theta[channel.gain] * load[channel.rows]
        columns = _Columns(self, white, theta, load)
        there = Whitened(left, columns, self.white.entry, self.white.channel)
        return PartedPoint(theta, own, there, columns)


@dataclass(frozen=True, eq=False)
class _Columns:
    """The whitened Jacobian of a point, computed when used; see :class:`clampid.fitting.noise.Late`.

    ``own`` ``(M, V)``: whitened columns of the parameters V. ``load`` ``(M,)``: the whitened torque that gains scale.
    """

    log: PartedLog
    own: Array
    theta: Array
    load: Array

    def by_channel(self) -> Iterator[tuple[_Channel, Array, Integers, Array]]:
        """Motor by motor: its rows, factors ``(C,)`` of its columns of C, its other parameters and their columns."""
        part = self.log.part
        for channel in self.log.channels:
            scale, number, own = np.ones(len(part.linear)), part.other, self.own[channel.rows]
            if channel.gain is not None:
                scale[part.loaded] += self.theta[channel.gain]
                number, own = np.r_[number, channel.gain], np.c_[own, self.load[channel.rows]]
            yield channel, scale, number, own

    def dense(self) -> Array:
        """The whole Jacobian J ``(M, P + K)``."""
        out = np.zeros((len(self.own), len(self.log.start)))
        for channel, scale, number, own in self.by_channel():
            linear = channel.linear if channel.gain is None else channel.linear * scale
            put_columns(out[channel.rows], self.log.part.linear, linear)
            put_columns(out[channel.rows], number, own)
        return out

    def normal(self) -> Array:
        """J'J ``(P + K, P + K)``."""
        C, out = self.log.part.linear, np.zeros((len(self.log.start), len(self.log.start)))
        for channel, scale, V, own in self.by_channel():
            across = scale[:, None] * (channel.linear.T @ own)
            out[np.ix_(C, C)] += channel.normal * np.outer(scale, scale)
            out[np.ix_(V, V)] += own.T @ own
            out[np.ix_(C, V)] += across
            out[np.ix_(V, C)] += across.T
        return out

    def gradient(self, residual: Array) -> Array:
        """J'r ``(P + K,)`` of a whitened residual r ``(M,)``."""
        out = np.zeros(len(self.log.start))
        for channel, scale, V, own in self.by_channel():
            out[self.log.part.linear] += scale * (channel.linear.T @ residual[channel.rows])
            out[V] += own.T @ residual[channel.rows]
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
        return self.white.normal, self.columns.gradient(self.white.residual)

    def covariance(self, precision: Array) -> Array:
        """Covariance ``(P + K, P + K)`` of a fit with its minimum here; ``precision`` is that of the prior."""
        return covariance_of(self.white.normal, precision, self.cost, self.count)
