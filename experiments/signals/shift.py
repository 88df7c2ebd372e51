r"""The time shift between two logs, from their common signal, with its standard error.

One log, such as a motor's torque y, follows the motion up to unknown factors:

    y(t) = Σ_p β_p x_p(t - s) + Σ_r γ_r z_r(t - s) + e

with carriers x whose dependence on the motion is known, such as the shape of gravity, nuisances z, such as friction,
and s > 0 when y is logged late. Gauss-Newton on (β, γ, s). Only carriers determine s, and only by their part that no
β or γ can imitate: d = -Σ β_p x_p', projected off all x and z. (A friction that is modelled not quite right would
look like a shift of the motion's speed; a shift of viscous torque would look like inertia.) The standard error counts
moves as independent, not rows: Σ_moves (Σ_rows d·e)² / (Σ d²)², whatever the colour of the noise within them (Liang &
Zeger, Biometrika 73 (1986) 13).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.stats import t

from experiments.signals.typing_ import Array, Bools, Integers

__all__ = ["Shift", "combine_shifts", "time_shift"]

_ITERATIONS = 8
# Standard errors from fewer moves mean little.
_MOVES = 6


@dataclass(frozen=True)
class Shift:
    """A shift in time and how well it is known.

    Attributes
    ----------
    seconds
        Positive where the log comes late [s].
    std_error
        One standard error [s].
    freedom
        Degrees of freedom of the standard error.
    """

    seconds: float
    std_error: float
    freedom: float

    @property
    def p_value(self) -> float:
        """Probability of a shift of this size or more where there is none, by Student's t."""
        return float(2.0 * t.sf(abs(self.seconds) / self.std_error, self.freedom))


def time_shift(
    log: Array,
    carriers: Array,
    corrections: Array,
    nuisances: Array,
    time: Array,
    run: Integers,
    used: Bools,
    move: Integers,
) -> Shift | None:
    """Estimate how late a log is against the motion that drives it.

    Parameters
    ----------
    log
        What may be shifted ``(N,)``, such as a motor's torque.
    carriers
        Columns ``(N, p)`` on the motion's clock that the log is a sum of, with unknown factors; differentiable.
    corrections
        Columns ``(N, c)`` on that clock that make up for what the carriers' shape lacks, such as gravity of each
        link; they say nothing about the shift themselves. None where the carriers are free enough: ``(N, 0)``.
    nuisances
        Columns ``(N, k)`` on that clock that the log may contain as well, such as speeds, signs of motion and 1.
    time
        Stamps ``(N,)`` [s], increasing within runs.
    run
        Numbers of the runs ``(N,)``.
    used
        Rows ``(N,)`` of clear motion.
    move
        Number of the move of each row ``(N,)``; rows of one move may have noise in common, moves not.

    Returns
    -------
    Shift or None
        None where fewer than six moves, or too few rows, determine it, or the iteration does not settle.
    """
    pieces = [p for p in np.split(np.arange(len(time)), np.flatnonzero(run[1:] != run[:-1]) + 1) if len(p) > 3]
    splines = [(p, CubicSpline(time[p], np.hstack([carriers[p], corrections[p]]))) for p in pieces]
    shift, previous = 0.0, np.inf
    for _ in range(_ITERATIONS):
        linear = _linearised(log, splines, carriers.shape[1], nuisances, time, used, move, shift)
        if linear is None:
            return None
        change, error, moves = linear
        shift += change
        if abs(change) <= 0.05 * error:
            return Shift(shift, error, moves - 1.0)
        if abs(change) > 2.0 * previous:
            return None
        previous = abs(change)
    return None


