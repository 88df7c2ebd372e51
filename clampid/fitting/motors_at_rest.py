"""Search over local minima of a clamped fit: the friction of a motor at rest decides where a clearance is crossed.

The torque of a motor at rest is its gear's torque plus the friction that it kept. If the clamping block yields, the
torques of joints at rest change. The kept friction then decides in which rows a joint's clearance is crossed.

A motor that has moved since the arm was clamped keeps the friction of its last motion. The friction of any other motor
lies anywhere between its limits, and the cost has several local minima. To reach the next minimum, several rows would
have to enter or leave a clearance at once. Therefore a few frictions are tried at each such motor. Each of them lets
the clearance be crossed in other rows, or in none, and has its own clamped angles.

The minima are compared by their evidence, not by their cost. A crossing leaves the friction hardly any freedom, so the
best of many crossings would have a lower cost by chance. Source: Laplace's approximation, as in MacKay, Bayesian
interpolation, Neural Computation 4, 1992.
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

SIGN_CHANGES_TRIED = (0.1, 0.35, 0.65, 0.9)  # shares of the rows before which a joint's torque is given one sign
OUTSIDE_MARGIN = 1.0  # in units of the noise: a sign change this far outside the torques of all rows crosses nothing
LARGEST_KEPT_FRICTION = 2.0  # in units of the friction loop of the motor: a larger friction cannot be kept
LEAST_CHI_SQUARE = 4.0  # of chi-square: smaller changes of torque are not informative about crossings
UNCLEAR_SIGN = 2.0  # in units of the noise: a smaller torque may have either sign
BETTER_EVIDENCE = 1.0  # of -2 log of the evidence: the least improvement for which a minimum is changed
MAX_LM_STEPS, LEAST_DAMPING = 5, 1e-3  # of each trial; the full search continues from the best one
CONVERGED_FALL = 0.1  # of chi-square, to first order: a trial ends when its next step gains less
CENTRING_STEPS = 5  # of the fixed-point iteration for the angles nearest to all intervals


@dataclass(frozen=True)
class _Sweeps:
    """Sweeps of a clamped arm as a fit of their own constants ``(K,)`` alone; all shared parameters are fixed.

    Attributes
    ----------
    problem, noise
        The problem of all sweeps, and the noise of ``rows``.
    rows
        Rows of some or all of the sweeps.
    theta
        Values ``(P,)`` of the shared parameters, SI.
    mean, precision
        Prior of the constants: ``(K,)``, rad and Nm, and ``(K, K)``.
    keys
        ``(K, 2)``: sweep and column of each constant; columns 0 to n - 1 are clamped angles, rad, the others kept
        frictions, Nm.
    index
        Numbers of the constants that belong to the sweeps in ``rows``.
    clamping
        Number of the clamping of each sweep ``(sweeps,)``; constants of one clamping have a joint prior.
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
        """All sweeps of a problem at parameters ``(P + K,)``, with the prior of all parameters."""
        count, rows = len(problem.slots), problem.rows
        keys = rows.series.offset_keys
        own = np.asarray(precision[count:, count:])
        clamping = np.arange(int(rows.series.run.max()) + 1)
        for a, b in np.argwhere(np.triu(own != 0.0, 1)):
            pair = clamping[keys[[a, b], 0]]
            clamping[clamping == pair.max()] = pair.min()
        return cls(problem, rows, noise, theta[:count], mean[count:], own, keys, np.arange(len(keys)), clamping)

    def only(self, clampings: Bools) -> _Sweeps:
        """The same with the rows of some clampings only; ``clampings`` ``(sweeps,)`` marks them by number."""
        chosen = np.flatnonzero(clampings[self.clamping[self.rows.series.run]])
        if len(chosen) == len(self.rows):
            return self
        index = self.index[clampings[self.clamping[self.keys[self.index, 0]]]]
        return replace(self, rows=self.rows.take(chosen), noise=self.noise.at(chosen), index=index)

    def quadratic(self, own: Array) -> tuple[Array, Array, Array]:
        """Cost of each clamping ``(sweeps,)``, normal matrix ``(K, K)`` and downhill gradient ``(K,)`` with the prior.

        ``own`` ``(K,)``: the constants, rad and Nm.
        """
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
        """Constants ``(K,)`` at the minima of the marked clampings, and -2 log of their evidence ``(sweeps,)``.

        The evidence is Laplace's approximation: the cost plus the log determinant of the normal matrix. It is infinite
        for clampings that are not marked.
        """
        part, best, of = self.only(clampings), own.copy(), self.clamping[self.keys[:, 0]]
        cost, A, g = part.quadratic(best)
        damping, moving = np.zeros(len(cost)), clampings.copy()
        for _ in range(MAX_LM_STEPS):
            step = np.linalg.solve(A + np.diag(damping[of] * np.diag(A)), g) * moving[of]
            moving &= np.bincount(of, step * g, len(cost)) > CONVERGED_FALL
            if not moving.any():
                break
            part = part.only(moving)
            trial = best + step * moving[of]
            trial_cost, A_trial, g_trial = part.quadratic(trial)
            lower = moving & (trial_cost < cost)
            at = lower[of]
            best[at], cost[lower], g[at] = trial[at], trial_cost[lower], g_trial[at]
            A[np.ix_(at, at)] = A_trial[np.ix_(at, at)]
            damping = np.where(lower, damping / 10 * (damping > LEAST_DAMPING), np.maximum(10 * damping, LEAST_DAMPING))
        for c in np.flatnonzero(clampings):
            cost[c] += np.linalg.slogdet(A[np.ix_(of == c, of == c)])[1]
        return best, np.where(clampings, cost, np.inf)


