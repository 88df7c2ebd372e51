"""Fast normal equations of a pose fit with many amplitudes at few joints, such as curves over a joint's turn.

All amplitudes of a joint move a measurement in the same direction, that of the joint. With s_a the whitened derivative
(N, m) of the measurements by station a, and D_a (N, k) the derivative of the station by its amplitudes, the block of
stations a and b is

    A_ab = D_a' diag(sum_c s_ac s_bc) D_b

with the sum over the m channels. This takes N k^2 operations instead of N m k^2, and the Jacobian (N m, P) is not
formed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clampid.chain.chain import Deviations
from clampid.fitting.descent import covariance_of
from clampid.fitting.noise import Noise, Whitened
from clampid.stages import poses
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array, Integers

__all__ = ["AmplitudePoint", "has_many_amplitudes"]

LARGE = poses.PARAMETERS_OF_A_LARGE_CHAIN
ROWS_AT_ONCE = 512  # whose columns are formed together: more saves no time and needs more memory


def has_many_amplitudes(problem: FitProblem, noise: Noise) -> bool:
    """Whether the normal equations of this problem are computed faster by stations."""
    if not problem.kind.points or noise.autocorrelations or noise.level is not None:
        return False
    return bool(np.bincount(problem.chain.station, minlength=1).max() >= LARGE)


@dataclass(frozen=True)
class AmplitudePoint:
    """A pose fit at one parameter vector.

    Attributes
    ----------
    problem, noise
        What is fitted, and the noise that weights the rows.
    theta
        Parameters ``(P,)``, SI.
    residual
        ``(N, m)``, SI.
    sensitivity
        Derivative ``(N, m, S)`` of the measurements by the stations.
    deviations
        Deviations of the stations, and their derivatives by the parameters.
    """

    problem: FitProblem
    noise: Noise
    theta: Array
    residual: Array
    sensitivity: Array
    deviations: Deviations

    @staticmethod
    def at(problem: FitProblem, noise: Noise, theta: Array) -> AmplitudePoint:
        """The point of a problem of poses, flanks as they are frozen."""
        deviations = poses.evaluate(problem.rows, problem.chain, theta)
        return AmplitudePoint(problem, noise, theta, *poses.by_station(problem.rows, deviations), deviations)

    @cached_property
    def white(self) -> Whitened:
        """Residual and Jacobian, whitened; the Jacobian is computed when it is first used."""
        channel, entry = np.nonzero(self.problem.rows.used.T)
        known = self.__dict__.get("_normal", (None, None))[0]
        late = _Jacobian(self.problem, self.noise, self.theta, known)
        return Whitened(self._residual[entry, channel], late, entry, channel)

    @property
    def cost(self) -> float:
        """Sum of the whitened squares."""
        return float(np.sum(self._residual**2))

    @property
    def count(self) -> int:
        """Number of entries of the whitened residual."""
        return int(self.problem.rows.used.sum())

    def normal(self) -> tuple[Array, Array]:
        """Normal matrix ``(P, P)`` and downhill gradient ``(P,)``."""
        return self._normal

    def gradient(self) -> Array:
        """The downhill gradient ``(P,)`` alone, in a hundredth of the time."""
        d = self.deviations
        pull = np.einsum("nms,nm->ns", self._levers, self._residual)
        out = np.zeros(len(self.theta))
        for a, run in self.problem.chain.runs:
            np.add.at(out, d.parameter[run], d.partials[:, run].T @ pull[:, a])
        return out

    def covariance(self, precision: Array) -> Array:
        """Covariance ``(P, P)`` of a fit with its minimum here; ``precision`` ``(P, P)`` is that of the prior."""
        return covariance_of(self._normal[0], precision, self.cost, self.count)

    @cached_property
    def _residual(self) -> Array:
        """Residual ``(N, m)``, whitened."""
        return self._whitened(self.residual)

    @cached_property
    def _levers(self) -> Array:
        """Derivative ``(N, m, S)`` of the measurements by a deviation at each station, whitened."""
        moved = np.unique(self.deviations.station)
        out = np.zeros_like(self.sensitivity)
        out[:, :, moved] = self._whitened(self.sensitivity[:, :, moved])
        return out

    def _whitened(self, values: Array) -> Array:
        """Numbers ``(N, m, …)`` in units of their noise, zero where they are not used."""
        rows = self.problem.rows
        weight = np.where(rows.used, 1.0 / self.noise.sigma, 0.0)
        return np.asarray(rows.in_noise_axes(values) * weight.reshape(weight.shape + (1,) * (values.ndim - 2)))

    @cached_property
    def _normal(self) -> tuple[Array, Array]:
        """Normal matrix ``(P, P)`` and downhill gradient ``(P,)``: own curves by stations, all else by columns.

        Of a curve that joints share, each pair of joints would be multiplied; as columns it is multiplied once.
        """
        d, s = self.deviations, self._levers
        alone = np.bincount(d.parameter, minlength=len(self.theta))[d.parameter] == 1
        each = [(a, np.flatnonzero(alone[run]) + run.start) for a, run in self.problem.chain.runs]
        own = [(a, entries) for a, entries in each if len(entries) >= LARGE]
        apart = np.ones(len(d.station), dtype=bool)
        for _, entries in own:
            apart[entries] = False
        rest = np.flatnonzero(apart)
        A = np.zeros((len(self.theta), len(self.theta)))
        for first in range(0, len(s), ROWS_AT_ONCE):
            some = slice(first, first + ROWS_AT_ONCE)
            partials = d.partials[some]
            parameters, J = _columns(s[some], partials, d.station, d.parameter, rest)
            flat = J.reshape(-1, J.shape[2])
            A[np.ix_(parameters, parameters)] += flat.T @ flat
            curves = [(d.parameter[k], np.ascontiguousarray(s[some, :, a]), partials[:, k]) for a, k in own]
            for k, (mine, lever, by) in enumerate(curves):
                cross = by.T @ np.einsum("nc,ncp->np", lever, J)
                A[np.ix_(mine, parameters)] += cross
                A[np.ix_(parameters, mine)] += cross.T
                for number, (theirs, other, by_other) in enumerate(curves[k:]):
                    block = by.T @ (np.sum(lever * other, axis=1)[:, None] * by_other)
                    A[np.ix_(mine, theirs)] += block
                    if number:
                        A[np.ix_(theirs, mine)] += block.T
        return A, self.gradient()


@dataclass(frozen=True, eq=False)
class _Jacobian:
    """The whitened Jacobian of a point, computed when used; see :class:`clampid.fitting.noise.Late`."""

    problem: FitProblem
    noise: Noise
    theta: Array
    square: Array | None

    def normal(self) -> Array:
        """J'J ``(P, P)``."""
        return self._point._normal[0] if self.square is None else self.square

    @property
    def _point(self) -> AmplitudePoint:
        """The point, computed again: keeping it would keep its arrays."""
        return AmplitudePoint.at(self.problem, self.noise, self.theta)

    def dense(self) -> Array:
        """J ``(M, P)``."""
        point = self._point
        channel, entry = np.nonzero(self.problem.rows.used.T)
        return poses.by_parameter(point._levers, point.deviations, self.problem.chain)[entry, channel]


