"""Turns of the base that the measured points leave open, and what that leaves open of all other parameters.

Points on a line are the same whichever way the robot is turned about it, points at one place whichever way at all. The
points of a described robot are off by e (its geometry's reasonable sizes), so that points with the root mean square
distance d from an axis determine the turn about it to e / d. If that is more than a small angle, a fit's standard
errors hold only for the turn at which it started: after half a turn, an effect such as a clearance appears with the
other sign. Information of the effects on the turn is not used: which effects there are is what the diagnosis decides,
and an effect that the model lacks would select a wrong turn.

So a fit starts at the turn of which the rows are likeliest, out of many about the open axes. Afterwards turns are drawn
from what points and statements (:mod:`clampid.stages.statements`) say of them, with all other parameters as they fit
best there, to first order, and the second moment of these about the estimate is added to its covariance: the law of
total variance, with the turn as what is conditioned on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from clampid.display import number
from clampid.fitting.noise import Noise, initial_noise
from clampid.fitting.solve import Estimate, prior_of, stage_point, start_of
from clampid.role_slots import slot_of
from clampid.slots import Prior
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array, Rows
from clampid.stages.statements import stated_equations
from kinematics.screws import exp_so3, inverse, log_se3

__all__ = ["OpenTurn", "from_likeliest_turn", "open_turns", "with_open_base"]

SMALL_TURN = 0.1  # rad: a turn that is off by less changes what an effect shows along its own direction by 0.5 %
POINT_ERROR_M, POINT_ERROR_RAD = 1e-3, 2e-3  # what a link of a described robot is off by, as `geometry` has it
TRIMMED = 0.05  # of the points, those farthest off: a wrong row must not make an area of a line
BASE_DRAWS, SEED = 64, 0
COARSE, FINE = 36, 11  # turns about one open axis that a fit tries, all round and between two of these
SEVERAL = 300  # turns about several


@dataclass(frozen=True)
class OpenTurn:
    """How far a session's base may be turned.

    Attributes
    ----------
    session
        From 0.
    centre
        ``(3,)``, m, instrument frame: the middle of the points.
    axes, std
        ``(k, 3)``, unit vectors in the instrument frame, and ``(k,)``, rad: open axes, and to what the turn about each
        is known.
    spread
        m: root mean square distance of the points from the most open axis.
    """

    session: int
    centre: Array
    axes: Array
    std: Array
    spread: float

    def by(self, turn: Array) -> Array:
        """The motion ``(4, 4)`` in the instrument's frame by angles ``(k,)`` about the axes."""
        out = np.eye(4)
        out[:3, :3] = exp_so3(turn @ self.axes)
        out[:3, 3] = self.centre - out[:3, :3] @ self.centre
        return out

    def words(self, name: str) -> str:
        """What is open, and what to state or measure to determine it."""
        about = "the line on which the points lie" if len(self.axes) == 1 else "the place at which the points lie"
        return (
            f"turn of the base about {about} (session {name}; they are {number(1e3 * self.spread, 2)} mm off it): "
            "parameters that depend on it are not identifiable; state [base] in campaign.toml, or measure "
            "points off the line"
        )


def open_turns(rows: Rows) -> tuple[OpenTurn, ...]:
    """The turns that rows of poses leave open, session by session; none where orientations were measured."""
    if not rows.kind.points:
        return ()
    found = []
    error = float(np.hypot(POINT_ERROR_M, POINT_ERROR_RAD * rows.robot.stretched))
    for session in np.unique(rows.session):
        mine = (rows.session == session) & ~rows.ranged & rows.used[:, :3].all(axis=1)
        if not mine.any() or rows.pose.oriented[mine].any():
            continue
        turn = _open(rows, int(session), rows.measured[mine, :3], error)
        if turn is not None:
            found.append(turn)
    return tuple(found)


def _open(rows: Rows, session: int, points: Array, error: float) -> OpenTurn | None:
    centre = np.median(points, axis=0)
    far = np.linalg.norm(points - centre, axis=1)
    off = points - centre
    direction = linalg.svd(off[far <= np.quantile(far, 1.0 - TRIMMED)], full_matrices=False)[2][0]
    across = np.linalg.norm(off - np.outer(off @ direction, direction), axis=1)
    kept = off[across <= np.quantile(across, 1.0 - TRIMMED)]
    lever = np.mean(np.sum(kept**2, axis=1)) * np.eye(3) - kept.T @ kept / len(kept)
    precision = lever / error**2 + _stated(rows, session, centre)
    values, vectors = np.linalg.eigh(precision)
    std = 1.0 / np.sqrt(np.maximum(values, 1e-12))
    loose = std > SMALL_TURN
    if not loose.any():
        return None
    axes = vectors.T[loose]
    return OpenTurn(session, centre, axes, std[loose], float(np.sqrt(max(axes[0] @ lever @ axes[0], 0.0))))


