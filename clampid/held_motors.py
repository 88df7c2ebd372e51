"""What friction held motors kept: past the clearances that a search of a clamped arm cannot cross.

The torque of a held motor is its gear's and the friction that it kept, anything between its limits. Where a block that
yields changes the torques of held joints, it is this friction that decides whether a joint's clearance is crossed, and
in which rows. A search moves on within the one answer that it began with: another is beyond rows that would have to
enter or leave a clearance all at once, and costs more on the way. So at every held motor a few frictions are tried
which let the joint's clearance be crossed in other rows, or in none, each with the angles at which the arm would then
have been clamped; sweep by sweep, because no sweep shares these numbers with another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clampid.noise import Noise
from clampid.stages.clamped import BLOCK_ROWS, joint_torques, residual_by_angle, standing_angles
from clampid.stages.experiment import Experiment
from clampid.stages.rows import Array, Bools, Rows

__all__ = ["other_crossings"]

SHARES = (0.05, 0.2, 0.4, 0.6, 0.8, 0.95)  # of the rows: where a joint's torque is tried to change its sign
BEYOND = 1.0  # of the noise: as far outside all rows that none changes it
LARGEST = 2.5  # times what friction a motor shows: more is not kept
TOLD = 4.0  # of chi-square: changes of torque worth less tell nothing of crossings
BETTER = 1.0  # of chi-square: what chance would gain
STEPS, DAMPING, SETTLED = 8, 1e-3, 0.1
NEAR = 2.0  # of the noise: a torque so small may be of either sign
CENTRING = 5
PASSES = 2


@dataclass(frozen=True)
class _Sweeps:
    """Some sweeps of a clamped arm with all but their own constants held: tables ``(sweeps, 2 n)``, costs a sweep."""

    experiment: Experiment
    noise: Noise
    theta: Array
    mean: Array
    precision: Array  # zero where a sweep has no such constant

    @classmethod
    def of(cls, experiment: Experiment, noise: Noise, theta: Array, precision: Array, mean: Array) -> _Sweeps:
        count, keys = len(experiment.slots), experiment.rows.constants["offset_keys"]
        shape = (int(experiment.rows.constants["run"].max()) + 1, 2 * experiment.rows.robot.n)
        tables = np.zeros((2, *shape))
        tables[0][keys[:, 0], keys[:, 1]] = mean[count:]
        tables[1][keys[:, 0], keys[:, 1]] = np.diag(precision)[count:]
        return cls(experiment, noise, theta[:count], tables[0], tables[1])

    def only(self, sweeps: Bools) -> _Sweeps:
        """The rows of some sweeps ``(sweeps,)`` alone."""
        chosen = np.flatnonzero(sweeps[self.experiment.rows.constants["run"]])
        taken = self.experiment.with_rows(self.experiment.rows.take(chosen))
        return _Sweeps(taken, self.noise.at(chosen), self.theta, self.mean, self.precision)

    def flat(self, table: Array) -> Array:
        keys = self.experiment.rows.constants["offset_keys"]
        return np.asarray(table[keys[:, 0], keys[:, 1]])

    def quadratic(self, table: Array) -> tuple[Array, Array, Array]:
        """Costs ``(sweeps,)``, normal matrices ``(sweeps, 2 n, 2 n)`` and downhill gradients ``(sweeps, 2 n)``."""
        rows, n = self.experiment.rows, self.experiment.rows.robot.n
        residual, by_angle = residual_by_angle(rows, self.experiment.chain, self.theta, self.flat(table))
        kept = np.broadcast_to(np.eye(n), (len(rows), n, n))
        white = self.noise.whiten(rows, residual, np.concatenate([by_angle, kept], axis=2))
        run = rows.constants["run"][white.entry]
        off = np.where(self.precision > 0.0, table - self.mean, 0.0)
        cost = np.bincount(run, white.residual**2, len(table)) + (self.precision * off**2).sum(axis=1)
        A, g = np.zeros((len(table), 2 * n, 2 * n)), -self.precision * off
        for s in np.unique(run):
            J = white.jacobian[run == s]
            A[s] = J.T @ J
            g[s] += J.T @ white.residual[run == s]
        there = self.precision > 0.0
        A = np.where(there[:, :, None] & there[:, None, :], A, 0.0)
        A += np.eye(2 * n) * np.where(there, self.precision, 1.0)[:, :, None]
        return cost, A, np.where(there, g, 0.0)

    def descend(self, table: Array, sweeps: Bools) -> tuple[Array, Array]:
        """Tables at the sweeps' own minima from ``table``, and how unlikely they are; infinitely for other sweeps.

        That is -2 log of the evidence by Laplace's approximation: the cost, and what of the prior's room is left.
        """
        part, best = self.only(sweeps), table.copy()
        cost, A, g = part.quadratic(best)
        cost = np.where(sweeps, cost, np.inf)
        damping, moving = np.zeros(len(table)), sweeps.copy()
        for _ in range(STEPS):
            size = np.einsum("sii->si", A)
            step = np.linalg.solve(A + damping[:, None, None] * size[:, :, None] * np.eye(A.shape[1]), g[:, :, None])
            step = step[:, :, 0] * moving[:, None]
            moving &= np.einsum("si,si->s", step, g) > SETTLED
            if not moving.any():
                break
            part = part.only(moving)
            trial = best + step * moving[:, None]
            reached, A_there, g_there = part.quadratic(trial)
            lower = moving & (reached < cost)
            best[lower], cost[lower], A[lower], g[lower] = trial[lower], reached[lower], A_there[lower], g_there[lower]
            damping = np.where(lower, damping / 10 * (damping > DAMPING), np.maximum(10 * damping, DAMPING))
        return best, cost + np.linalg.slogdet(A)[1]


def other_crossings(experiment: Experiment, noise: Noise, theta: Array, precision: Array, mean: Array) -> Array | None:
    """Parameters ``(P + K,)`` whose sweeps' own constants are likelier than those given; None where there are none.

    Parameters
    ----------
    theta
        Where a search has ended ``(P + K,)``; its slots stay as they are.
    precision, mean
        The prior: ``(P + K, P + K)`` and ``(P + K,)``.
    """
    if not any(slot.effect == "backlash" for slot in experiment.slots):
        return None
    sweeps, count = _Sweeps.of(experiment, noise, theta, precision, mean), len(experiment.slots)
    keys = experiment.rows.constants["offset_keys"]
    live = _live(experiment, theta)
    if not live.any():
        return None
    table = np.zeros_like(sweeps.mean)
    table[keys[:, 0], keys[:, 1]] = theta[count:]
    table, cost = sweeps.descend(table, live.any(axis=1))
    changed, waiting = False, live.any(axis=1)
    for _ in range(PASSES):
        moved = np.zeros_like(waiting)
        for motor in np.flatnonzero(live[waiting].any(axis=0)):
            for trial, tried in _tried(sweeps, table, motor, live[:, motor] & waiting):
                if not tried.any():
                    continue
                found, reached = sweeps.descend(trial, tried)
                better = reached < cost - BETTER
                table[better], cost[better] = found[better], reached[better]
                moved |= better
        changed |= bool(moved.any())
        waiting = moved
        if not moved.any():
            break
    if not changed:
        return None
    return np.r_[theta[:count], sweeps.flat(table)]


def _live(experiment: Experiment, theta: Array) -> Bools:
    """Held motors ``(sweeps, n)`` whose joint's torque the model lets change by what the rows can tell."""
    rows, n, count = experiment.rows, experiment.rows.robot.n, len(experiment.slots)
    keys, run = rows.constants["offset_keys"], rows.constants["run"]
    angle, _ = standing_angles(rows, experiment.chain, theta[:count], np.zeros((len(rows), n)))
    torque = -np.linalg.solve(_strained(experiment, theta[:count]), angle[:, :, None])[:, :, 0]
    limit = rows.sigma / np.abs(np.diag(np.asarray(rows.robot.transmission)))
    out = np.zeros((int(run.max()) + 1, n), dtype=bool)
    for s, k in keys[keys[:, 1] >= n]:
        mine, j = run == s, k - n
        out[s, j] = mine.sum() * np.var(torque[mine, j] / limit[mine, j]) > TOLD
    return out


