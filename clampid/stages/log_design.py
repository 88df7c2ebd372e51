"""The design matrix of a torque log, one window at a time: motors' rows, linearised about some parameters.

The same rows count as in `clampid.stages.torques`, with the same predictions. Only the design is kept in memory, and
of a long log not even that: its windows are read again in every pass.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from clampid.chain.chain import Chain
from clampid.stages.counting import FIFTHS, counting, folds_of, motion_signals, negligible, standing_joints
from clampid.stages.log_facts import WINDOW, LogFacts, LogPart
from clampid.stages.log_motion import joint_columns, stacked
from clampid.stages.prewhitening import LONGEST_LAG, Grouping, Whitener
from clampid.stages.rows import Array, Bools, Integers
from clampid.stages.temperatures import reads_temperatures, temperatures
from clampid.stages.torque_kernel import TorqueKernel, torque_kernel
from experiments.log_windows import Window, windows

__all__ = ["Block", "Channel", "LogDesign", "Sampled"]

ROWS_AT_ONCE = 1 << 11  # rows of a window that the kernel evaluates at once: what it gives of them stays in the cache
KEPT_BYTES = 1 << 28  # of a short log all windows are kept


@dataclass(frozen=True)
class Channel:
    """The rows of one motor that count in a window, after those shortly before it.

    Attributes
    ----------
    row
        ``(k,)``: which rows of the log.
    own
        How many of the first are of the window before.
    stretch
        ``(k,)``: number of the stretch of the window that the row is of; between two, the clock breaks off.
    fold
        ``(k,)``: the fold each row is of.
    columns
        ``(p,)``: which parameters can touch this motor here.
    both
        ``(k, p + 1)``: the prediction's derivative; last, measured less predicted torque where the design is, Nm.
    together
        How many rows are one number to the noise.
    """

    row: Integers
    own: int
    stretch: Integers
    fold: Integers
    columns: Integers
    both: Array
    together: int

    @cached_property
    def groups(self) -> Grouping:
        """The groups of rows that share their noise."""
        return Grouping.of(self.row, self.stretch, self.together)

    @cached_property
    def whitener(self) -> Whitener:
        """The filter of all of these groups."""
        return Whitener(self.groups.row, self.groups.stretch)


@dataclass(frozen=True)
class Block:
    """A window's own rows, ``first`` to ``stop`` of the log, and its motors; ``run`` and ``fold`` ``(rows,)``."""

    first: int
    stop: int
    run: Integers
    fold: Integers
    channels: tuple[Channel, ...]


@dataclass(frozen=True)
class Sampled:
    """Some rows of one motor that count: rows of the log ``(k,)``, parameters ``(p,)`` and derivatives ``(k, p)``."""

    motor: int
    row: Integers
    columns: Integers
    values: Array


@dataclass(frozen=True)
class _Prepared:
    """A window's rows, as far as they do not depend on any parameter.

    Attributes
    ----------
    signals
        ``(k, s)``: what the kernel reads, of the rows of which some motor counts by its motion.
    counts, measured
        ``(k, n)``: which motors count, and their torques, Nm.
    row, stretch, run, fold
        ``(k,)``.
    bare
        The window, no channels yet.
    """

    kernel: TorqueKernel
    signals: Array
    counts: Bools
    measured: Array
    row: Integers
    stretch: Integers
    run: Integers
    fold: Integers
    bare: Block

    @property
    def size(self) -> int:
        """Bytes, about."""
        return self.measured.nbytes + self.signals.nbytes + 6 * self.row.nbytes


@dataclass
class _Carried:
    """Directions in which joints and motors last moved before a window begins."""

    run: int
    joint: Array
    motor: Array


