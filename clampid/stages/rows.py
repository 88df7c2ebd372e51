"""Rows: the measured numbers of an experiment with their signals, ready for the chain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from clampid.effect import Stage
from clampid.slots import Layout
from clampid.stages.row_constants import LogConstants, PoseConstants, RowConstants, SeriesConstants, SweepConstants
from clampid.stages.stage_kind import StageKind, kind_of
from experiments.signals import segments
from kinematics.description import RobotDescription

__all__ = ["POSE_CHANNELS", "Array", "Bools", "Integers", "Rows", "lengths"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

C = TypeVar("C", bound=RowConstants)

POSE_CHANNELS = ((0, 1, 2), (3, 4, 5), (6,))
"""Columns of what poses measure: position, rotation, distance; the last ones only where any row has them."""


@dataclass(frozen=True)
class Rows:
    """The rows of one stage, of one or several sessions.

    Attributes
    ----------
    signals
        Name → ``(N, …)``, as :data:`clampid.effect.SIGNALS` describes them; SI.
    measured
        ``(N, m)``: points, rotations, both in the instrument's frame, and distances (:data:`POSE_CHANNELS`), or motor
        torques.
    sigma
        ``(N, m)``: standard deviation of each measured number, as far as known before any fit; where ``constants`` have
        ``noise_axes`` ``(N, 3, 3)`` (columns: unit vectors), of positions along these, in which errors are independent.
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
        Constants of the rows beside their signals, such as reference frames.
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
    constants: RowConstants

    def __len__(self) -> int:
        return len(self.measured)

    @property
    def kind(self) -> StageKind:
        """The stage as a value."""
        return kind_of(self.stage)

    @property
    def series(self) -> SeriesConstants:
        """The constants of rows that follow each other in runs or sweeps."""
        return self._of(SeriesConstants)

    @property
    def log(self) -> LogConstants:
        """The constants of a torque log."""
        return self._of(LogConstants)

    @property
    def sweep(self) -> SweepConstants:
        """The constants of clamped sweeps."""
        return self._of(SweepConstants)

    @property
    def pose(self) -> PoseConstants:
        """The constants of measured points and distances."""
        return self._of(PoseConstants)

    def _of(self, kind: type[C]) -> C:
        if not isinstance(self.constants, kind):
            raise TypeError(f"rows of {self.stage} have {type(self.constants).__name__}, expected {kind.__name__}")
        return self.constants

    def take(self, chosen: npt.NDArray[Any]) -> Rows:
        """The chosen rows (indices or mask)."""
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
            constants=self.constants.take(chosen),
        )

    @property
    def local_fold(self) -> Integers:
        """Folds numbered from 0 within each session ``(N,)``: the same whichever sessions are read."""
        out = self.fold.copy()
        for s in np.unique(self.session):
            _, out[self.session == s] = np.unique(self.fold[self.session == s], return_inverse=True)
        return out

    def shuffled_folds(self, seed: int) -> Integers:
        """The folds in random order, alike ones (the same table, the same joint driven) next to each other.

        Taking every fifth of them then never takes all sweeps of a joint at once, where there are several.
        """
        folds, first = np.unique(self.fold, return_index=True)
        none = np.zeros(len(self), dtype=np.int64)
        driven = self.constants.driven if isinstance(self.constants, SweepConstants) else none
        order = np.random.default_rng(seed).permutation(len(folds))
        kind = [(str(self.table[first[k]]), int(driven[first[k]])) for k in order]
        return np.asarray(folds[order[sorted(range(len(order)), key=lambda i: kind[i])]])

    def in_folds(self, held_out: Sequence[Sequence[int]]) -> Bools:
        """Which rows ``(N,)`` are in the given folds (per session their local numbers)."""
        out, local = np.zeros(len(self), dtype=bool), self.local_fold
        for s, folds in enumerate(held_out):
            out |= (self.session == s) & np.isin(local, list(folds))
        return out

    def outside(self, held_out: Sequence[Sequence[int]]) -> Rows:
        """All rows but those of the given folds: the same object each time, as dozens of fits keep it."""
        key = tuple(tuple(folds) for folds in held_out)
        if key not in self._outside:
            self._outside[key] = self.take(~self.in_folds(held_out)) if key else self
        return self._outside[key]

    @cached_property
    def _outside(self) -> dict[tuple[tuple[int, ...], ...], Rows]:
        return {}

    @property
    def offset_keys(self) -> Integers:
        """``(K, 2)``: see :class:`clampid.stages.row_constants.SeriesConstants`; none of rows that are no series."""
        own = self.constants
        return own.offset_keys if isinstance(own, SeriesConstants) else np.zeros((0, 2), dtype=np.int64)

    @property
    def offsets(self) -> int:
        """K: how many unknown constants the runs or sweeps have."""
        return len(self.offset_keys)

    def offset_table(self, offsets: Array, kinds: int = 1) -> Array:
        """Offsets ``(K,)`` as a value per row and joint ``(N, n)``; of several kinds ``(N, kinds n)``, one by one."""
        keys, run = self.series.offset_keys, self.series.run
        table = np.zeros((int(run.max(initial=0)) + 1, kinds * self.robot.n))
        table[keys[:, 0], keys[:, 1]] = offsets
        return np.asarray(table[run])

    @cached_property
    def stretch(self) -> Integers:
        """The stretch of a log ``(N,)`` that each row is of; between two, the clock breaks off."""
        return segments(self.series.run, self.constants.time, np.ones(len(self), dtype=bool))

    @property
    def oriented(self) -> bool:
        """Whether any row of poses has a rotation."""
        width = self.measured.shape[1]
        return width == 6 or (width > 6 and bool(self.pose.oriented.any()))

    @property
    def ranged(self) -> Bools:
        """Which rows of poses ``(N,)`` are distances."""
        return np.asarray(self.pose.ranged, dtype=bool)

    @property
    def points(self) -> Rows:
        """The rows of poses that are no distances, and no column for these."""
        if self.measured.shape[1] <= 6:
            return self
        width = 6 if self.oriented else 3
        rows = self.take(~self.ranged)
        return replace(rows, measured=rows.measured[:, :width], sigma=rows.sigma[:, :width], used=rows.used[:, :width])

    def in_noise_axes(self, values: Array) -> Array:
        """The same numbers ``(N, m, …)``, positions turned to the axes that ``sigma`` is along."""
        axes = self.constants.noise_axes
        if axes is None:
            return values
        out = values.copy()
        out[:, :3] = np.einsum("nji,nj...->ni...", axes, values[:, :3])
        return out

    def without(self, bad: Bools) -> Rows:
        """The same rows, those marked ``(N,)`` no longer used."""
        return replace(self, used=self.used & ~bad[:, None])


def lengths(residual: Array) -> Array:
    """Errors of poses ``(N,)``, m, of their residual ``(N, m)``: of a point its norm, of a distance its size."""
    return np.asarray(np.linalg.norm(np.c_[residual[:, :3], residual[:, 6:]], axis=1))