def _stated(rows: Rows, session: int, centre: Array) -> Array:
    """What is stated of a turn about the points' centre ``(3, 3)``, 1/rad², instrument axes."""
    place = rows.layout.sessions[session]
    slots = [slot_of("base_frame", place, a) for a in ("rx", "ry", "rz", "x", "y", "z")]
    at, matrix, _ = stated_equations(rows.constants.stated, {slot: k for k, slot in enumerate(slots)})
    if not len(at):
        return np.zeros((3, 3))
    X = _reference(rows, session)
    lever = X[:3, 3] - centre
    cross = np.array([[0.0, -lever[2], lever[1]], [lever[2], 0.0, -lever[0]], [-lever[1], lever[0], 0.0]])
    by_turn = np.vstack([X[:3, :3].T, -X[:3, :3].T @ cross])[at]  # what a turn does to (w, v)
    return np.asarray((matrix @ by_turn).T @ (matrix @ by_turn))


def _reference(rows: Rows, session: int) -> Array:
    return np.asarray(rows.pose.base_reference[np.flatnonzero(rows.session == session)[0]])


def _turned(rows: Rows, turn: OpenTurn, angles: Array) -> Rows:
    """The rows with the base of one session turned by angles ``(k,)``."""
    reference = rows.pose.base_reference.copy()
    mine = rows.session == turn.session
    reference[mine] = turn.by(angles) @ reference[mine]
    return replace(rows, constants=replace(rows.pose, base_reference=reference))


def from_likeliest_turn(problem: FitProblem, priors: Sequence[Prior]) -> Rows:
    """The problem's rows with each open base turned to where they are likeliest, by one step of a fit at each turn.

    At the right turn one step is nearly the whole way: a described robot is nearly the robot. Elsewhere it leaves more.
    """
    rows = problem.rows
    for turn in open_turns(rows):
        if len(turn.axes) == 1:
            reach = min(np.pi, 3.0 * float(turn.std[0]))
            step = 2.0 * reach / COARSE
            coarse = np.linspace(-reach, reach, COARSE, endpoint=False)[:, None]
            best = _likeliest(problem, rows, turn, np.vstack([np.zeros((1, 1)), coarse]), priors)
            fine = best + np.linspace(-0.5, 0.5, FINE)[:, None] * step
            best = _likeliest(problem, rows, turn, fine, priors)
        else:
            drawn = _draws(turn, np.random.default_rng(SEED), SEVERAL)
            best = _likeliest(problem, rows, turn, np.vstack([np.zeros((1, len(turn.axes))), drawn]), priors)
        rows = _turned(rows, turn, best)
    return rows


def _likeliest(problem: FitProblem, rows: Rows, turn: OpenTurn, angles: Array, priors: Sequence[Prior]) -> Array:
    precision, mean = prior_of(problem, priors)
    theta, noise = start_of(problem, None, priors), initial_noise(rows)
    mean = np.where(problem.fixed(), theta, mean)

    def cost(angle: Array) -> float:
        there = problem.with_rows(_turned(rows, turn, angle))
        at = _stepped(there, noise, theta, precision, mean)
        off = at - mean
        return stage_point(there, noise, at).cost + float(off @ precision @ off)

    return np.asarray(angles[int(np.argmin([cost(a) for a in angles]))])


def _stepped(problem: FitProblem, noise: Noise, theta: Array, precision: Array, mean: Array) -> Array:
    """Where one step of Gauss and Newton leads from ``theta`` ``(P,)``."""
    A, g = stage_point(problem, noise, theta).normal()
    size = 1.0 / np.sqrt(np.maximum(np.diag(A + precision), 1e-300))
    scaled = (A + precision) * np.outer(size, size)
    step = linalg.lstsq(scaled, size * (g - precision @ (theta - mean)))[0]
    return np.asarray(theta + size * step)


def _draws(turn: OpenTurn, rng: np.random.Generator, count: int) -> Array:
    """Turns ``(count, k)``, rad, within half a revolution."""
    free = turn.std * rng.standard_normal((count, len(turn.std)))
    return np.asarray((free + np.pi) % (2.0 * np.pi) - np.pi)


def with_open_base(estimate: Estimate) -> Estimate:
    """The same pose fit with what open turns of the base leave open of all parameters in its covariance."""
    rows = estimate.problem.rows
    turns = open_turns(rows)
    if not turns:
        return estimate
    rng = np.random.default_rng(SEED)
    angles = [_draws(turn, rng, BASE_DRAWS) for turn in turns]
    index = {slot: k for k, slot in enumerate(estimate.slots)}
    off = np.zeros((BASE_DRAWS, len(estimate.theta)))
    for k in range(BASE_DRAWS):
        there = rows
        for turn, drawn in zip(turns, angles, strict=True):
            there = _turned(there, turn, drawn[k])
            X = _reference(rows, turn.session)
            moved = log_se3(inverse(X) @ turn.by(drawn[k]) @ X)
            for name, value in zip(("rx", "ry", "rz", "x", "y", "z"), moved, strict=True):
                slot = slot_of("base_frame", rows.layout.sessions[turn.session], name)
                if slot in index:
                    off[k, index[slot]] += value
        trial = estimate.problem.with_rows(there)
        at = _stepped(trial, estimate.noise, estimate.theta, estimate.prior_precision, estimate.prior_mean)
        off[k] += at - estimate.theta
    return replace(estimate, covariance=estimate.covariance + off.T @ off / BASE_DRAWS)