def other_crossings(problem: FitProblem, noise: Noise, theta: Array, precision: Array, mean: Array) -> Array | None:
    """Parameters ``(P + K,)`` with sweep constants of larger evidence than those given; None if none were found.

    Parameters
    ----------
    problem, noise
        The clamped sweeps and their noise.
    theta
        Parameters ``(P + K,)`` at the end of a search, SI; the first P, which all sweeps share, are not changed.
    precision, mean
        The prior: ``(P + K, P + K)`` and ``(P + K,)``.
    """
    if not problem.numbers_of("clearance"):
        return None
    changing, count = _changing_torques(problem, theta), len(problem.slots)
    if not changing.any():
        return None
    sweeps = _Sweeps.of(problem, noise, theta, precision, mean)
    affected = np.bincount(sweeps.clamping, changing.any(axis=1), len(changing)) > 0.0
    own, cost = sweeps.descend(theta[count:], affected)
    improved = False
    for motor, phases in _phases_at_rest(sweeps, changing):
        for trial, tried in _trials(sweeps, own, motor, phases):
            if not tried.any():
                continue
            found, trial_cost = sweeps.descend(trial, tried)
            better = trial_cost < cost - BETTER_EVIDENCE
            at = better[sweeps.clamping[sweeps.keys[:, 0]]]
            own[at], cost[better] = found[at], trial_cost[better]
            improved |= bool(better.any())
    return np.r_[theta[:count], own] if improved else None


def _changing_torques(problem: FitProblem, theta: Array) -> Bools:
    """Motors at rest ``(sweeps, n)`` whose joint torque changes by more than noise in a model without clearances."""
    rows, n, count = problem.rows, problem.rows.robot.n, len(problem.slots)
    keys, run = rows.series.offset_keys, rows.series.run
    angle, _ = standing_angles(rows, problem.chain, theta[:count], np.zeros((len(rows), n)))
    torque = -np.linalg.solve(_angles_by_torque(problem, theta[:count]), angle[:, :, None])[:, :, 0]
    limit = rows.sigma / np.abs(np.diag(np.asarray(rows.robot.transmission)))
    out = np.zeros((int(run.max()) + 1, n), dtype=bool)
    for s, k in keys[keys[:, 1] >= n]:
        mine, j = run == s, k - n
        out[s, j] = mine.sum() * np.var(torque[mine, j] / limit[mine, j]) > LEAST_CHI_SQUARE
    return out


def _angles_by_torque(problem: FitProblem, theta: Array) -> Array:
    """Derivative ``(N, n, n)``, rad/Nm, of the balance of angles by joint torques, with no joint in its clearance."""
    rows = problem.rows
    far = np.tile(rows.sweep.rated, (len(rows), 1))
    return standing_angles(rows, problem.chain, theta, far)[1]


def _phases_at_rest(sweeps: _Sweeps, changing: Bools) -> Iterator[tuple[int, list[list[int]]]]:
    """Motors, and for each the phases of rest with unknown friction: lists of sweeps that share the kept friction.

    A motor is given several times if it has several such phases in one clamping; each time with one per clamping.
    """
    keys, n = sweeps.keys, changing.shape[1]
    for motor in np.flatnonzero(changing.any(axis=0)):
        phases: list[list[int]] = []
        at = np.flatnonzero(keys[:, 1] == n + motor)
        for k, s in zip(at, keys[at, 0], strict=True):
            linked = phases and sweeps.precision[k, at[keys[at, 0] == phases[-1][-1]]].any()
            if linked:
                phases[-1].append(int(s))
            else:
                phases.append([int(s)])
        sign_known = sweeps.rows.sweep.kept_sign
        phases = [s for s in phases if changing[s, motor].any() and not sign_known[s[0], motor]]
        while phases:
            clampings = [int(sweeps.clamping[s[0]]) for s in phases]
            first = [s for k, s in enumerate(phases) if clampings[k] not in clampings[:k]]
            yield int(motor), first
            phases = [s for s in phases if s not in first]


