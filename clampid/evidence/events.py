"""Events as candidates: effects that happen once, at the likeliest of all times at which a sweep would show them.

What an event does is a step: its columns at any time are those that it would have had before its sweep began, zero up
to then. So the effect is evaluated once, and a time costs no more than a product with the residual.

The whitened image of a step is a few rows wide where noise lasts, so that it may lie in one block whole. Flipping the
signs of blocks then changes nothing, and the null is the chi-square tail, times the number of times that were tried
(the union bound). What residuals hold beyond noise, such as a misfit at reversals, is no event: it comes again in other
sweeps, so that the second of the sweeps' largest statistics sets the scale, where it is larger than noise makes it.
Two events would so hide each other: at twice the number of tests it is also asked whether the largest of another
joint's sweeps stands out of all the rest. Of the same joint it would not do, since a misfit comes again in all sweeps
of its joint. Of two events the larger is named first, and the other is looked for with the first in the model.
Sources: Page, A test for a change in a parameter occurring at an unknown point, Biometrika 42, 1955; Devlin, Roeder,
Genomic control for association studies, Biometrics 55, 1999, for the scale from statistics of the same test.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from clampid.effect import Effect
from clampid.evidence.candidates import Candidate
from clampid.evidence.columns import Columns, channel_starts
from clampid.evidence.score import Scored, log_tail, score
from clampid.evidence.space import ABSORBED, Space, space_of
from clampid.fitting.solve import Estimate
from clampid.slots import Slot, Term
from clampid.stages.clamped_rows import BLOCK_ROWS
from clampid.stages.rows import Array, Integers, Rows
from clampid.stages.stage_kind import kind_of

__all__ = ["absent_events", "event_scores", "time_of"]

BEFORE, LATE = 0.25, 0.75  # in ``sweep_progress``: an event, and rows that all come after it


@dataclass(frozen=True)
class Scan:
    """What an event would explain at each time at which it could have happened.

    Attributes
    ----------
    time, explained
        ``(T,)``: in ``sweep_progress``, between two rows; sum of squares, in units of the residual's variance.
    driven
        ``(T,)``: the joint that the sweep drives, from 0.
    """

    time: Array
    explained: Array
    driven: Integers

    @property
    def best(self) -> float:
        """The likeliest time."""
        return float(self.time[np.argmax(self.explained)])

    def log_p(self, freedom: int, entries: int) -> float:
        """Natural logarithm of the chance that noise, or what other sweeps show too, explains as much at any time.

        Parameters
        ----------
        freedom
            Amplitudes of the event.
        entries
            How many whitened numbers there are.
        """
        _, first = np.unique(np.floor(self.time), return_index=True)
        largest = np.maximum.reduceat(self.explained, first)  # in the order of time, so that sweeps are runs
        best = int(np.argmax(largest))
        elsewhere = np.where(self.driven[first] != self.driven[first][best], largest, 0.0)
        usual = float(stats.chi2.isf(1.0 / len(self.time), freedom))
        tails = []
        for events in ([best], *([[best, int(np.argmax(elsewhere))]] if elsewhere.any() else [])):
            unbiased = max(entries - float(largest[events].sum()), 1.0) / entries  # the residual's variance without
            scale = max([unbiased, *(np.delete(largest, events) / usual)])
            tails.append(float(log_tail(float(largest[events].min()) / scale, freedom)))
        tests = len(tails) * len(self.time)
        return min(min(tails) + float(np.log(tests)), 0.0)


def absent_events(estimate: Estimate, effects: Mapping[str, Effect]) -> list[Effect]:
    """The events that could act in an estimate's stage and that it leaves out."""
    active, stage = {slot.effect for slot in estimate.slots}, estimate.problem.stage
    found = [e for e in effects.values() if e.event is not None and kind_of(stage).has(e) and e.name not in active]
    return [e for e in found if e.search.refines is None or e.search.refines in active]


def event_scores(estimate: Estimate, space: Space, effects: Mapping[str, Effect]) -> list[Scored]:
    """Each absent event at its likeliest time; the p-value and the cost are those of all the times that were tried."""
    found = []
    for effect in absent_events(estimate, effects):
        steps = _unit_steps(estimate, effect)
        scan = _scanned(estimate, space, steps)
        if scan is None:
            continue
        s = score(space, [_candidate(estimate, effect, steps, scan.best)])[0]
        if s.freedom:
            chosen = 2.0 * float(np.log(len(scan.time)))
            log_p = scan.log_p(s.freedom, len(estimate.whitened.residual))
            s = replace(s, log_p=log_p, cost=s.cost + chosen, bic=s.bic - chosen)
        found.append(s)
    return found


def time_of(estimate: Estimate, effect: Effect) -> dict[Slot, float]:
    """When an event that a fit leaves out is likeliest to have happened; empty where it cannot show."""
    scan = _scanned(estimate, space_of(estimate), _unit_steps(estimate, effect))
    return {} if scan is None else {_clock(effect): scan.best}


def _clock(effect: Effect) -> Slot:
    return Slot(effect.name, str(effect.event), effect.at)


def _amplitudes(effect: Effect) -> tuple[Slot, ...]:
    return tuple(Slot(effect.name, p.name, effect.at) for p in effect.parameters if not p.shape)


