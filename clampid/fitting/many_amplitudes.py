"""A pose fit with many amplitudes at few joints, as curves over a joint's turn have: its normal equations by joints.

All amplitudes of a joint move a measurement in the one direction in which the joint does. With s_a the whitened
derivative (N, m) of the measurements by station a, and D_a (N, k) that of the station by its amplitudes, their block is

    A_ab = D_a' diag(sum_c s_a s_b) D_b

which takes N k^2 operations instead of N m k^2, and never the Jacobian (N m, P) itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clampid.chain.chain import Deviations
from clampid.fitting.descent import covariance_of
from clampid.fitting.noise import Noise, Whitened
from clampid.stages import poses
from clampid.stages.experiment import Experiment
from clampid.stages.rows import Array, Integers

__all__ = ["AmplitudePoint", "has_many_amplitudes"]

MANY = 24  # amplitudes at one station, from which on its block is worth a product of its own


def has_many_amplitudes(experiment: Experiment, noise: Noise) -> bool:
    """Whether normal equations of this experiment are found faster by stations."""
    if experiment.stage != "poses" or noise.autocorrelations:
        return False
    return bool(np.bincount(experiment.chain.station, minlength=1).max() >= MANY)


@dataclass(frozen=True)
class AmplitudePoint:
    """A pose fit at one parameter vector ``(P,)``, its residual ``(N, m)`` given, and what it depends on.

    ``sensitivity`` ``(N, m, S)`` is the derivative of the measurements by the stations.
    """

    experiment: Experiment
    noise: Noise
    theta: Array
    residual: Array
    sensitivity: Array
    deviations: Deviations

    @staticmethod
    def at(experiment: Experiment, noise: Noise, theta: Array) -> AmplitudePoint:
        """The point of an experiment of poses, flanks as they are held."""
        deviations = poses.evaluate(experiment.rows, experiment.chain, theta)
        return AmplitudePoint(experiment, noise, theta, *poses.by_station(experiment.rows, deviations), deviations)

    @cached_property
    def white(self) -> Whitened:
        """Residual and Jacobian, whitened."""
        jacobian = poses.by_parameter(self.sensitivity, self.deviations, self.experiment.chain)
        return self.noise.whiten(self.experiment.rows, self.residual, jacobian)

    @property
    def cost(self) -> float:
        """Sum of the whitened squares."""
        return float(np.sum(self._residual**2))

    @property
    def count(self) -> int:
        """How many there are."""
        return int(self.experiment.rows.used.sum())

    def normal(self) -> tuple[Array, Array]:
        """Normal matrix ``(P, P)`` and downhill gradient ``(P,)``."""
        return self._normal

    def covariance(self, precision: Array) -> Array:
        """Covariance ``(P, P)`` of a fit that has ended here, with a prior of ``precision`` ``(P, P)``."""
        return covariance_of(self._normal[0], precision, self.cost, self.count)

    @cached_property
    def _residual(self) -> Array:
        return self._whitened(self.residual)

    def _whitened(self, values: Array) -> Array:
        """Numbers ``(N, m, …)`` in units of their noise, zero where they are not used."""
        rows = self.experiment.rows
        weight = np.where(rows.used, 1.0 / self.noise.sigma, 0.0)
        return np.asarray(rows.in_noise_axes(values) * weight.reshape(weight.shape + (1,) * (values.ndim - 2)))

    @cached_property
    def _normal(self) -> tuple[Array, Array]:
        d, r = self.deviations, self._residual
        moved = np.unique(d.station)
        s = np.zeros_like(self.sensitivity)
        s[:, :, moved] = self._whitened(self.sensitivity[:, :, moved])
        entries = {int(a): np.flatnonzero(d.station == a) for a in moved}
        many = {a: index for a, index in entries.items() if len(index) >= MANY}
        few = np.concatenate([i for a, i in entries.items() if a not in many] or [np.zeros(0, np.int64)])
        A, g = np.zeros((len(self.theta), len(self.theta))), np.zeros(len(self.theta))

        parameters, J = _columns(s, d, few)
        A[np.ix_(parameters, parameters)] += np.tensordot(J, J, axes=((0, 1), (0, 1)))
        g[parameters] += np.tensordot(J, r, axes=((0, 1), (0, 1)))
        partials = {a: d.partials[:, index] for a, index in many.items()}
        for a, index in many.items():
            own = d.parameter[index]
            g[own] += partials[a].T @ np.sum(s[:, :, a] * r, axis=1)
            cross = partials[a].T @ np.einsum("nc,ncp->np", s[:, :, a], J)
            A[np.ix_(own, parameters)] += cross
            A[np.ix_(parameters, own)] += cross.T
            for b in many:
                if b < a:
                    continue
                together = np.sum(s[:, :, a] * s[:, :, b], axis=1)
                block = partials[a].T @ (together[:, None] * partials[b])
                theirs = d.parameter[many[b]]
                A[np.ix_(own, theirs)] += block
                if b != a:
                    A[np.ix_(theirs, own)] += block.T
        return A, g


def _columns(s: Array, d: Deviations, entries: Integers) -> tuple[Integers, Array]:
    """The parameters ``(p,)`` of some entries of the derivatives, and their columns ``(N, m, p)``."""
    parameters, column = np.unique(d.parameter[entries], return_inverse=True)
    stations, row = np.unique(d.station[entries], return_inverse=True)
    block = np.zeros((len(s), len(stations), len(parameters)))
    block[:, row, column] = d.partials[:, entries]
    return parameters, s[:, :, stations] @ block
