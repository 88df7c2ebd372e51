"""Finds a clamp that has shifted, from the motors at rest while another one is driven.

A motor that stands keeps its friction, and its spring keeps its wind-up, unless the flange moves. Its torque is then

    tau = constant + drift t + a u + b u^3 + c |u| + d dir,   u: how far the driven joint is wound up

with another constant after each sweep that turned it. The coefficients a, b, c, d of each sweep describe a block that
yields. A clamp that shifts adds a step at one time to every motor at once. The step is looked for at every row, with
the noise's autocorrelation allowed for, and judged by chi-squared over the standing motors, times the rows tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from experiments.plans.motion import Array
from experiments.runs.yielding import flange_shift
from kinematics.description import RobotDescription

__all__ = ["Shift", "SweepRows", "find_shift"]

P_VALUE = 1e-10  # familywise over the rows tried; small, because a few dozen rows determine their noise poorly
EDGE = 4  # rows on either side of a step
LAGS = 8  # of the autocorrelation
LEAST_INFLATION = 2.0  # motor torques drift over seconds; a few dozen rows underestimate this


@dataclass(frozen=True, eq=False)
class SweepRows:
    """Readings of one sweep.

    Attributes
    ----------
    number
        From 1.
    time, offset, direction
        ``(m,)``: s, rad of the driven joint beyond the clamped posture, and which way it came, ±1.
    torque
        ``(m, n)`` Nm at the motors.
    turned
        Which motors turn in it ``(n,)``.
    """

    number: int
    time: Array
    offset: Array
    direction: Array
    torque: Array
    turned: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Shift:
    """A shift that was found.

    Attributes
    ----------
    sweep, step
        Before which reading, from 1.
    size
        About how far, m, with springs as described.
    p_value
        Familywise.
    """

    sweep: int
    step: int
    size: float
    p_value: float


def find_shift(sweeps: Sequence[SweepRows], robot: RobotDescription, stiffness: Array, jacobian: Array) -> Shift | None:
    """The likeliest shift of one clamping, if there is one; steps are tried in the last two sweeps.

    Parameters
    ----------
    sweeps
        All of this clamping, in order.
    stiffness
        Of the drives as described, Nm/rad at the motors, ``(n,)``.
    jacobian
        ``(6, n)`` of the flange in the clamped posture.
    """
    lengths = [len(s.time) for s in sweeps]
    total, first = sum(lengths), sum(lengths[:-2])
    places = np.arange(max(first, EDGE), total - EDGE)
    if not len(places):
        return None
    steps = (np.arange(total)[:, None] >= places).astype(float)  # (N, R)
    found = [_steps_of(sweeps, i, steps) for i in range(robot.n)]
    sizes, errors = (np.array([f[k] for f in found]) for k in range(2))  # (n, R)
    known = np.isfinite(errors) & (errors > 0)
    score = np.sum(np.where(known, sizes / np.where(known, errors, 1.0), 0.0) ** 2, axis=0)
    p = stats.chi2.sf(score, np.maximum(known.sum(axis=0), 1)) * len(places)
    best = int(np.argmin(p))
    if p[best] > P_VALUE:
        return None
    sweep, step = _place(int(places[best]), lengths)
    use = known[:, best]
    motors = np.flatnonzero(use).astype(np.int64)
    moved = flange_shift(sizes[use, best], errors[use, best], motors, robot, stiffness, jacobian)
    return Shift(sweeps[sweep].number, step, float(np.linalg.norm(moved)), float(p[best]))


def _place(row: int, lengths: Sequence[int]) -> tuple[int, int]:
    for sweep, length in enumerate(lengths):
        if row < length:
            return sweep, row + 1
        row -= length
    raise AssertionError("unreachable")


def _steps_of(sweeps: Sequence[SweepRows], motor: int, steps: Array) -> tuple[Array, Array]:
    """Size of a step at each place ``(R,)`` in one motor's torque, and its standard error; infinite: not known."""
    still = [not s.turned[motor] for s in sweeps]
    rows = np.concatenate([np.full(len(s.time), keep) for s, keep in zip(sweeps, still, strict=True)])
    unknown = np.zeros(steps.shape[1]), np.full(steps.shape[1], np.inf)
    if rows.sum() < 4 * EDGE:
        return unknown
    design = design_of(sweeps, still)
    y = np.concatenate([s.torque[:, motor] for s, keep in zip(sweeps, still, strict=True) if keep])
    basis, _ = np.linalg.qr(design)
    rank = np.linalg.matrix_rank(design)
    if rank < design.shape[1]:
        u, s, _ = np.linalg.svd(design, full_matrices=False)
        basis = u[:, s > s[0] * 1e-9]
    free = steps[rows] - basis @ (basis.T @ steps[rows])
    y = y - basis @ (basis.T @ y)
    norm = np.sum(free**2, axis=0)
    enough = norm > EDGE / 2
    size = np.where(enough, free.T @ y / np.where(enough, norm, 1.0), 0.0)
    rest = (y @ y - size**2 * norm) / max(len(y) - basis.shape[1] - 1, 1)
    best = y - free[:, int(np.argmax(size**2 * norm))] * size[int(np.argmax(size**2 * norm))]
    error = np.sqrt(np.maximum(rest, 1e-30) * inflation(best) / np.where(enough, norm, 1.0))
    return size, np.where(enough, error, np.inf)


def design_of(sweeps: Sequence[SweepRows], still: Sequence[bool], powers: Sequence[int] = (1, 3)) -> Array:
    """Regressors of a standing motor's torque without a shift, ``(m, p)``; one constant for each time it stood.

    ``powers`` of the wind-up, besides its magnitude and the direction.
    """
    segment = np.cumsum([not keep for keep in still])
    count = sum(len(s.time) for s, keep in zip(sweeps, still, strict=True) if keep)
    columns: list[Array] = []
    time = np.concatenate([s.time for s, keep in zip(sweeps, still, strict=True) if keep])
    columns.append((time - time.mean()) / max(float(np.ptp(time)), 1.0))
    constants: dict[int, Array] = {}
    at = 0
    for number, (sweep, keep) in enumerate(zip(sweeps, still, strict=True)):
        if not keep:
            continue
        own = slice(at, at + len(sweep.time))
        at += len(sweep.time)
        constants.setdefault(int(segment[number]), np.zeros(count))[own] = 1.0
        u = sweep.offset / max(float(np.max(np.abs(sweep.offset))), 1e-12)
        for values in (*(u**power for power in powers), np.abs(u), sweep.direction):
            column = np.zeros(count)
            column[own] = values - values.mean()
            columns.append(column)
    return np.array([*constants.values(), *columns]).T


def inflation(rest: Array) -> float:
    """By how much correlated noise makes the variance of a mean larger than independent noise."""
    rest = rest - rest.mean()
    power = float(rest @ rest)
    if power <= 0.0:
        return 1.0
    lags = [float(rest[k:] @ rest[:-k]) / power for k in range(1, min(LAGS, len(rest) // 4) + 1)]
    return max(1.0 + 2.0 * sum(max(lag, 0.0) for lag in lags), LEAST_INFLATION)
