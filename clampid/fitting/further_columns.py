"""Columns of parameters that a fit does not have, at its solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from clampid.fitting.noise import SparseColumns, Whitened
from clampid.fitting.solve import Estimate
from clampid.slots import Slot
from clampid.stages.rows import Array

__all__ = ["Derivatives", "whitened_columns"]

Key = tuple[tuple[Slot, ...], tuple[float, ...]]


@dataclass(frozen=True)
class Derivatives:
    """Derivatives of a log's predictions by further parameters at the solution of one fit, as far as they are known.

    They are whitened by one noise after the other, until it is known whether readings wander. Of other stages nothing
    is kept: their derivatives are large, and few of the numbers are zero.

    Attributes
    ----------
    known
        Slots and their values → derivatives.
    """

    known: dict[Key, SparseColumns] = field(default_factory=dict)

    def of(self, estimate: Estimate, extra: Sequence[Slot], values: Sequence[float] | Array) -> Whitened:
        """As `whitened_columns`."""
        if not estimate.noise.autocorrelations:
            return whitened_columns(estimate, extra, values)
        key = tuple(extra), tuple(float(v) for v in values)
        if key not in self.known:
            self.known[key] = SparseColumns.of(_derivative(estimate, extra, values))
        return estimate.noise.whiten_sparse(estimate.problem.rows, estimate.residual, self.known[key])


def whitened_columns(estimate: Estimate, extra: Sequence[Slot], values: Sequence[float] | Array) -> Whitened:
    """Whitened columns ``(M, E)`` of E further slots at the solution of a fit.

    ``values`` ``(E,)``: values of the further slots, SI; zero for amplitudes.
    """
    rows, derivative = estimate.problem.rows, _derivative(estimate, extra, values)
    return estimate.noise.whiten(rows, estimate.residual, derivative, estimate.whitened.filters)


def _derivative(estimate: Estimate, extra: Sequence[Slot], values: Sequence[float] | Array) -> Array:
    """Derivative of the prediction by E further slots ``(N, m, E)``, SI."""
    count = len(estimate.slots)
    trial = estimate.problem.with_slots((*estimate.slots, *extra))
    return trial.derivative(np.r_[estimate.theta[:count], values, estimate.theta[count:]], count)