def _strained(experiment: Experiment, theta: Array) -> Array:
    """The balance by torque ``(N, n, n)``, rad/Nm, where no joint is in its clearance."""
    rows = experiment.rows
    far = np.tile(rows.constants["rated"], (len(rows), 1))
    return standing_angles(rows, experiment.chain, theta, far)[1]


def _tried(sweeps: _Sweeps, table: Array, motor: int, live: Bools) -> list[tuple[Array, Bools]]:
    """Tables with another friction kept by one motor, and the sweeps ``(sweeps,)`` in which it is another.

    The first has, of the levels tried, that which leaves least of the balance of angles; the second the best of those
    which let the clearance be crossed where the first does not, or do not where it does.
    """
    experiment, n = sweeps.experiment, sweeps.experiment.rows.robot.n
    rows, chain = experiment.rows, experiment.chain
    T = np.asarray(rows.robot.transmission)
    inverse = np.linalg.inv(T)
    offsets = sweeps.flat(table)
    residual, _ = residual_by_angle(rows, chain, sweeps.theta, offsets)
    torque = joint_torques(rows, chain, sweeps.theta, offsets) + residual @ inverse.T
    run, usable = rows.constants["run"], _usable(rows)
    spread = np.sqrt((rows.sigma**2) @ (inverse**2).T)
    gap = _gaps(experiment, sweeps.theta)
    gain = T @ np.linalg.inv(_strained(experiment, sweeps.theta))
    kept = np.full((len(SHARES) + 2, len(table)), np.nan)
    left = np.full((len(SHARES) + 2, len(table)), np.inf)
    angles = np.zeros((len(SHARES) + 2, len(table), n))
    for level in range(len(kept)):
        shift = np.zeros_like(torque)
        for s in np.flatnonzero(live):
            mine = np.flatnonzero((run == s) & usable)
            if not len(mine):
                continue
            change = _level(torque[mine, motor], level, float(spread[mine[0], motor])) / inverse[motor, motor]
            if abs(table[s, n + motor] + change) < LARGEST * rows.constants["held_friction"][motor]:
                kept[level, s] = table[s, n + motor] + change
                shift[mine] = inverse[:, motor] * change
        there = torque - shift
        angle, _ = standing_angles(rows, chain, sweeps.theta, there)
        side = there / np.sqrt(there**2 + rows.signals["rest_direction"] ** 2)
        near = np.abs(there) < NEAR * spread
        low = angle - np.where(near, 0.5 * gap * (1.0 - side), 0.0)
        high = angle + np.where(near, 0.5 * gap * (1.0 + side), 0.0)
        for s in np.flatnonzero(np.isfinite(kept[level])):
            mine = np.flatnonzero((run == s) & usable)
            middle = _middle(low[mine], high[mine])
            off = np.clip(middle, low[mine], high[mine]) - middle
            lost = np.einsum("nij,nj->ni", gain[mine], off) / rows.sigma[mine]
            left[level, s], angles[level, s] = float((lost**2).sum()), middle
    out = []
    best = np.argmin(left, axis=0)
    crossing = np.arange(len(kept)) < len(SHARES)
    other = np.argmin(np.where(crossing[:, None] == crossing[best][None], np.inf, left), axis=0)
    every = np.arange(len(table))
    for chosen in (best, other):
        tried = np.isfinite(left[chosen, every])
        trial = table.copy()
        trial[tried, n + motor] = kept[chosen, every][tried]
        trial[tried, :n] = angles[chosen, every][tried]
        out.append((trial, tried))
    return out


