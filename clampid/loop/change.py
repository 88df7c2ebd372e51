"""Change of a held-out error, with a standard error from pairs of whole poses or runs.

Two models are judged on the same rows. The rows of one pose share its error, so one pose is one observation. In a log,
one run or sweep is one observation. With d_u the sum over unit u of the squares after minus those before, and n_u its
count,

    D = sum d_u / sum n_u,   var D = U/(U - 1) sum (d_u - D n_u)^2 / (sum n_u)^2

is a ratio estimate with its variance (Cochran, Sampling Techniques, 1977, section 2.11). Errors are root mean squares:
they change by D / (after + before).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clampid.fitting.accuracy import Floor, size_of, unseen
from clampid.identification.fitted_stage import FittedStage
from clampid.stages.rows import Array, Integers, Rows

__all__ = ["Change", "change_between", "paired_change"]

SAME_FIT = 1e-6  # of an error: two fits of the same model differ by less


@dataclass(frozen=True)
class Change:
    """A held-out error before and after, of the rows that count in both.

    Attributes
    ----------
    before, after
        Root mean squares; m for poses, for torques in units of the motors' noise.
    std
        Standard error of ``after - before``; infinite with fewer than two poses or runs.
    units
        Number of whole poses, runs or sweeps.
    """

    before: float
    after: float
    std: float
    units: int

    @property
    def rise(self) -> float:
        """The error after minus that before; negative if it has fallen."""
        return self.after - self.before

    @property
    def worse(self) -> bool:
        """Whether the error has risen by more than its standard error, and beyond rounding.

        With fewer than two poses or runs there is no standard error, and any rise counts.
        """
        least = self.std if math.isfinite(self.std) else 0.0
        return self.rise > max(least, SAME_FIT * self.before)

    @property
    def within_noise(self) -> bool:
        """Whether the change, up or down, is within its standard error."""
        return math.isfinite(self.std) and abs(self.rise) <= self.std


def change_between(
    before: FittedStage,
    after: FittedStage,
    held_out: Sequence[Sequence[int]],
    verification: Rows | None,
    seed: int,
    floor: Floor,
) -> Change:
    """The change of a stage's held-out error from one fit to another.

    Parameters
    ----------
    before, after
        Fits of the same rows.
    held_out
        Numbers of the folds that no fit has seen, for each campaign.
    verification
        Rows of a table that no fit sees, if there is one.
    floor
        The noise floor, which is the unit of torques.
    """
    (old, was), (new, now) = (unseen(f.estimate, f.rows, held_out, verification, seed) for f in (before, after))
    (size_old, counts_old), (size_new, counts_new) = size_of(old, was, floor), size_of(new, now, floor)
    both = counts_old & counts_new
    fold = new.fold if both.ndim == 1 else np.repeat(new.fold[:, None], both.shape[1], axis=1)
    return paired_change(size_old[both] ** 2, size_new[both] ** 2, fold[both])


def paired_change(before: Array, after: Array, unit: Integers) -> Change:
    """The change of a root mean square, with the standard error of a ratio estimate.

    Parameters
    ----------
    before, after
        Squared errors ``(N,)``.
    unit
        ``(N,)``: number of the observation to which each error belongs.
    """
    found, index = np.unique(unit, return_inverse=True)
    size = np.bincount(index).astype(float)
    difference = np.bincount(index, after - before)
    mean, count = float(difference.sum() / size.sum()), len(found)
    ends = math.sqrt(float(np.mean(before))), math.sqrt(float(np.mean(after)))
    if count < 2:
        return Change(*ends, math.inf, count)
    spread = count / (count - 1) * float(np.sum((difference - mean * size) ** 2)) / size.sum() ** 2
    return Change(*ends, math.sqrt(spread) / max(sum(ends), 1e-300), count)
