"""Rotations of the base that the measured points do not identify, and their share of all covariances.

Points on a line do not identify the rotation of the robot's base about this line. Points at one place identify no
rotation. The points of a described robot have errors of about e, from the reasonable sizes of its geometry. Points
with the root mean square distance d from an axis therefore determine the rotation about it to e / d. If that is more
than a small angle, the standard errors of a fit hold only for the rotation at which it started: after half a turn, an
effect such as a clearance appears with the opposite sign. The effects' own information on the rotation is not used. The
diagnosis has yet to decide which effects act, and a missing effect would select a wrong rotation.

A fit therefore starts at the likeliest of many rotations about the open axes. Afterwards, rotations are drawn from the
distribution that points and statements (:mod:`clampid.stages.statements`) give them. All other parameters are fitted
to each of them to first order, and their second moment about the estimate is added to its covariance: the law of total
variance, conditioned on the rotation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from clampid.display import number
from clampid.fitting.noise import Noise, initial_noise
from clampid.fitting.prior_and_start import prior_of, start_of
from clampid.fitting.solve import Estimate, stage_point
from clampid.role_slots import slot_of
from clampid.slots import Prior
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array, Rows
from clampid.stages.statements import stated_equations
from kinematics.screws import exp_so3, inverse, log_se3

__all__ = ["OpenTurn", "from_likeliest_turn", "open_turns", "with_open_base"]

SMALL_TURN = 0.1  # rad: a smaller error of the rotation changes the projection of an effect by 0.5 % (cosine)
POINT_ERROR_M, POINT_ERROR_RAD = 1e-3, 2e-3  # errors of a described link, the reasonable sizes of its geometry
TRIMMED = 0.05  # share of the points, the farthest, left out: one wrong row must not turn a line into an area
BASE_DRAWS, SEED = 64, 0
COARSE_TURNS, FINE_TURNS = 36, 11  # rotations tried about a single open axis: over its whole range, then about the best
RANDOM_TURNS = 300  # rotations tried about several open axes


@dataclass(frozen=True)
class OpenTurn:
    """The rotations of one session's base that its points do not identify.

    Attributes
    ----------
    session
        Number of the session, from 0.
    centre
        Median ``(3,)`` of the points, m, instrument frame.
    axes, std
        Open axes ``(k, 3)``, unit vectors in the instrument frame, and the standard deviation of the rotation about
        each ``(k,)``, rad.
    spread
        Root mean square distance of the points from the least known axis, m.
    """

    session: int
    centre: Array
    axes: Array
    std: Array
    spread: float

    def by(self, turn: Array) -> Array:
        """Rigid motion ``(4, 4)``, instrument frame: rotation by ``turn`` ``(k,)``, rad, about the axes at centre."""
        out = np.eye(4)
        out[:3, :3] = exp_so3(turn @ self.axes)
        out[:3, 3] = self.centre - out[:3, :3] @ self.centre
        return out

    def words(self, name: str) -> str:
        """A sentence for people: what is not identified, and what to state or measure. ``name``: of the session."""
        about = "the line on which the points lie" if len(self.axes) == 1 else "the place at which the points lie"
        return (
            f"turn of the base about {about} (session {name}; they are {number(1e3 * self.spread, 2)} mm off it): "
            "parameters that depend on it are not identifiable; state [base] in campaign.toml, or measure "
            "points off the line"
        )


def open_turns(rows: Rows) -> tuple[OpenTurn, ...]:
    """The unidentified rotations of the base in each session; none if orientations were measured, or not of poses."""
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
    """The unidentified rotation given ``points`` ``(N, 3)``, m, instrument frame, with errors of ``error``, m."""
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
    """Precision ``(3, 3)``, 1/rad², that statements give to the rotation about ``centre``, instrument axes."""
    place = rows.layout.sessions[session]
    slots = [slot_of("base_frame", place, a) for a in ("rx", "ry", "rz", "x", "y", "z")]
    at, matrix, _ = stated_equations(rows.constants.stated, {slot: k for k, slot in enumerate(slots)})
    if not len(at):
        return np.zeros((3, 3))
    X = _reference(rows, session)
    lever = X[:3, 3] - centre
    cross = np.array([[0.0, -lever[2], lever[1]], [lever[2], 0.0, -lever[0]], [-lever[1], lever[0], 0.0]])
    by_turn = np.vstack([X[:3, :3].T, -X[:3, :3].T @ cross])[at]  # derivative of the base twist (w, v) by the rotation
    return np.asarray((matrix @ by_turn).T @ (matrix @ by_turn))


def _reference(rows: Rows, session: int) -> Array:
    """The reference pose ``(4, 4)`` of the base in a session, instrument frame."""
    return np.asarray(rows.pose.base_reference[np.flatnonzero(rows.session == session)[0]])


def _turned(rows: Rows, turn: OpenTurn, angles: Array) -> Rows:
    """The rows with the base of one session rotated by ``angles`` ``(k,)``, rad, about its open axes."""
    reference = rows.pose.base_reference.copy()
    mine = rows.session == turn.session
    reference[mine] = turn.by(angles) @ reference[mine]
    return replace(rows, constants=replace(rows.pose, base_reference=reference))


def from_likeliest_turn(problem: FitProblem, priors: Sequence[Prior]) -> Rows:
    """The problem's rows with each open base rotated to the likeliest of many rotations.

    The cost of a rotation is that after one Gauss-Newton step. At the right rotation one step nearly reaches the
    minimum, since a described robot is nearly the real one. At a wrong rotation more of the residual is left.
    """
    rows = problem.rows
    for turn in open_turns(rows):
        if len(turn.axes) == 1:
            reach = min(np.pi, 3.0 * float(turn.std[0]))
            step = 2.0 * reach / COARSE_TURNS
            coarse = np.linspace(-reach, reach, COARSE_TURNS, endpoint=False)[:, None]
            best = _likeliest(problem, rows, turn, np.vstack([np.zeros((1, 1)), coarse]), priors)
            fine = best + np.linspace(-0.5, 0.5, FINE_TURNS)[:, None] * step
            best = _likeliest(problem, rows, turn, fine, priors)
        else:
            drawn = _draws(turn, np.random.default_rng(SEED), RANDOM_TURNS)
            best = _likeliest(problem, rows, turn, np.vstack([np.zeros((1, len(turn.axes))), drawn]), priors)
        rows = _turned(rows, turn, best)
    return rows


def _likeliest(problem: FitProblem, rows: Rows, turn: OpenTurn, angles: Array, priors: Sequence[Prior]) -> Array:
    """The one of the rotations ``angles`` ``(K, k)``, rad, with the lowest cost: ``(k,)``."""
    precision, mean = prior_of(problem, priors)
    theta, noise = start_of(problem, None, priors), initial_noise(rows)
    mean = np.where(problem.centred(), theta, mean)

    def cost(angle: Array) -> float:
        there = problem.with_rows(_turned(rows, turn, angle))
        at = _stepped(there, noise, theta, precision, mean)
        off = at - mean
        return stage_point(there, noise, at).cost + float(off @ precision @ off)

    return np.asarray(angles[int(np.argmin([cost(a) for a in angles]))])


def _stepped(problem: FitProblem, noise: Noise, theta: Array, precision: Array, mean: Array) -> Array:
    """Parameters ``(P,)`` after one Gauss-Newton step from ``theta`` ``(P,)``, with the prior."""
    A, g = stage_point(problem, noise, theta).normal()
    size = 1.0 / np.sqrt(np.maximum(np.diag(A + precision), 1e-300))
    scaled = (A + precision) * np.outer(size, size)
    step = linalg.lstsq(scaled, size * (g - precision @ (theta - mean)))[0]
    return np.asarray(theta + size * step)


def _draws(turn: OpenTurn, rng: np.random.Generator, count: int) -> Array:
    """Random rotations ``(count, k)``, rad, wrapped to half a revolution either way."""
    free = turn.std * rng.standard_normal((count, len(turn.std)))
    return np.asarray((free + np.pi) % (2.0 * np.pi) - np.pi)


def with_open_base(estimate: Estimate) -> Estimate:
    """The pose fit with the uncertainty from unidentified rotations of the base added to its covariance."""
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
