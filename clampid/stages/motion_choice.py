"""Speeds and accelerations of a log: from which columns, and over how long a window. The measured torques decide.

Noise of the acceleration biases whatever it multiplies towards zero (errors in variables), and a window that is too
long blurs the motion. Both raise the error of torques that were not fitted. So for each candidate, every motor's
torque is regressed on rigid-body dynamics, rotor inertia and friction by least squares, in which blocks of the log are
predicted without themselves; the candidate with the least error is taken. The default (the recorded speeds where there
are any, the shortest window) stays unless another one's error is smaller by more than two standard errors of the
paired difference over the blocks: of logs whose motion has no visible noise, about 2 % leave it by chance. In a sparse
log moves between rests may be taken as trapezoids of speed (:mod:`experiments.signals.moves`), by the same rule.

Sources: errors in variables: Fuller, Measurement Error Models (1987), section 1.1; the choice of a filter's bandwidth
by cross-validation: Fan & Gijbels, Local Polynomial Modelling and Its Applications (1996), section 4.2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import linalg

from clampid.stages.loads import gravity_signals, inertia_torque, inertial_signals
from clampid.stages.rows import Array, Bools, Integers
from experiments.campaign import Campaign

__all__ = [
    "BLOCKS",
    "LONGEST_S",
    "Excerpt",
    "Regression",
    "Way",
    "blocks_of",
    "chosen_rows",
    "chosen_way",
    "trusted_rows",
    "ways",
]

LONGEST_S = 0.64  # an arm's accelerations change within less
BLOCKS = 25  # of the log, in five folds that alternate: a block's neighbours are fitted when it is predicted
FOLDS = 5
ROWS = 4000  # of the log, about, that are regressed
CLEAR_DIFFERENCE = 2.0  # standard errors of the paired difference
SHARES_OF_ROWS = (0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8)  # of the rows in motion, which may count alone
ROWS_WEIGHED = 100  # of the log, about, for the inertia about the joints
NEGLIGIBLE = 0.5  # of the noise
RESOLVED = 1e-4  # of the accelerations: a misfit below is none
NEGLIGIBLE_COLUMN = 1e-9  # of the largest column, or joint's acceleration: what is less is rounding
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
    direct
        Whether accelerations are taken from the positions in one step, so that they depend on fewer samples.
    in_moves
        Whether rows of moves that are trapezoids of speed have the trapezoid's speed and acceleration.
    trusted
        ``(n,)``, rad/s²: rows whose samples are farther off the curves taken for them do not count. Empty: all do.
    """

    logged: bool
    window_s: float
    smoothed: bool = False
    direct: bool = False
    in_moves: bool = False
    trusted: tuple[float, ...] = ()


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
    misfit
        ``(w, n)``, rad/s²: by how far their samples are from the curves taken for them.
    """

    campaign: Campaign
    motion: Motion
    torque: Array
    moving: Bools
    row: Integers
    misfit: Array


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
    """The candidate of least held-out error, or the default if none is clearly better; and its held-out squares.

    Along the first source a search ends with the first window that makes the error larger; of another source the best
    window of the first is tried, and those beside it as long as they make the error smaller.

    Parameters
    ----------
    score
        Candidate → held-out squares ``(n, BLOCKS)``, Nm², of the same rows for every candidate.
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
    best = best if _clearly_less(_gains(known[default], known[best])) else default
    return best, known[best]


def _gains(before: Array, after: Array) -> Array:
    """Log of the ratio of squares ``(n, BLOCKS)`` per block, mean of the motors, of the blocks that have both.

    A log of several speeds has nearly all of its squares in a few blocks, whose difference no other block confirms.
    Their ratios can be compared.
    """
    both = np.isfinite(before) & np.isfinite(after)
    ratio = np.log(np.maximum(after[both], 1e-300) / np.maximum(before[both], 1e-300))
    counts = both.sum(axis=0)
    sums = np.bincount(np.nonzero(both)[1], ratio, minlength=BLOCKS)
    return np.asarray(sums[counts > 0] / counts[counts > 0])


def _clearly_less(gains: Array) -> bool:
    """Whether the mean of some blocks' gains is negative by more than two standard errors."""
    return len(gains) > 1 and bool(gains.mean() < -CLEAR_DIFFERENCE * gains.std(ddof=1) / np.sqrt(len(gains)))


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