def _usable(rows: Rows) -> Bools:
    """Rows ``(N,)`` whose moving motors all count."""
    return np.asarray(rows.used.all(axis=1))


def _gaps(experiment: Experiment, theta: Array) -> Array:
    """Clearances ``(n,)``, rad."""
    out = np.zeros(experiment.rows.robot.n)
    for slot, value in zip(experiment.slots, theta, strict=True):
        if slot.effect == "backlash":
            out[int(slot.place.removeprefix("joint")) - 1] = abs(value)
    return out


def _middle(low: Array, high: Array) -> Array:
    """The angles ``(n,)`` that are nearest to the intervals ``(N, n)``."""
    middle = 0.5 * (low + high).mean(axis=0)
    for _ in range(CENTRING):
        middle = np.clip(middle, low, high).mean(axis=0)
    return middle


def _level(torque: Array, level: int, noise: float) -> float:
    """A torque that all rows ``(N,)`` are above or below, or that a share of them is."""
    blocks = np.array_split(torque, max(len(torque) // BLOCK_ROWS, 1))
    smooth = np.array([block.mean() for block in blocks])
    if level < len(SHARES):
        return float(np.quantile(smooth, SHARES[level]))
    return float(smooth.min() - BEYOND * noise) if level == len(SHARES) else float(smooth.max() + BEYOND * noise)