def _trials(sweeps: _Sweeps, own: Array, motor: int, phases: Sequence[list[int]]) -> list[tuple[Array, Bools]]:
    """Two trials: constants ``(K,)`` with other frictions kept by one motor, and the clampings ``(sweeps,)`` changed.

    The first trial takes, in each phase of rest, the friction with the smallest misfit in the balance of angles. The
    second takes the best of the frictions with which the clearance is crossed in other sweeps than in the first.
    """
    table = _KeptFriction.of(sweeps, own, motor)
    n, count = sweeps.rows.robot.n, len(sweeps.clamping)
    limit = LARGEST_KEPT_FRICTION * sweeps.rows.sweep.loop_friction[motor]
    levels = [[c for c in table.changes(phase) if abs(table.kept[phase[0]] + c) < limit] for phase in phases]
    found: list[list[tuple[float, tuple[bool, ...], float, Array]]] = [[] for _ in phases]
    for k in range(max(map(len, levels), default=0)):
        change = np.zeros(count)
        for phase, own_levels in zip(phases, levels, strict=True):
            change[phase] = own_levels[k] if k < len(own_levels) else 0.0
        left, crossed, angles = table.balance(change)
        for phase, own_levels, seen in zip(phases, levels, found, strict=True):
            if k < len(own_levels):
                seen.append((float(left[phase].sum()), tuple(crossed[phase]), own_levels[k], angles[phase]))
    out = []
    for rank in (0, 1):
        trial, tried = own.copy(), np.zeros(count, dtype=bool)
        for phase, seen in zip(phases, found, strict=True):
            best = min(seen, key=lambda entry: entry[0], default=None)
            if best is not None and rank:
                best = min((e for e in seen if e[1] != best[1]), key=lambda entry: entry[0], default=None)
            if best is None:
                continue
            tried[sweeps.clamping[phase[0]]] = True
            for s, angle in zip(phase, best[3], strict=True):
                for at in np.flatnonzero(sweeps.keys[:, 0] == s):
                    column = sweeps.keys[at, 1]
                    if column < n:
                        trial[at] = angle[column]
                    elif column == n + motor:
                        trial[at] = table.kept[s] + best[2]
        out.append((trial, tried))
    return out


@dataclass(frozen=True)
class _KeptFriction:
    """The balance of angles that the measured torques imply for other frictions kept by one motor at rest.

    A torque near zero may have either sign. It then allows any angle between the two flanks.

    Attributes
    ----------
    sweeps
        The sweeps.
    motor
        Number of the motor, from 0.
    kept
        Friction that it has kept in each sweep ``(sweeps,)``, Nm.
    torque, spread
        Joint torques as measured ``(N, n)``, Nm, and their standard deviations.
    lever
        Derivative of the joint torques by the motor's friction ``(n,)``.
    gain
        Derivative of the motor torques by the joint angles outside clearances ``(N, n, n)``, Nm/rad.
    rows_of
        For each sweep, its rows in which all motors count.
    """

    sweeps: _Sweeps
    motor: int
    kept: Array
    torque: Array
    spread: Array
    lever: Array
    gain: Array
    rows_of: tuple[Integers, ...]

    @classmethod
    def of(cls, sweeps: _Sweeps, own: Array, motor: int) -> _KeptFriction:
        """The balance at constants ``own`` ``(K,)``."""
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
            T @ np.linalg.inv(_angles_by_torque(sweeps.problem, sweeps.theta)),
            tuple(np.flatnonzero((run == s) & counts) for s in range(len(kept))),
        )  # fmt: skip

    def changes(self, phase: Sequence[int]) -> list[float]:
        """Changes of the kept friction, Nm, with which the joint's torque crosses zero in other rows or in none."""
        out: list[float] = []
        for s in phase:
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
        """The balance of angles with frictions changed by ``change`` ``(sweeps,)``, Nm.

        Returns
        -------
        left, crossed, angles
            For each sweep: chi-square of the misfit ``(sweeps,)``, whether the clearance is crossed ``(sweeps,)``, and
            the clamped angles ``(sweeps, n)``, rad.
        """
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
    """Angles ``(n,)`` with the smallest mean square distance to the intervals from ``low`` to ``high`` ``(N, n)``."""
    middle = 0.5 * (low + high).mean(axis=0)
    for _ in range(CENTRING_STEPS):
        middle = np.clip(middle, low, high).mean(axis=0)
    return np.asarray(middle)