class Regression:
    """Every motor's torque by itself on rigid-body dynamics of unknown masses, its rotor, friction and a constant.

    Parameters
    ----------
    excerpts
        The log, or parts of it, their motion taken in one way.
    rows
        How many rows the log has.
    """

    def __init__(self, excerpts: Sequence[Excerpt], rows: int) -> None:
        columns = [_columns(e) for e in excerpts]
        self._motors = [np.concatenate([part[m] for part in columns]) for m in range(len(columns[0]))]
        self._moving = np.concatenate([e.moving for e in excerpts])
        self._block = blocks_of(np.concatenate([e.row for e in excerpts]), rows)
        self._misfit = np.concatenate([e.misfit for e in excerpts])
        moves = self._moving.any(axis=1)
        acceleration = np.concatenate([np.abs(e.motion.acceleration) for e in excerpts])
        top = np.max(acceleration[moves], axis=0, initial=1e-12)
        misfit = np.min(self._misfit[moves], axis=0, initial=np.inf)
        stands = (top <= misfit) | (top <= NEGLIGIBLE_COLUMN * top.max())
        self.top = np.where(stands, np.inf, top)
        """Largest accelerations ``(n,)`` of rows in motion, rad/s²; infinite of a joint that stands.

        Its accelerations are rounding, or all within their misfits: these would be large beside none.
        """
        self._excerpts = excerpts

    @cached_property
    def unresolved(self) -> Array:
        """How badly rows ``(k,)`` show their motion: the largest of the joints' misfits over their accelerations."""
        moves = np.isfinite(self.top)
        return np.asarray(np.max(self._misfit[:, moves] / self.top[moves], axis=1, initial=0.0))

    def limits(self) -> list[float]:
        """Values of :attr:`unresolved` that leave given shares of the rows in motion, ascending; one in each octave.

        A misfit is known from few samples. With finer steps the rows of a single move may be the best resolved ones,
        which a regression of that move alone predicts best.
        """
        unresolved = self.unresolved[self._moving.any(axis=1)]
        shares = np.quantile(unresolved, SHARES_OF_ROWS, method="lower") if len(unresolved) else np.zeros(0)
        shares = np.maximum(shares[np.isfinite(shares)], RESOLVED)
        octave = np.floor(np.log2(shares / np.min(shares, initial=np.inf)))
        return [float(shares[octave == k].max()) for k in np.unique(octave)]

    def inertia(self) -> Array:
        """Torque of each motor per acceleration of each joint ``(n, n)``, kg m², as described; rms over some rows."""
        n, every = len(self._motors), max(1, sum(len(e.row) for e in self._excerpts) // ROWS_WEIGHED)
        columns, before = [], 0
        for e in self._excerpts:  # the same rows however the log is cut into windows
            q = e.motion.position[(before + np.arange(len(e.row))) % every == 0]
            before += len(e.row)
            T, ones = np.asarray(e.campaign.robot.transmission), np.broadcast_to(np.eye(n), (len(q), n, n))
            still = np.zeros_like(q)
            columns.append(np.stack([inertia_torque(e.campaign, q, still, ones[:, j]) @ T.T for j in range(n)], axis=2))
        return np.asarray(np.sqrt(np.mean(np.concatenate(columns) ** 2, axis=0)))

    def squares(self, fitted: Bools | None = None, judged: Bools | None = None) -> Array:
        """Held-out mean squares ``(n, BLOCKS)``, Nm²: torques predicted by a regression on the other folds.

        Parameters
        ----------
        fitted, judged
            ``(k,)``: which rows are regressed, and which are predicted; by default all in which the motor moves.
        """
        every = np.ones(len(self._block), dtype=bool)
        fitted, judged = (every if chosen is None else chosen for chosen in (fitted, judged))
        return np.array(
            [
                _squares(both, self._block, moving & fitted, moving & judged)
                for both, moving in zip(self._motors, self._moving.T, strict=True)
            ]
        )


def trusted_rows(plain: Regression, direct: Regression, left_out: Array) -> tuple[tuple[float, ...], Array]:
    """The misfits ``(n,)`` from which on rows do not count, or none; and squares left out ``(n, BLOCKS)`` of the rest.

    If a whole ramp lies between two samples of a log, no derivative is right there, and the errors of such rows bias
    the fit. So the regression is repeated with only the best resolved rows. All rows count unless the held-out error of
    the best resolved rows falls by more than two standard errors over the blocks. Else the share with the least error
    counts, and of it the rows whose misfits, with the described masses, are small compared with the noise; at least a
    twentieth of all. (This last condition is needed because rows of a repeated program have equal errors, which a
    regression predicts well.)

    Parameters
    ----------
    plain, direct
        The log with its motion as chosen, and with accelerations that depend on fewer samples.
    left_out
        The squares of the former.
    """
    limits = direct.limits()
    if not limits:
        return (), left_out
    best = direct.unresolved <= limits[0]
    before = plain.squares(judged=best)
    if np.count_nonzero(np.isfinite(before).any(axis=0)) < FOLDS:
        return (), left_out

    gains = {limit: _gains(before, direct.squares(fitted=direct.unresolved <= limit, judged=best)) for limit in limits}
    chosen = min(limits, key=lambda limit: float(gains[limit].mean()))
    if not _clearly_less(gains[chosen]):
        return (), left_out
    kept = direct.unresolved <= chosen
    squares = direct.squares(kept, kept)
    noise = np.array([np.sqrt(np.mean(s[np.isfinite(s)])) if np.isfinite(s).any() else np.inf for s in squares])
    harmless = NEGLIGIBLE * noise[:, None] / np.maximum(len(noise) * direct.inertia(), 1e-300)
    limit = np.minimum(chosen, np.maximum(harmless.min(axis=0) / direct.top, limits[0]))
    return tuple(float(v) for v in (1.0 + NEGLIGIBLE_COLUMN) * limit * direct.top), squares


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


def _squares(both: Array, block: Integers, fitted: Bools, judged: Bools) -> Array:
    """Mean squares ``(BLOCKS,)`` of one motor's judged rows, each predicted by the fitted ones of the other folds.

    Parameters
    ----------
    both
        ``(k, p + 1)``: regressor and torque.
    block
        ``(k,)``: five folds of blocks alternate.
    fitted, judged
        ``(k,)``.

    Returns
    -------
    Array
        NaN for blocks of which no row is judged.
    """
    out = np.full(BLOCKS, np.nan)
    if not fitted.any():
        return out
    size = np.linalg.norm(both[fitted], axis=0)
    # What turns without this motor is zero but for rounding; balanced, that would be columns of noise.
    kept = size > NEGLIGIBLE_COLUMN * size.max()
    kept[-1] = True
    fold, both = block % FOLDS, both[:, kept]
    grams = np.array([both[fitted & (fold == f)].T @ both[fitted & (fold == f)] for f in range(FOLDS)])
    for f in range(FOLDS):
        mine = judged & (fold == f)
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
