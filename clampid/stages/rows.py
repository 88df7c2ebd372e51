"""Rows: what an experiment measured and under which signals, ready for the chain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from clampid.effect import Stage
from clampid.slots import Layout
from kinematics.description import RobotDescription

__all__ = ["Array", "Bools", "Integers", "Rows"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Rows:
    """The rows of one stage, of one or several sessions.

    Attributes
    ----------
    signals
        Name → ``(N, …)``, as :data:`clampid.effect.SIGNALS` describes them; SI.
    measured
        ``(N, m)``: points and rotations in the instrument's frame, or motor torques.
    sigma
        ``(N, m)``: standard deviation of each measured number, as far as known before any fit.
    used
        ``(N, m)``: False where a number does not count (a motor at rest, no orientation, an outlier).
    unit
        ``(N,)``: rows that share their noise (the visit of a pose, a block of a log).
    fold
        ``(N,)``: rows that must stay together in cross-validation (all visits of a pose, a run).
    table, row
        Where each row stands in the campaign: name of the table, and row in it from 1.
    session
        ``(N,)``: index of the session.
    constants
        What belongs to the experiment and not to a row, such as reference frames.
    """

    stage: Stage
    robot: RobotDescription
    layout: Layout
    signals: Mapping[str, Array]
    measured: Array
    sigma: Array
    used: Bools
    unit: Integers
    fold: Integers
    table: npt.NDArray[np.str_]
    row: Integers
    session: Integers
    constants: Mapping[str, Any] = field(default_factory=dict)
    per_row: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.measured)

    def take(self, chosen: npt.NDArray[Any]) -> Rows:
        """The chosen rows (indices or mask)."""
        constants = {k: (v[chosen] if k in self.per_row else v) for k, v in self.constants.items()}
        return replace(
            self,
            signals={k: v[chosen] for k, v in self.signals.items()},
            measured=self.measured[chosen],
            sigma=self.sigma[chosen],
            used=self.used[chosen],
            unit=self.unit[chosen],
            fold=self.fold[chosen],
            table=self.table[chosen],
            row=self.row[chosen],
            session=self.session[chosen],
            constants=constants,
        )

    def without(self, bad: Bools) -> Rows:
        """The same rows, those marked ``(N,)`` no longer used."""
        return replace(self, used=self.used & ~bad[:, None])
