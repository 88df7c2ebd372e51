"""Friction of motors at rest in clamped sweeps: other local minima, in which a clearance is crossed in other rows.

The torque of a motor at rest is its gear's torque plus the friction that it kept. If the clamping block yields, torques
of joints at rest change, and this friction decides in which rows a joint's clearance is crossed. A motor that has moved
since the arm was clamped keeps the friction of its last motion. The friction of any other motor lies anywhere between
its limits, and the cost has several local minima: to reach the next one, several rows would have to enter or leave a
clearance at once. So a few frictions are tried at each such motor. Each lets the clearance be crossed in other rows or
in none, and has its own clamped angles. The minima are compared by their evidence, not by their cost: a crossing leaves
the friction hardly any freedom, and one of many would fit better by chance. Source: Laplace's approximation, as in
MacKay, Bayesian interpolation, Neural Computation 4, 1992.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from clampid.fitting.noise import Noise
from clampid.stages.clamped import joint_torques, residual_by_angle, standing_angles
from clampid.stages.clamped_rows import BLOCK_ROWS
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array, Bools, Integers, Rows

__all__ = ["other_crossings"]

SIGN_CHANGES_TRIED = (0.1, 0.35, 0.65, 0.9)  # of the rows: where a joint's torque is tried to change its sign
OUTSIDE_MARGIN = 1.0  # of the noise: as far outside all rows that none changes it
LARGEST_KEPT_FRICTION = 2.0  # times the friction that a motor shows: more is not kept
LEAST_CHI_SQUARE = 4.0  # of chi-square: changes of torque worth less say nothing about crossings
UNCLEAR_SIGN = 2.0  # of the noise: a torque so small may be of either sign
BETTER = 1.0  # of -2 log of the evidence
MAX_STEPS, DAMPING, SETTLED = 5, 1e-3, 0.1  # of the descent of what is tried; the whole search follows
CENTRING = 5


@dataclass(frozen=True)
class _Sweeps:
    """Sweeps of a clamped arm with all parameters fixed but their own constants ``(K,)``.

    Attributes
    ----------
    rows
        Of some of the sweeps.
    index
        Which of the K constants are these sweeps' own.
    clamping
        ``(sweeps,)``: sweeps of one number share what is known of their constants.
    """

    problem: FitProblem
    rows: Rows
    noise: Noise
    theta: Array
    mean: Array
    precision: Array
    keys: Integers
    index: Integers
    clamping: Integers

    @classmethod
    def of(cls, problem: FitProblem, noise: Noise, theta: Array, precision: Array, mean: Array) -> _Sweeps:
        count, rows = len(problem.slots), problem.rows
        keys = rows.series.offset_keys
        own = np.asarray(precision[count:, count:])
        clamping = np.arange(int(rows.series.run.max()) + 1)
        for a, b in np.argwhere(np.triu(own != 0.0, 1)):
            pair = clamping[keys[[a, b], 0]]
            clamping[clamping == pair.max()] = pair.min()
        return cls(problem, rows, noise, theta[:count], mean[count:], own, keys, np.arange(len(keys)), clamping)

    def only(self, clampings: Bools) -> _Sweeps:
        """The rows of some clampings ``(sweeps,)`` alone."""
        chosen = np.flatnonzero(clampings[self.clamping[self.rows.series.run]])
        if len(chosen) == len(self.rows):
            return self
        index = self.index[clampings[self.clamping[self.keys[self.index, 0]]]]
        return replace(self, rows=self.rows.take(chosen), noise=self.noise.at(chosen), index=index)

    def quadratic(self, own: Array) -> tuple[Array, Array, Array]:
        """Costs ``(sweeps,)`` by clamping, normal matrix ``(K, K)`` and downhill gradient ``(K,)``."""
        rows, n, count = self.rows, self.rows.robot.n, len(self.clamping)
        residual, by_angle = residual_by_angle(rows, self.problem.chain, self.theta, own[self.index])
        kept = np.broadcast_to(np.eye(n), (len(rows), n, n))
        white = self.noise.whiten(rows, residual, np.concatenate([by_angle, kept], axis=2))
        run = rows.series.run[white.entry]
        lever = self.precision @ (own - self.mean)
        prior = np.bincount(self.clamping[self.keys[:, 0]], (own - self.mean) * lever, count)
        cost = np.bincount(self.clamping[run], white.residual**2, count) + prior
        A, g = self.precision.copy(), -lever
        for s in np.unique(run):
            mine, at = run == s, np.flatnonzero(self.keys[:, 0] == s)
            J = white.jacobian[mine][:, self.keys[at, 1]]
            A[np.ix_(at, at)] += J.T @ J
            g[at] += J.T @ white.residual[mine]
        return np.asarray(cost, dtype=float), A, g

    def descend(self, own: Array, clampings: Bools) -> tuple[Array, Array]:
        """Constants ``(K,)`` at the clampings' own minima, and how unlikely they are ``(sweeps,)``.

        That is -2 log of the evidence by Laplace's approximation: the cost, and what is left of the prior's room;
        infinite for other clampings.
        """
        part, best, of = self.only(clampings), own.copy(), self.clamping[self.keys[:, 0]]
        cost, A, g = part.quadratic(best)
        damping, moving = np.zeros(len(cost)), clampings.copy()
        for _ in range(MAX_STEPS):
            step = np.linalg.solve(A + np.diag(damping[of] * np.diag(A)), g) * moving[of]
            moving &= np.bincount(of, step * g, len(cost)) > SETTLED
            if not moving.any():
                break
            part = part.only(moving)
            trial = best + step * moving[of]
            reached, A_there, g_there = part.quadratic(trial)
            lower = moving & (reached < cost)
            at = lower[of]
            best[at], cost[lower], g[at] = trial[at], reached[lower], g_there[at]
            A[np.ix_(at, at)] = A_there[np.ix_(at, at)]
            damping = np.where(lower, damping / 10 * (damping > DAMPING), np.maximum(10 * damping, DAMPING))
        for c in np.flatnonzero(clampings):
            cost[c] += np.linalg.slogdet(A[np.ix_(of == c, of == c)])[1]
        return best, np.where(clampings, cost, np.inf)


def other_crossings(problem: FitProblem, noise: Noise, theta: Array, precision: Array, mean: Array) -> Array | None:
    """Parameters ``(P + K,)`` whose sweeps' own constants are likelier than those given; None where there are none.

    Parameters
    ----------
    theta
        Where a search has ended ``(P + K,)``; its slots stay as they are.
    precision, mean
        The prior: ``(P + K, P + K)`` and ``(P + K,)``.
    """
    if not problem.numbers_of("clearance"):
        return None
    live, count = _live(problem, theta), len(problem.slots)
    if not live.any():
        return None
    sweeps = _Sweeps.of(problem, noise, theta, precision, mean)
    waiting = np.bincount(sweeps.clamping, live.any(axis=1), len(live)) > 0.0
    own, cost = sweeps.descend(theta[count:], waiting)
    begun = False
    for motor, stands in _stands(sweeps, live):
        for trial, tried in _tried(sweeps, own, motor, stands):
            if not tried.any():
                continue
            found, reached = sweeps.descend(trial, tried)
            better = reached < cost - BETTER
            at = better[sweeps.clamping[sweeps.keys[:, 0]]]
            own[at], cost[better] = found[at], reached[better]
            begun |= bool(better.any())
    return np.r_[theta[:count], own] if begun else None


def _live(problem: FitProblem, theta: Array) -> Bools:
    """Motors at rest ``(sweeps, n)`` whose joint torque changes by more than noise in the model without clearances."""
    rows, n, count = problem.rows, problem.rows.robot.n, len(problem.slots)
    keys, run = rows.series.offset_keys, rows.series.run
    angle, _ = standing_angles(rows, problem.chain, theta[:count], np.zeros((len(rows), n)))
    torque = -np.linalg.solve(_strained(problem, theta[:count]), angle[:, :, None])[:, :, 0]
    limit = rows.sigma / np.abs(np.diag(np.asarray(rows.robot.transmission)))
    out = np.zeros((int(run.max()) + 1, n), dtype=bool)
    for s, k in keys[keys[:, 1] >= n]:
        mine, j = run == s, k - n
        out[s, j] = mine.sum() * np.var(torque[mine, j] / limit[mine, j]) > LEAST_CHI_SQUARE
    return out


def _strained(problem: FitProblem, theta: Array) -> Array:
    """The balance by torque ``(N, n, n)``, rad/Nm, where no joint is in its clearance."""
    rows = problem.rows
    far = np.tile(rows.sweep.rated, (len(rows), 1))
    return standing_angles(rows, problem.chain, theta, far)[1]


def _stands(sweeps: _Sweeps, live: Bools) -> Iterator[tuple[int, list[list[int]]]]:
    """Motors, and the sweeps through which each stood still with an unknown friction; one per clamping."""
    keys, n = sweeps.keys, live.shape[1]
    for motor in np.flatnonzero(live.any(axis=0)):
        stands: list[list[int]] = []
        at = np.flatnonzero(keys[:, 1] == n + motor)
        for k, s in zip(at, keys[at, 0], strict=True):
            linked = stands and sweeps.precision[k, at[keys[at, 0] == stands[-1][-1]]].any()
            if linked:
                stands[-1].append(int(s))
            else:
                stands.append([int(s)])
        sign_known = sweeps.rows.sweep.kept_sign
        stands = [s for s in stands if live[s, motor].any() and not sign_known[s[0], motor]]
        while stands:
            clampings = [int(sweeps.clamping[s[0]]) for s in stands]
            first = [s for k, s in enumerate(stands) if clampings[k] not in clampings[:k]]
            yield int(motor), first
            stands = [s for s in stands if s not in first]


def _tried(sweeps: _Sweeps, own: Array, motor: int, stands: Sequence[list[int]]) -> list[tuple[Array, Bools]]:
    """Constants ``(K,)`` with another friction kept by one motor, and the clampings ``(sweeps,)`` where it is another.

    The first has, of the frictions tried, that which leaves least of the balance of angles; the second the best of
    those with which the clearance is crossed in other sweeps than with the first.
    """
    table = _Table.of(sweeps, own, motor)
    n, count = sweeps.rows.robot.n, len(sweeps.clamping)
    limit = LARGEST_KEPT_FRICTION * sweeps.rows.sweep.loop_friction[motor]
    levels = [[c for c in table.changes(stand) if abs(table.kept[stand[0]] + c) < limit] for stand in stands]
    found: list[list[tuple[float, tuple[bool, ...], float, Array]]] = [[] for _ in stands]
    for k in range(max(map(len, levels), default=0)):
        change = np.zeros(count)
        for stand, own_levels in zip(stands, levels, strict=True):
            change[stand] = own_levels[k] if k < len(own_levels) else 0.0
        left, crossed, angles = table.balance(change)
        for stand, own_levels, seen in zip(stands, levels, found, strict=True):
            if k < len(own_levels):
                seen.append((float(left[stand].sum()), tuple(crossed[stand]), own_levels[k], angles[stand]))
    out = []
    for rank in (0, 1):
        trial, tried = own.copy(), np.zeros(count, dtype=bool)
        for stand, seen in zip(stands, found, strict=True):
            best = min(seen, key=lambda entry: entry[0], default=None)
            if best is not None and rank:
                best = min((e for e in seen if e[1] != best[1]), key=lambda entry: entry[0], default=None)
            if best is None:
                continue
            tried[sweeps.clamping[stand[0]]] = True
            for s, angle in zip(stand, best[3], strict=True):
                for at in np.flatnonzero(sweeps.keys[:, 0] == s):
                    column = sweeps.keys[at, 1]
                    if column < n:
                        trial[at] = angle[column]
                    elif column == n + motor:
                        trial[at] = table.kept[s] + best[2]
        out.append((trial, tried))
    return out


@dataclass(frozen=True)
class _Table:
    """The balance of angles that measured torques imply if one motor at rest had kept another friction.

    A torque near zero may have either sign, so it requires no angle between the two flanks.
    """

    sweeps: _Sweeps
    motor: int
    kept: Array  # (sweeps,)
    torque: Array  # (N, n), at the joints, as measured
    spread: Array  # (N, n), its noise
    lever: Array  # (n,): of the joints' torques, for friction of the motor
    gain: Array  # (N, n, n): torques at the motors by angles, no clearance in between
    rows_of: tuple[Integers, ...]  # by sweep, where all motors count

    @classmethod
    def of(cls, sweeps: _Sweeps, own: Array, motor: int) -> _Table:
        rows, chain, keys = sweeps.rows, sweeps.problem.chain, sweeps.keys
        T = np.asarray(rows.robot.transmission)
        inverse = np.asarray(np.linalg.inv(T), dtype=float)
        residual, _ = residual_by_angle(rows, chain, sweeps.theta, own)
        torque = joint_torques(rows, chain, sweeps.theta, own) + residual @ inverse.T
        kept = np.zeros(len(sweeps.clamping))
        at = keys[:, 1] == len(T) + motor
        kept[keys[at, 0]] = own[at]
        run, counts = rows.series.run, rows.used.all(axis=1)
        return cls(
            sweeps, motor, kept, torque, np.sqrt(rows.sigma**2 @ (inverse**2).T), inverse[:, motor],
            T @ np.linalg.inv(_strained(sweeps.problem, sweeps.theta)),
            tuple(np.flatnonzero((run == s) & counts) for s in range(len(kept))),
        )  # fmt: skip

    def changes(self, stand: Sequence[int]) -> list[float]:
        """Changes of the kept friction, Nm, at which the joint's torque crosses zero elsewhere, or nowhere."""
        out: list[float] = []
        for s in stand:
            mine = self.rows_of[s]
            if not len(mine):
                continue
            torque, noise = self.torque[mine, self.motor], float(self.spread[mine[0], self.motor])
            smooth = np.array([b.mean() for b in np.array_split(torque, max(len(torque) // BLOCK_ROWS, 1))])
            at = [
                *np.quantile(smooth, SIGN_CHANGES_TRIED),
                smooth.min() - OUTSIDE_MARGIN * noise,
                smooth.max() + OUTSIDE_MARGIN * noise,
            ]
            out += [float(a) / float(self.lever[self.motor]) for a in at]
        return out

    def balance(self, change: Array) -> tuple[Array, Bools, Array]:
        """What changed frictions ``(sweeps,)`` leave of the balance, by sweep: chi-square, crossed or not, angles."""
        rows, theta = self.sweeps.rows, self.sweeps.theta
        torque = self.torque - change[rows.series.run, None] * self.lever
        angle, _ = standing_angles(rows, self.sweeps.problem.chain, theta, torque)
        side = torque / np.sqrt(torque**2 + rows.signals["rest_direction"] ** 2)
        gap = np.where(np.abs(torque) < UNCLEAR_SIGN * self.spread, self.sweeps.problem.clearances(theta), 0.0)
        low, high = angle - 0.5 * gap * (1.0 - side), angle + 0.5 * gap * (1.0 + side)
        n, count = torque.shape[1], len(change)
        left, crossed, angles = np.full(count, np.inf), np.zeros(count, dtype=bool), np.zeros((count, n))
        for s, mine in enumerate(self.rows_of):
            if len(mine):
                angles[s] = _middle(low[mine], high[mine])
                off = np.clip(angles[s], low[mine], high[mine]) - angles[s]
                lost = np.einsum("nij,nj->ni", self.gain[mine], off) / rows.sigma[mine]
                left[s] = float((lost**2).sum())
                below = float((torque[mine, self.motor] < 0.0).mean())
                crossed[s] = min(SIGN_CHANGES_TRIED) / 2 < below < 1 - min(SIGN_CHANGES_TRIED) / 2
        return left, crossed, angles


def _middle(low: Array, high: Array) -> Array:
    """The angles ``(n,)`` that are nearest to the intervals ``(N, n)``."""
    middle = 0.5 * (low + high).mean(axis=0)
    for _ in range(CENTRING):
        middle = np.clip(middle, low, high).mean(axis=0)
    return np.asarray(middle)