def _unit_steps(estimate: Estimate, effect: Effect) -> Array:
    """What a unit of each of an event's amplitudes does to rows after it ``(N, m, k)``."""
    rows, count, slots = estimate.problem.rows, len(estimate.slots), _amplitudes(effect)
    after = replace(rows, signals={**rows.signals, "sweep_progress": np.full(len(rows), LATE)})
    trial = estimate.problem.with_slots((*estimate.slots, *slots, _clock(effect))).with_rows(after)
    theta = np.r_[estimate.theta[:count], np.zeros(len(slots)), BEFORE, estimate.theta[count:]]
    return np.asarray(trial.residual(theta)[1][:, :, count : count + len(slots)])


def _positions(rows: Rows) -> tuple[Integers, Integers]:
    """Where each row stands in its sweep, from 0, and how many rows that has: ``(N,)`` each."""
    _, run, length = np.unique(rows.series.run, return_inverse=True, return_counts=True)
    share = rows.signals["sweep_progress"] % 1.0
    return np.rint(share * length[run]).astype(np.int64), length[run]


def _scanned(estimate: Estimate, space: Space, steps: Array) -> Scan | None:
    """An event at every time of every sweep; None where no sweep shows it at any.

    With less than a block of rows before it or after it, an event is as good as the sweep's beginning or end.
    """
    rows, white, k = estimate.problem.rows, estimate.whitened, steps.shape[2]
    position, length = _positions(rows)
    run, progress = rows.series.run, rows.signals["sweep_progress"]
    starts = np.arange(BLOCK_ROWS, int(length.max(initial=0)) - BLOCK_ROWS + 1)
    sums: dict[int, _Sums] = {}
    for first, stop in channel_starts(white):
        channel, entry = int(white.channel[first]), run[white.entry[first:stop]]
        stepped = steps[:, channel, None, :] * (position[:, None] >= starts)[:, :, None]
        columns = estimate.noise.whiten_channel(rows, channel, stepped.reshape(len(rows), -1))
        for sweep in np.unique(entry):
            own = np.flatnonzero(entry == sweep)
            D, place = columns[own], first + own
            mine = sums.setdefault(int(sweep), _Sums.zero(len(starts), k, space.basis.shape[1]))
            mine.add(D, space.basis[place], space.residual[place])
    time, explained, driven = [], [], []
    for row in np.flatnonzero((position >= BLOCK_ROWS) & (position + BLOCK_ROWS <= length)):
        value = sums[int(run[row])].explained(int(position[row]) - BLOCK_ROWS) if int(run[row]) in sums else None
        if value is not None:
            time.append(float(progress[row]) - 0.5 / float(length[row]))
            explained.append(value / space.scale**2)
            driven.append(int(rows.sweep.driven[row]))
    return Scan(np.array(time), np.array(explained), np.array(driven, dtype=np.int64)) if time else None


@dataclass(frozen=True)
class _Sums:
    """What a score needs of an event's columns D at each of S times in one sweep, filled channel by channel.

    D'D ``(S, k, k)``, Q'D ``(S, r, k)`` and D'r ``(S, k)``.
    """

    gram: Array
    absorbed: Array
    amplitude: Array

    @classmethod
    def zero(cls, times: int, k: int, r: int) -> _Sums:
        return cls(np.zeros((times, k, k)), np.zeros((times, r, k)), np.zeros((times, k)))

    def add(self, D: Array, basis: Array, residual: Array) -> None:
        """Add one channel: ``(L, S k)``, ``(L, r)``, ``(L,)``."""
        times, k = self.amplitude.shape
        by_time = D.reshape(len(D), times, k).transpose(1, 0, 2)
        self.gram[:] += by_time.transpose(0, 2, 1) @ by_time
        self.absorbed[:] += (basis.T @ D).reshape(-1, times, k).transpose(1, 0, 2)
        self.amplitude[:] += (residual @ D).reshape(times, k)

    def explained(self, time: int) -> float | None:
        """Sum of squares that the columns explain at a time; None where what is active absorbs them all."""
        gram, absorbed = self.gram[time], self.absorbed[time]
        length = np.sqrt(np.diag(gram))
        if not length.all():
            return None
        values, vectors = np.linalg.eigh((gram - absorbed.T @ absorbed) / np.outer(length, length))
        keep = values > ABSORBED
        parts = (vectors.T @ (self.amplitude[time] / length))[keep]
        return float(np.sum(parts**2 / values[keep])) if keep.any() else None


def _whitened_step(estimate: Estimate, steps: Array, after: Array) -> Array:
    """Whitened columns ``(M, k)`` of a step in every sweep at once, from the rows ``after`` ``(N,)`` on."""
    stepped = steps * after[:, None, None]
    return estimate.noise.whiten(estimate.problem.rows, np.zeros(stepped.shape[:2]), stepped).jacobian


def _candidate(estimate: Estimate, effect: Effect, steps: Array, time: float) -> Candidate:
    """An event at a time."""
    rows, white = estimate.problem.rows, estimate.whitened
    progress = rows.signals["sweep_progress"]
    columns = _whitened_step(estimate, steps, (progress > time) & (progress < np.floor(time) + 1.0))
    slots = _amplitudes(effect)
    pieces = tuple((first, columns[first:stop]) for first, stop in channel_starts(white))
    return Candidate(
        name=effect.name,
        family=effect.family,
        terms=(Term(effect.name, effect.at),),
        slots=slots,
        shapes={_clock(effect): time},
        columns=Columns(pieces, len(slots)),
        depends_on=(),
        places=(effect.at,),
        reasonable=np.array([effect.by_name[s.parameter].size for s in slots]),
        units=tuple(effect.by_name[s.parameter].unit for s in slots),
    )