def _linearised(
    log: Array,
    splines: Sequence[tuple[Integers, CubicSpline]],
    carriers: int,
    nuisances: Array,
    time: Array,
    used: Bools,
    move: Integers,
    shift: float,
) -> tuple[float, float, int] | None:
    """One step from a shift: its change [s], the standard error [s] and the number of moves."""
    values, rates, targets, others, group = [], [], [], [], []
    for rows, spline in splines:
        at = time[rows] - shift
        left = np.searchsorted(time[rows], at, side="right") - 1
        inside = np.flatnonzero((left >= 0) & (left < len(rows) - 1))
        before, after = rows[left[inside]], rows[left[inside] + 1]
        good = used[before] & used[after] & (move[before] == move[after])
        chosen = inside[good]
        values.append(spline(at[chosen]))
        rates.append(spline(at[chosen], 1))
        targets.append(log[rows[chosen]])
        # Nuisances need no derivative: linear interpolation between rows is accurate enough.
        part = ((at[chosen] - time[before[good]]) / (time[after[good]] - time[before[good]]))[:, None]
        others.append((1.0 - part) * nuisances[before[good]] + part * nuisances[after[good]])
        group.append(move[before[good]])
    x, rate, y = np.concatenate(values), np.concatenate(rates), np.concatenate(targets)
    z, p = np.concatenate(others), carriers
    moves, member = np.unique(np.concatenate(group), return_inverse=True)
    if len(moves) < _MOVES or len(y) < 2 * (z.shape[1] + p) + len(moves):
        return None
    shape = np.hstack([x[:, :p], z])
    factors = _factors(shape, y)
    # Carriers that explain less than half do not determine the shift: their factors would follow other errors.
    bare = y - z @ _factors(z, y)
    if np.sum(bare**2) < 2.0 * np.sum((y - shape @ factors) ** 2):
        return None
    slope = -rate[:, :p] @ factors[:p]
    columns = np.hstack([x, z])
    own = slope - columns @ _factors(columns, slope)
    residual = y - columns @ _factors(columns, y)
    power = float(own @ own)
    if power <= 1e-12 * float(slope @ slope):
        return None
    change = float(own @ residual) / power
    score = np.bincount(member, own * (residual - change * own))
    error = float(np.sqrt(np.sum(score**2) * len(moves) / (len(moves) - 1))) / power
    return (change, error, len(moves)) if error > 0.0 else None


def _factors(columns: Array, target: Array) -> Array:
    """Least squares by the normal matrix, small against the rows; directions below 1e-10 of the largest are omitted."""
    scale = np.sqrt(np.mean(columns**2, axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    unit = columns / scale
    return np.asarray(np.linalg.pinv(unit.T @ unit, rcond=1e-10, hermitian=True) @ (unit.T @ target) / scale)


def combine_shifts(shifts: Sequence[Shift]) -> Shift | None:
    """One shift of several logs on the same clock, such as all motors' torques.

    The mean, weighted by the inverse variances plus the variance between logs (random effects: DerSimonian & Laird,
    Controlled Clinical Trials 7 (1986) 177): what no single log's error knows of, such as friction that a model lacks,
    differs between motors and so counts as error. Its degrees of freedom are those of both parts of the variance
    (Satterthwaite, Biometrics Bulletin 2 (1946) 110): the moves' as long as logs agree, the logs' where they do not.

    Parameters
    ----------
    shifts
        One per log.

    Returns
    -------
    Shift or None
        None for fewer than two logs.
    """
    if len(shifts) < 2:
        return None
    values, errors = np.array([s.seconds for s in shifts]), np.array([s.std_error for s in shifts])
    freedom = np.array([s.freedom for s in shifts])
    # An error known from few moves only is as good as a larger one known well.
    errors = errors * np.sqrt(freedom / np.maximum(freedom - 2.0, 1.0))
    weights = errors**-2.0
    mean = float(weights @ values / weights.sum())
    excess = float(weights @ (values - mean) ** 2) - (len(values) - 1)
    between = max(excess / (weights.sum() - (weights**2).sum() / weights.sum()), 0.0)
    weights = 1.0 / (errors**2 + between)
    mean = float(weights @ values / weights.sum())
    share = weights / weights.sum()
    within, across = share**2 * errors**2, float(np.sum(share**2) * between)
    variance = float(within.sum()) + across
    known = variance**2 / (float(np.sum(within**2 / freedom)) + across**2 / (len(values) - 1))
    return Shift(mean, float(np.sqrt(variance)), known)
