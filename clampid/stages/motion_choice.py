"""Speeds and accelerations of a log: from which columns, and over how long a window. The measured torques decide.

Noise of the acceleration biases whatever it multiplies towards zero (errors in variables), and a window that is too
long blurs the motion. Both raise the error of torques that were not fitted. So for each candidate, every motor's
torque is regressed on rigid-body dynamics, rotor inertia and friction by least squares, in which blocks of the log are
predicted without themselves; the candidate with the least error is taken. The default (the recorded speeds where there
are any, the shortest window) stays unless another one's error is smaller by more than two standard errors of the
paired difference over the blocks: of logs whose motion has no visible noise, about 2 % leave it by chance.

Sources: errors in variables: Fuller, Measurement Error Models (1987), section 1.1; the choice of a filter's bandwidth
by cross-validation: Fan & Gijbels, Local Polynomial Modelling and Its Applications (1996), section 4.2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import linalg

from clampid.stages.loads import gravity_signals, inertial_signals
from clampid.stages.rows import Array, Bools, Integers
from experiments.campaign import Campaign

__all__ = [
    "BLOCKS",
    "LONGEST_S",
    "Excerpt",
    "Way",
    "blocks_of",
    "chosen_rows",
    "chosen_way",
    "left_out_squares",
    "ways",
]

LONGEST_S = 0.64  # an arm's accelerations change within less
BLOCKS = 25  # of the log, in five folds that alternate: a block's neighbours are fitted when it is predicted
FOLDS = 5
ROWS = 4000  # of the log, about, that are regressed
CLEAR = 2.0  # standard errors of the paired difference
ROUNDING = 1e-9  # of the largest column
RIDGE = 1e-6  # of the balanced normal matrix: what the motion does not show is not fitted


class Motion(Protocol):
    """Positions, speeds and accelerations ``(w, n)``: rad, rad/s, rad/s²."""

    @property
    def position(self) -> Array: ...
    @property
    def speed(self) -> Array: ...
    @property
    def acceleration(self) -> Array: ...


@dataclass(frozen=True)
class Way:
    """How motion is taken from a log.

    Attributes
    ----------
    logged
        From the recorded speeds; else from the positions.
    window_s
        Over which speeds and accelerations are taken, s.
    smoothed
        Whether recorded speeds are smoothed over the window too.
    """

    logged: bool
    window_s: float
    smoothed: bool = False


@dataclass(frozen=True)
class Excerpt:
    """Some rows of a log with their motion taken in one way.

    Attributes
    ----------
    motion
        Of the rows ``(w, n)``.
    torque
        ``(w, n)``, Nm.
    moving
        ``(w, n)``: where each motor clearly moves, the same for every way.
    row
        ``(w,)``: their numbers in the log.
    """

    campaign: Campaign
    motion: Motion
    torque: Array
    moving: Bools
    row: Integers


def ways(default: Way, step: float, smallest: int) -> list[list[Way]]:
    """The candidates: per source, windows from the shortest on, each twice as long as the one before.

    Parameters
    ----------
    default
        What stays where nothing is clearly better.
    step
        Usual time step of the log, s.
    smallest
        Steps of the shortest window that a local cubic takes.
    """
    shortest = max(default.window_s, smallest * step)
    lengths = [shortest * 2.0**k for k in range(1, 12) if shortest * 2.0**k <= LONGEST_S]
    if not lengths:
        return []
    found = [[Way(False, length) for length in lengths]]
    if default.logged:
        found = [
            [Way(True, length, True) for length in lengths],
            [Way(False, length) for length in [shortest, *lengths]],
        ]
    return found


def chosen_way(default: Way, candidates: Sequence[Sequence[Way]], score: _Score) -> tuple[Way, Array]:
    """The way of the least error left out, or the default where no other is clearly better; and its squares left out.

    Along the first source a search ends with the first window that makes the error larger; of another source the best
    window of the first is tried, and those beside it as long as they make the error smaller.

    Parameters
    ----------
    score
        Way → squares left out ``(n, BLOCKS)``, Nm², of the same rows for every way.
    """
    known: dict[Way, Array] = {default: score(default)}
    moved = np.isfinite(known[default])
    most = np.where(moved, known[default], 0.0).sum(axis=1) / np.maximum(moved.sum(axis=1), 1)

    def change(way: Way) -> Array:
        """Of the mean squares ``(n, BLOCKS)``, in units of the default's; negative where better."""
        if way not in known:
            known[way] = score(way)
        return np.asarray(np.where(moved, known[way] - known[default], 0.0) / np.maximum(most, 1e-300)[:, None])

    def unlikely(way: Way) -> float:
        """-2 log of the likelihood per row, each motor's noise as large as what is left of its torques."""
        share = 1.0 + change(way).sum(axis=1) / np.maximum(moved.sum(axis=1), 1)
        return float(np.log(np.maximum(share, 1e-12)).sum())

    best = default
    for source in candidates:
        lengths = [way.window_s for way in source]
        first = min(range(len(source)), key=lambda k: abs(np.log(lengths[k] / best.window_s)))
        best = _downhill(source, first, best, unlikely)
    gain = change(best).sum(axis=0)
    best = best if gain.mean() < -CLEAR * gain.std(ddof=1) / np.sqrt(BLOCKS) else default
    return best, known[best]


