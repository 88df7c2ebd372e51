"""Finds that a clamp rocks, from motors that stand while another one is driven.

A block that stands unevenly tilts from one rest to another when the load on it changes its sign, and back when the load
turns. Each standing motor's torque then has, beside what it may follow in any case (`experiments.runs.slips`),

    tau = ... + s r,   min(max(r, f(u - u+)), f(u - u-)) -> r,   f(x) = x/w, bounded to ±1/2

with the same s at every turn: the block tilts at a wind-up of u+ on the way forward and at u- <= u+ on the way back,
within w of the driven joint's way. Each (u-, u+, w) of a grid is tried in the sweep's rows alone. A size over its
standard error follows Student's distribution, its degrees of freedom lessened by the noise's autocorrelation; squares
of the equivalent normal scores are added over the standing motors (chi-squared). A tilt also has to give way: the
flange moves as the load pushes. A clearance that a standing drive crosses looks alike, and pushes back. And it
has to explain more than u^3: a block that yields gets stiffer smoothly.

The probability is multiplied by the number of grid points and by the number of sweeps of the plan (Bonferroni), so that
`FALSE_ALARM` is the chance of one false alarm in a whole run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from experiments.plans.motion import Array
from experiments.plans.press import motor_torques, wrench
from experiments.runs.slips import USUAL, SweepRows, design_of, inflation
from kinematics.description import RobotDescription

__all__ = ["FALSE_ALARM", "Rocking", "find_rocking"]

FALSE_ALARM = 1e-3  # per run: the chance that a clamp that does not rock is said to
LEAST_TURNS = 3  # of the block in a sweep; one or two are a shift, or one and its way back
EDGE = 3  # readings in either rest
WIDTHS = (0.01, 0.25, 0.5, 1.0)  # of the largest wind-up: over how much of the way the block tilts
POWERS = (1,)  # of the wind-up, which a torque may follow without a tilt
LEAST_LEFT = 0.02  # of a template's squares: the rest is what a torque may follow without a tilt

Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Rocking:
    """A clamp that rocks.

    Attributes
    ----------
    sweep
        Its number.
    turns
        How often the block tilted in it.
    size
        About how far, m, from rest to rest, with springs as described.
    forward, backward
        At which wind-up of the driven joint it tilts on the way forward and back, rad.
    p_value
        Over all that was tried in the run.
    """

    sweep: int
    turns: int
    size: float
    forward: float
    backward: float
    p_value: float


def find_rocking(
    rows: SweepRows, robot: RobotDescription, stiffness: Array, jacobian: Array, joint: int, sweeps: int = 1
) -> Rocking | None:
    """Whether the clamp rocked during one sweep.

    Parameters
    ----------
    rows
        Readings of the sweep.
    stiffness
        Of the drives as described, Nm/rad at the motors, ``(n,)``.
    jacobian
        ``(6, n)`` of the flange in the clamped posture.
    joint
        The driven one, from 0.
    sweeps
        Of the plan: so many times this is asked in the run.
    """
    pairs, states = _states(rows.offset)
    still = np.flatnonzero(~rows.turned).astype(np.int64)
    if not len(pairs) or not len(still):
        return None
    size, error, freedom = _sizes(rows, still, states)
    known = np.isfinite(error) & (error > 0.0)
    squares = _squares(size, error, freedom)
    p = stats.chi2.sf(squares, np.maximum(known.sum(axis=0), 1)) * len(pairs) * sweeps
    best = int(np.argmin(p))
    if p[best] > FALSE_ALARM or not known[:, best].any():
        return None
    bent = (rows.offset / np.max(np.abs(rows.offset)))[:, None] ** 3
    if _squares(*_sizes(rows, still, bent))[0] >= squares[best]:
        return None
    use = known[:, best]
    shift = _tilt(size[use, best], error[use, best], still[use], robot, stiffness, jacobian)
    if shift @ _push(robot, stiffness, jacobian, joint) <= 0.0:
        return None
    turns = int(_turns(states[:, [best]])[0])
    forward, backward = (float(value) for value in pairs[best])
    return Rocking(rows.number, turns, float(np.linalg.norm(shift)), forward, backward, float(p[best]))


def _states(offset: Array) -> tuple[Array, Array]:
    """Where a block may tilt forward and back ``(R, 2)``, rad, and how it lies at each reading then ``(m, R)``."""
    levels = np.unique(np.r_[0.0, offset])
    between = (levels[1:] + levels[:-1]) / 2
    most = float(np.max(np.abs(offset)))
    grid = [(f, b, w) for k, b in enumerate(between) for f in between[k:] for w in WIDTHS]
    forward, backward, width = np.array(grid).T * np.array([[1.0], [1.0], [most]])
    states = np.empty((len(offset), len(grid)))
    state = sum(np.clip(-centre / width, -0.5, 0.5) for centre in (forward, backward)) / 2
    for k, u in enumerate(offset):
        least, largest = (np.clip((u - centre) / width, -0.5, 0.5) for centre in (forward, backward))
        states[k] = state = np.minimum(np.maximum(state, least), largest)
    rests = np.minimum(np.sum(states > 0, axis=0), np.sum(states < 0, axis=0))
    kept = (rests >= EDGE) & (_turns(states) >= LEAST_TURNS)
    return np.column_stack([forward, backward])[kept], states[:, kept]


def _turns(states: Array) -> npt.NDArray[np.int64]:
    """How often each column changes its sign ``(R,)``."""
    return np.asarray(np.count_nonzero(np.diff(states > 0.0, axis=0), axis=0), dtype=np.int64)


def _sizes(rows: SweepRows, still: Indices, states: Array) -> tuple[Array, Array, Array]:
    """Size of the alternating step ``(s, R)``, Nm, its standard error, and degrees of freedom ``(s,)``, by motor."""
    design = design_of([rows], [True], POWERS)
    basis, values, _ = np.linalg.svd(design, full_matrices=False)
    basis = basis[:, values > values[0] * 1e-9]
    free = states - basis @ (basis.T @ states)
    norm = np.sum(free**2, axis=0)
    enough = norm > LEAST_LEFT * np.sum(states**2, axis=0)
    left = rows.torque[:, still] - basis @ (basis.T @ rows.torque[:, still])  # (m, s)
    size = np.where(enough, (left.T @ free) / np.where(enough, norm, 1.0), 0.0)
    count = max(len(states) - basis.shape[1] - 1, 1)
    error, freedom = np.full_like(size, np.inf), np.ones(len(still))
    for k in range(len(still)):
        best = int(np.argmax(np.where(enough, size[k] ** 2 * norm, -1.0)))
        rest = left[:, k] - free[:, best] * size[k, best]
        more = inflation(rest)
        square = np.maximum(left[:, k] @ left[:, k] - size[k] ** 2 * norm, 1e-30) / count
        error[k] = np.where(enough, np.sqrt(square * more / np.where(enough, norm, 1.0)), np.inf)
        freedom[k] = max(count / more, 1.0)
    return size, error, freedom


def _squares(size: Array, error: Array, freedom: Array) -> Array:
    """Squares of normal scores, added over the motors ``(R,)``."""
    known = np.isfinite(error) & (error > 0.0)
    score = np.where(known, size / np.where(known, error, 1.0), 0.0)
    half = stats.t.sf(np.abs(score), freedom[:, None])
    return np.asarray(np.where(known, stats.norm.isf(np.maximum(half, 1e-300)) ** 2, 0.0).sum(axis=0))


def _tilt(
    size: Array, error: Array, motors: Indices, robot: RobotDescription, stiffness: Array, jacobian: Array
) -> Array:
    """How the flange moves from rest to rest ``(3,)``, m, if it does not turn; a usual size as prior."""
    wound = np.asarray(-np.linalg.pinv(jacobian)[:, :3].T, dtype=np.float64)
    torque = motor_torques(robot, stiffness, np.zeros(robot.n), wound)[:, motors].T
    prior = np.eye(3) / USUAL
    return np.asarray(np.linalg.lstsq(np.vstack([torque / error[:, None], prior]), np.r_[size / error, np.zeros(3)])[0])


def _push(robot: RobotDescription, stiffness: Array, jacobian: Array, joint: int) -> Array:
    """Force ``(3,)``, N, that a joint driven forward by 1 rad puts on the clamp."""
    turn = np.zeros((1, robot.n))
    turn[0, joint] = 1.0
    none = np.zeros(robot.n)
    return np.asarray(wrench(robot, jacobian, none, motor_torques(robot, stiffness, none, turn))[0, :3])
