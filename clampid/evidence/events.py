"""Events as candidates: effects that happen once, such as a slip, each scored at its likeliest time.

An event is a step. Its columns for any time are those of an event before the sweep, set to zero up to that time. So the
effect is evaluated once, and each further time costs only a product with the residual.

Where noise is correlated in time, a whitened step is only a few rows wide and may lie inside one block. Sign flips of
blocks then change nothing. The null is therefore the chi-square tail, times the number of times tried (the union
bound). Systematic misfit, such as at reversals, is no event: it recurs in other sweeps. Therefore the second largest of
the sweeps' maxima sets the scale, if it is larger than expected from noise. Two events would so hide each other. A
second test, for which the p-value is doubled, asks whether the maxima of two sweeps of different joints stand out
together. Sweeps of the same joint cannot be used for it, because misfit recurs in all sweeps of a joint. Of two events
the larger is reported first; the other is searched with the first in the model.
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
from clampid.evidence.score import Scored, score
from clampid.evidence.space import ABSORBED, Space, space_of
from clampid.evidence.tails import log_tail
from clampid.fitting.solve import Estimate
from clampid.slots import Slot, Term
from clampid.stages.clamped_rows import BLOCK_ROWS
from clampid.stages.rows import Array, Integers, Rows
from clampid.stages.stage_kind import kind_of

__all__ = ["absent_events", "event_scores", "time_of"]

# Values of ``sweep_progress`` with which columns are evaluated: an event at the first, all rows at the second.
EVENT_PROGRESS, ROW_PROGRESS = 0.25, 0.75


@dataclass(frozen=True)
class EventScan:
    """What an event would explain at each of T possible times.

    Attributes
    ----------
    time
        ``(T,)``: as values of ``sweep_progress``, each between two rows.
    explained
        ``(T,)``: sum of squares explained, in units of the residual's variance.
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
        """Natural logarithm of the p-value of the likeliest time, corrected for all times tried.

        Parameters
        ----------
        freedom
            Number of amplitudes of the event.
        entries
            Number of whitened entries.
        """
        _, first = np.unique(np.floor(self.time), return_index=True)
        largest = np.maximum.reduceat(self.explained, first)  # times ascend, so each sweep's are consecutive
        best = int(np.argmax(largest))
        elsewhere = np.where(self.driven[first] != self.driven[first][best], largest, 0.0)
        usual = float(stats.chi2.isf(1.0 / len(self.time), freedom))
        tails = []
        for events in ([best], *([[best, int(np.argmax(elsewhere))]] if elsewhere.any() else [])):
            unbiased = (
                max(entries - float(largest[events].sum()), 1.0) / entries
            )  # residual variance without the events
            scale = max([unbiased, *(np.delete(largest, events) / usual)])
            tails.append(float(log_tail(float(largest[events].min()) / scale, freedom)))
        tests = len(tails) * len(self.time)
        return min(min(tails) + float(np.log(tests)), 0.0)


def absent_events(estimate: Estimate, effects: Mapping[str, Effect]) -> list[Effect]:
    """The events that can act in an estimate's stage and are not in it."""
    active, stage = {slot.effect for slot in estimate.slots}, estimate.problem.stage
    found = [e for e in effects.values() if e.event is not None and kind_of(stage).has(e) and e.name not in active]
    return [e for e in found if e.search.refines is None or e.search.refines in active]


def event_scores(estimate: Estimate, space: Space, effects: Mapping[str, Effect]) -> list[Scored]:
    """Each absent event at its likeliest time; p-value and cost are corrected for all times tried.

    Parameters
    ----------
    estimate, space
        A fit of sweeps, and its residual with the span that it absorbs.
    effects
        All known effects, by name.
    """
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
            s = s.of_many(log_p, chosen)
        found.append(s)
    return found


def time_of(estimate: Estimate, effect: Effect) -> dict[Slot, float]:
    """The likeliest time of an event that is not in a fit, as the value of its slot; empty if no sweep can show it."""
    scan = _scanned(estimate, space_of(estimate), _unit_steps(estimate, effect))
    return {} if scan is None else {_time_slot(effect): scan.best}


def _time_slot(effect: Effect) -> Slot:
    return Slot(effect.name, str(effect.event), effect.at)


def _amplitudes(effect: Effect) -> tuple[Slot, ...]:
    return tuple(Slot(effect.name, p.name, effect.at) for p in effect.parameters if not p.shape)


def _unit_steps(estimate: Estimate, effect: Effect) -> Array:
    """Derivatives ``(N, m, k)`` of the rows by each of an event's amplitudes, as if all rows came after it."""
    rows, count, slots = estimate.problem.rows, len(estimate.slots), _amplitudes(effect)
    after = replace(rows, signals={**rows.signals, "sweep_progress": np.full(len(rows), ROW_PROGRESS)})
    trial = estimate.problem.with_slots((*estimate.slots, *slots, _time_slot(effect))).with_rows(after)
    theta = np.r_[estimate.theta[:count], np.zeros(len(slots)), EVENT_PROGRESS, estimate.theta[count:]]
    return np.asarray(trial.residual(theta)[1][:, :, count : count + len(slots)])


def _positions(rows: Rows) -> tuple[Integers, Integers]:
    """Position of each row in its sweep, from 0, and the number of rows of that sweep: ``(N,)`` each."""
    _, run, length = np.unique(rows.series.run, return_inverse=True, return_counts=True)
    share = rows.signals["sweep_progress"] % 1.0
    return np.rint(share * length[run]).astype(np.int64), length[run]


def _scanned(estimate: Estimate, space: Space, steps: Array) -> EventScan | None:
    """An event at every time of every sweep; None if no sweep can show it at any time.

    Times with less than a block of rows before or after them are left out: such an event cannot be distinguished from
    the sweep's start or end.
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
    return EventScan(np.array(time), np.array(explained), np.array(driven, dtype=np.int64)) if time else None


@dataclass(frozen=True)
class _Sums:
    """Products of an event's columns D at each of S times in one sweep, accumulated channel by channel.

    D'D ``(S, k, k)``, Q'D ``(S, r, k)`` and D'r ``(S, k)``, with the basis Q of what the fit absorbs and its residual
    r.
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
        """Sum of squares that the columns explain at a time; None if the active parameters absorb them all."""
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
    """An event at a time (a value of ``sweep_progress``) as a candidate."""
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
        shapes={_time_slot(effect): time},
        columns=Columns(pieces, len(slots)),
        depends_on=(),
        places=(effect.at,),
        reasonable=np.array([effect.by_name[s.parameter].size for s in slots]),
        units=tuple(effect.by_name[s.parameter].unit for s in slots),
    )
