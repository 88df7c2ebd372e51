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


def has_many_amplitudes(problem: FitProblem, noise: Noise) -> bool:
    """Whether the normal equations of this problem are computed faster by stations."""
    if not problem.kind.points or noise.autocorrelations or noise.wander:
        return False
    return bool(np.bincount(problem.chain.station, minlength=1).max() >= poses.PARAMETERS_OF_A_LARGE_CHAIN)


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
        """Normal matrix ``(P, P)`` and downhill gradient ``(P,)``, computed by stations."""
        d, s = self.deviations, self._levers
        many = [
            (a, run) for a, run in self.problem.chain.runs if run.stop - run.start >= poses.PARAMETERS_OF_A_LARGE_CHAIN
        ]
        apart = np.ones(len(d.station), dtype=bool)
        for _, run in many:
            apart[run] = False
        A = np.zeros((len(self.theta), len(self.theta)))

        parameters, J = _columns(s, d, np.flatnonzero(apart))
        flat = J.reshape(-1, J.shape[2])
        A[np.ix_(parameters, parameters)] += flat.T @ flat
        levers = [np.ascontiguousarray(s[:, :, a]) for a, _ in many]
        for k, (a, run) in enumerate(many):
            own, partials = d.parameter[run], d.partials[:, run]
            cross = partials.T @ np.einsum("nc,ncp->np", levers[k], J)
            A[np.ix_(own, parameters)] += cross
            A[np.ix_(parameters, own)] += cross.T
            for lever, (b, other) in zip(levers[k:], many[k:], strict=True):
                together = np.sum(levers[k] * lever, axis=1)
                block = partials.T @ (together[:, None] * d.partials[:, other])
                theirs = d.parameter[other]
                A[np.ix_(own, theirs)] += block
                if b != a:
                    A[np.ix_(theirs, own)] += block.T
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


def _columns(s: Array, d: Deviations, entries: Integers) -> tuple[Integers, Array]:
    """The parameters ``(p,)`` of some entries of the derivatives, and their columns ``(N, m, p)``."""
    parameters, column, count = np.unique(d.parameter[entries], return_inverse=True, return_counts=True)
    out = np.zeros((*s.shape[:2], len(parameters)))
    one = count[column] == 1
    out[:, :, column[one]] = s[:, :, d.station[entries[one]]] * d.partials[:, None, entries[one]]
    several = entries[~one]
    if len(several):  # all masses change all joint loads, so this block is nearly full
        of, column = np.unique(d.parameter[several], return_inverse=True)
        stations, row = np.unique(d.station[several], return_inverse=True)
        block = np.zeros((len(s), len(stations), len(of)))
        block[:, row, column] = d.partials[:, several]
        out[:, :, np.searchsorted(parameters, of)] = s[:, :, stations] @ block
    return parameters, out