class LogDesign:
    """A log's design, for any number of passes.

    If effects are not linear in their parameters, it is linearised about ``at`` ``(P + K,)``, at first zero;
    :meth:`move` changes that point.

    Parameters
    ----------
    parts
        The tables of the log.
    facts
        What is known of it as a whole.
    chain
        The effects.
    wrist
        Joints whose transmission is coupled.
    accelerating
        Use rows in acceleration.
    window
        Rows at once.
    kept_bytes
        How much of the design may be kept between passes.
    sampled
        About how many rows of the log the first pass samples.
    """

    def __init__(
        self,
        parts: Sequence[LogPart],
        facts: LogFacts,
        chain: Chain,
        wrist: Sequence[int],
        accelerating: bool,
        *,
        window: int = WINDOW,
        kept_bytes: int = KEPT_BYTES,
        sampled: int = 0,
    ) -> None:
        self.parts, self.facts, self.chain, self.wrist = parts, facts, chain, tuple(wrist)
        self.accelerating, self.window, self.kept_bytes = accelerating, window, kept_bytes
        self.n = parts[0].campaign.robot.n
        self.T = np.asarray(parts[0].campaign.robot.transmission)
        campaigns = {part.session: part.campaign for part in parts}
        self.kernels = {session: torque_kernel(campaign, chain) for session, campaign in campaigns.items()}
        self.linear = all(kernel.linear for kernel in self.kernels.values())
        self._every = max(1, facts.rows // max(sampled, 1))
        self._kept: list[Block] | None = None
        self._too_long = False
        self._sample: list[Sampled] | None = None
        self._prepared: list[_Prepared] | None = None
        self.at = np.zeros(self.parameters)

    @cached_property
    def offset_keys(self) -> Integers:
        """``(K, 2)``: run and joint of the coupled joints that stand still for a whole run."""
        return standing_joints(self.facts, self.wrist)

    @property
    def parameters(self) -> int:
        """P + K: slots, and frictions of joints that stand still for a whole run."""
        return len(self.chain.slots) + len(self.offset_keys)

    @property
    def fold_rows(self) -> Integers:
        """``(F,)``: rows of each fold."""
        if len(self.facts.runs) > 1:
            return self.facts.length
        ends = [-(-k * self.facts.rows // FIFTHS) for k in range(FIFTHS + 1)]  # where `folds_of` begins the next
        return np.asarray(np.diff(np.array(ends)), dtype=np.int64)

    def sample(self) -> list[Sampled]:
        """Rows spread over the log, motor by motor."""
        if self._sample is None:
            for _ in self:
                pass
        return self._sample or []

    def forget(self) -> None:
        """Drop what was kept between passes."""
        self._kept = self._sample = self._prepared = None

    def move(self, theta: Array) -> None:
        """Linearise about these slots' values ``(P + K,)``; constants of runs are linear and stay zero."""
        at = np.r_[theta[: len(self.chain.slots)], np.zeros(len(self.offset_keys))]
        if not self.linear and not np.array_equal(at, self.at):
            self.at = at
            self._kept = self._sample = None

    def __iter__(self) -> Iterator[Block]:
        if self._kept is not None:
            yield from self._kept
            return
        kept: list[Block] | None = None if self._too_long else []
        sample: list[Sampled] = []
        size = 0
        for block in self._blocks():
            sample += self._some(block)
            size += sum(c.both.nbytes + 5 * c.row.nbytes for c in block.channels)
            if size > self.kept_bytes:
                kept, self._too_long = None, True
            elif kept is not None:
                kept.append(block)
            yield block
        self._kept, self._sample = kept, sample

    def _some(self, block: Block) -> list[Sampled]:
        """The sampled rows of a window."""
        out = []
        for c, channel in enumerate(block.channels):
            chosen = channel.own + np.flatnonzero(channel.row[channel.own :] % self._every == 0)
            out.append(Sampled(c, channel.row[chosen], channel.columns, channel.both[chosen, :-1]))
        return out

    def _blocks(self) -> Iterator[Block]:
        if self._prepared is not None:
            yield from map(self._block, self._prepared)
            return
        kept: list[_Prepared] | None = None if self.linear or self._too_long else []
        size = 0
        for window in self._windows():
            if kept is not None:
                size += window.size
                kept = [*kept, window] if size <= self.kept_bytes else None
            yield self._block(window)
        self._prepared = kept

    def _windows(self) -> Iterator[_Prepared]:
        read = {name for kernel in self.kernels.values() for name, _ in kernel.signals}
        names = [*self.facts.motions.columns, *joint_columns("tau", "Nm", self.n)]
        before = 0
        for p, part in enumerate(self.parts):
            warm = [c for c in part.table.names if c.startswith("temp_")]
            chosen = names + (warm if any(map(reads_temperatures, read)) else [])
            carried: _Carried | None = None
            for w in windows(part.table, chosen, self.window, self.facts.halo):
                prepared, carried = self._prepare(w, p, before, carried)
                yield prepared
            before += part.table.rows

    def _prepare(self, w: Window, p: int, before: int, carried: _Carried | None) -> tuple[_Prepared, _Carried | None]:
        part, facts = self.parts[p], self.facts
        kernel = self.kernels[part.session]
        motion = facts.motions.of(p, w)
        time, number = w.columns["time_s"], w.columns["run"].astype(np.int64)
        first_run = int(np.searchsorted(facts.runs[:, 0], p))
        run = first_run + np.searchsorted(facts.runs[facts.runs[:, 0] == p, 1], number)
        every = motion_signals(motion, self.T, facts, run, time)
        carried = self._carried_on(every, w, run, carried)
        measured = stacked(w, joint_columns("tau", "Nm", self.n))
        counts = counting(every, self.T, facts, run, self.wrist, self.accelerating) & motion.resolved[:, None]
        # Rows before the window's own are needed as far as the noise remembers.
        counts[: max(w.start - LONGEST_LAG * facts.together, 0)] = False
        counts[w.stop :] = False
        chosen = np.flatnonzero(counts.any(axis=1))
        if any(reads_temperatures(name) for name, _ in kernel.signals):
            every |= temperatures(pd.DataFrame(dict(w.columns)), self.n)
        breaks = np.r_[True, (run[1:] != run[:-1]) | (np.abs(np.diff(time) - facts.step) > 0.5 * facts.step)]
        row = before + w.first + np.arange(len(time))
        fold = folds_of(facts, run, row)
        first, mine = before + w.first + w.start, slice(w.start, w.stop)
        prepared = _Prepared(
            kernel=kernel,
            signals=kernel.stacked(every, chosen),
            counts=counts[chosen],
            measured=measured[chosen],
            row=row[chosen],
            stretch=np.cumsum(breaks)[chosen],
            run=run[chosen],
            fold=fold[chosen],
            bare=Block(first, first + w.stop - w.start, run[mine], fold[mine], ()),
        )
        return prepared, carried

    def _block(self, window: _Prepared) -> Block:
        """A window's channels at the parameters that the design is about."""
        kernel = window.kernel
        counts = window.counts.copy()
        found: list[list[Array]] = [[] for _ in range(self.n)]
        for first in range(0, max(len(counts), 1), ROWS_AT_ONCE):
            piece = slice(first, first + ROWS_AT_ONCE)
            inertial, design = kernel.evaluate(self.at[: len(self.chain.slots)], window.signals[piece])
            if not self.accelerating:
                counts[piece] &= negligible(inertial, self.facts)
            for kept, values, used in zip(found, design, counts[piece].T, strict=True):
                kept.append(values[used])
        channels = []
        for c in range(self.n):
            used = np.flatnonzero(counts[:, c])
            columns, extra = self._still(window.run[used], c)
            both = np.concatenate(found[c])
            both[:, -1] = window.measured[used, c] - both[:, -1]
            if len(columns):
                both = np.concatenate([both[:, :-1], extra, both[:, -1:]], axis=1)
            row = window.row[used]
            channels.append(
                Channel(
                    row=row,
                    own=int(np.count_nonzero(row < window.bare.first)),
                    stretch=window.stretch[used],
                    fold=window.fold[used],
                    columns=np.r_[kernel.touched[c], columns],
                    both=both,
                    together=self.facts.together,
                )
            )
        return replace(window.bare, channels=tuple(channels))

    def _carried_on(
        self, signals: dict[str, Array], w: Window, run: Integers, carried: _Carried | None
    ) -> _Carried | None:
        """Carry the signs of the last motion into the window; return those for the next window."""
        joint, motor = signals["joint_motion"], signals["motor_motion"]
        if carried is not None:
            for signs, old in ((joint, carried.joint), (motor, carried.motor)):
                signs[:] = np.where((signs == 0) & (run == carried.run)[:, None], old, signs)
            signals["own_motion"] = joint * np.sign(np.diag(self.T))
        at = w.stop - self.facts.halo - 1  # the row before the next window's first
        return _Carried(int(run[at]), joint[at].copy(), motor[at].copy()) if at >= 0 else None

    def _still(self, run: Integers, motor: int) -> tuple[Integers, Array]:
        """The friction of joints that stand still in these rows' runs: which parameters, and their columns."""
        columns, values = [], []
        keys = self.offset_keys
        for k in np.flatnonzero(np.isin(keys[:, 0], run)) if len(keys) else ():
            if self.T[motor, keys[k, 1]] != 0:
                columns.append(len(self.chain.slots) + int(k))
                values.append((run == keys[k, 0]) * self.T[motor, keys[k, 1]])
        stacked_values = np.column_stack(values) if values else np.zeros((len(run), 0))
        return np.array(columns, dtype=np.int64), stacked_values


def fold_table(parts: Sequence[LogPart], facts: LogFacts) -> Mapping[str, Integers]:
    """Per fold, in order: ``run``, ``part`` and ``session``."""
    if len(facts.runs) > 1:
        part, run = facts.runs[:, 0], np.arange(len(facts.runs))
    else:
        part = run = np.zeros(FIFTHS, dtype=np.int64)
    return {"run": run, "part": part, "session": np.array([parts[p].session for p in part], dtype=np.int64)}