def _downhill(source: Sequence[Way], first: int, best: Way, value: Callable[[Way], float]) -> Way:
    """The best way beside ``source[first]``, or ``best`` if none is better."""
    at = first
    for step in (1, -1):
        while 0 <= at + step < len(source) and value(source[at + step]) < value(source[at]):
            at += step
        if at != first:
            break
    return source[at] if value(source[at]) < value(best) else best


class _Score(Protocol):
    def __call__(self, way: Way) -> Array: ...


def left_out_squares(excerpts: Sequence[Excerpt], rows: int) -> Array:
    """Mean squares ``(n, BLOCKS)``, Nm², of torques predicted by a regression that has not seen their block.

    Every motor by itself: rigid-body dynamics of unknown masses, its rotor, dry and viscous friction, and a constant.

    Parameters
    ----------
    excerpts
        The log, or parts of it.
    rows
        How many rows the log has.
    """
    columns = [_columns(e) for e in excerpts]
    block, moving = blocks_of(np.concatenate([e.row for e in excerpts]), rows), [e.moving for e in excerpts]
    motors = [np.concatenate([part[m] for part in columns]) for m in range(len(columns[0]))]
    every = zip(motors, np.concatenate(moving).T, strict=True)
    return np.array([_squares(both[used], block[used]) for both, used in every])


def chosen_rows(row: Integers, rows: int) -> Bools:
    """Which rows ``(k,)`` of a log of ``rows`` are regressed."""
    return np.asarray(row % max(1, rows // ROWS) == 0)


def blocks_of(row: Integers, rows: int) -> Integers:
    """Of which of the log's blocks each row ``(k,)`` is."""
    return np.asarray(np.minimum(row * BLOCKS // max(rows, 1), BLOCKS - 1))


def _columns(e: Excerpt) -> list[Array]:
    """Per motor the regressor of the rows, and last the torque ``(w, p + 1)``."""
    q, qd, qdd = e.motion.position, e.motion.speed, e.motion.acceleration
    T, n = np.asarray(e.campaign.robot.transmission), e.campaign.robot.n
    still, moved = gravity_signals(e.campaign, q), inertial_signals(e.campaign, q, qd, qdd)
    bodies = np.concatenate([still["regressor"] + moved["regressor"], moved["link_inertia_regressor"]], axis=2)
    speed = qd @ np.linalg.inv(T)
    out = []
    for m in range(n):
        at = np.flatnonzero(T[m])
        own = [T[m, j] * bodies[:, j] for j in at]
        columns = [sum(own[1:], own[0]), qdd[:, at], np.sign(speed[:, [m]]), speed[:, [m]], np.ones((len(q), 1))]
        out.append(np.concatenate([*columns, e.torque[:, m, None]], axis=1))
    return out


def _squares(both: Array, block: Integers) -> Array:
    """Mean squares ``(BLOCKS,)`` of one motor's rows ``(k, p + 1)``, each predicted without its fold of blocks.

    NaN for blocks in which the motor does not move.
    """
    size = np.linalg.norm(both, axis=0)
    # What turns without this motor is zero but for rounding; balanced, that would be columns of noise.
    kept = size > ROUNDING * size.max()
    kept[-1] = True
    fold, both = block % FOLDS, both[:, kept]
    grams = np.array([both[fold == f].T @ both[fold == f] for f in range(FOLDS)])
    out = np.full(BLOCKS, np.nan)
    for f in range(FOLDS):
        mine = fold == f
        if not mine.any():
            continue
        # Added, not taken off the whole: where a column is of this fold alone, a difference would leave rounding.
        theta = _solved(grams[np.arange(FOLDS) != f].sum(axis=0), np.diag(grams.sum(axis=0))[:-1])
        left = (both[mine, -1] - both[mine, :-1] @ theta) ** 2
        sums, counts = (np.bincount(block[mine], w, minlength=BLOCKS) for w in (left, np.ones(len(left))))
        out[counts > 0] = sums[counts > 0] / counts[counts > 0]
    return out


def _solved(gram: Array, squares: Array) -> Array:
    """Least squares from the sums of products of columns and, last, target; what they do not show stays near zero.

    ``squares`` ``(p,)``: of each column over the whole log, by which they are balanced: these rows do not show a column
    that is next to nothing in them.
    """
    A, b = gram[:-1, :-1], gram[:-1, -1]
    balance = 1.0 / np.sqrt(np.maximum(squares, 1e-300))
    balanced = A * np.outer(balance, balance) + RIDGE * np.eye(len(A))
    return np.asarray(balance * linalg.solve(balanced, b * balance, assume_a="pos"))