def _columns(
    s: Array, partials: Array, station: Integers, parameter: Integers, entries: Integers
) -> tuple[Integers, Array]:
    """The parameters ``(p,)`` of some entries of the derivatives, and their columns ``(N, m, p)``."""
    parameters, column, count = np.unique(parameter[entries], return_inverse=True, return_counts=True)
    out = np.zeros((*s.shape[:2], len(parameters)))
    one = count[column] == 1
    out[:, :, column[one]] = s[:, :, station[entries[one]]] * partials[:, None, entries[one]]
    several = entries[~one]
    # All masses change all joint loads, so this block is nearly full; so is that of a curve that joints share.
    large = (np.bincount(station[several], minlength=s.shape[2]) >= LARGE)[station[several]]
    for some in (several[large], several[~large]):
        if len(some):
            of, column = np.unique(parameter[some], return_inverse=True)
            stations, row = np.unique(station[some], return_inverse=True)
            block = np.zeros((len(s), len(stations), len(of)))
            block[:, row, column] = partials[:, some]
            at = np.searchsorted(parameters, of)
            beside = slice(at[0], at[-1] + 1) if at[-1] - at[0] + 1 == len(at) else at  # a slice needs no copies
            out[:, :, beside] += s[:, :, stations] @ block
    return parameters, out
