"""A torque log as what a fit linear in its parameters needs of it, a window at a time: motors' rows of the design.

The same rows count as in `clampid.stages.torques`, and the same torques are predicted; but nothing is kept of a row
besides, and of a long log not even that: its windows are read again whenever they are gone through.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from clampid.chain import Chain
from clampid.prewhitening import REACH
from clampid.stages.log_facts import WINDOW, LogFacts, LogPart, joint_columns, motion_of, stacked
from clampid.stages.rows import Array, Bools, Integers
from clampid.stages.torque_kernel import TorqueKernel, torque_kernel
from clampid.stages.torques import FIFTHS, INERTIA_SHARE, temperatures
from experiments.log_windows import Window, windows
from experiments.signals import held_sign

__all__ = ["Block", "Channel", "LogDesign"]

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
        ``(k, p + 1)``: the prediction's derivative; last, measured less predicted torque at zero parameters, Nm.
    """

    row: Integers
    own: int
    stretch: Integers
    fold: Integers
    columns: Integers
    both: Array


@dataclass(frozen=True)
class Block:
    """A window's own rows, ``first`` to ``stop`` of the log, and its motors; ``run`` and ``fold`` ``(rows,)``."""

    first: int
    stop: int
    run: Integers
    fold: Integers
    channels: tuple[Channel, ...]


@dataclass
class _Held:
    """The way that joints and motors last moved, before a window begins."""

    run: int
    joint: Array
    motor: Array


class LogDesign:
    """A log's design, to be gone through as often as wanted.

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
    ) -> None:
        self.parts, self.facts, self.chain, self.wrist = parts, facts, chain, tuple(wrist)
        self.accelerating, self.window, self.kept_bytes = accelerating, window, kept_bytes
        self.n = parts[0].campaign.robot.n
        self.T = np.asarray(parts[0].campaign.robot.transmission)
        found = {part.session: torque_kernel(part.campaign, chain) for part in parts}
        self.kernels: dict[int, TorqueKernel] = {s: k for s, k in found.items() if k is not None}
        self.linear = len(self.kernels) == len(found)
        self._kept: list[Block] | None = None

    @property
    def offset_keys(self) -> Integers:
        """``(K, 2)``: run and joint of the coupled joints that stand still for a whole run."""
        keys = [(r, j) for j in self.wrist for r in range(len(self.facts.moved)) if not self.facts.moved[r, j]]
        return np.array(keys, dtype=np.int64).reshape(-1, 2)

    @property
    def parameters(self) -> int:
        """P + K: slots, and frictions of joints that stand still for a whole run."""
        return len(self.chain.slots) + len(self.offset_keys)

    def forget(self) -> None:
        """Drop what was kept between passes."""
        self._kept = None

    def __iter__(self) -> Iterator[Block]:
        if self._kept is not None:
            yield from self._kept
            return
        kept: list[Block] | None = []
        size = 0
        for block in self._blocks():
            size += sum(c.both.nbytes + 5 * c.row.nbytes for c in block.channels)
            if size > self.kept_bytes:
                kept = None
            elif kept is not None:
                kept.append(block)
            yield block
        self._kept = kept

    def _blocks(self) -> Iterator[Block]:
        read = {name for kernel in self.kernels.values() for name, _ in kernel.signals}
        kinds = [("q", "rad"), ("tau", "Nm"), *([("qd", "rad_s")] if self.facts.speeds_logged else [])]
        names = ["run", "time_s", *(c for kind, unit in kinds for c in joint_columns(kind, unit, self.n))]
        before = 0
        for p, part in enumerate(self.parts):
            warm = [c for c in part.table.names if c.startswith("temp_")]
            chosen = names + (warm if any(name.endswith("_temperature") for name in read) else [])
            held: _Held | None = None
            for w in windows(part.table, chosen, self.window, self.facts.halo):
                block, held = self._block(w, p, before, held)
                yield block
            before += part.table.rows

    def _block(self, w: Window, p: int, before: int, held: _Held | None) -> tuple[Block, _Held | None]:
        part, facts = self.parts[p], self.facts
        kernel = self.kernels[part.session]
        q, qd, qdd = motion_of(w, self.n, facts.step, facts.speeds_logged)
        time, number = w.columns["time_s"], w.columns["run"].astype(np.int64)
        first_run = int(np.searchsorted(facts.runs[:, 0], p))
        run = first_run + np.searchsorted(facts.runs[facts.runs[:, 0] == p, 1], number)
        wm = qd @ np.linalg.inv(self.T)
        joint, motor = held_sign(qd, facts.rest, run), held_sign(wm, facts.rest_motor, run)
        if held is not None:
            for signs, old in ((joint, held.joint), (motor, held.motor)):
                signs[:] = np.where((signs == 0) & (run == held.run)[:, None], old, signs)
        at = w.stop - facts.halo - 1  # the row before the next window's first
        held = _Held(int(run[at]), joint[at].copy(), motor[at].copy()) if at >= 0 else None
        measured = stacked(w, joint_columns("tau", "Nm", self.n))
        counts = np.abs(wm) > np.maximum(facts.rest_motor, facts.clear_motor)
        counts &= ~self._undecided(qd, joint, run)
        if not self.accelerating:
            counts &= np.abs(qdd) <= facts.steady
        # Rows before the window's own are needed as far as the noise remembers.
        counts[: max(w.start - REACH, 0)] = False
        counts[w.stop :] = False
        chosen = np.flatnonzero(counts.any(axis=1))
        every = {
            "q": q,
            "motor": q @ np.linalg.inv(self.T),
            "joint_speed": qd,
            "motor_speed": wm,
            "joint_motion": joint,
            "motor_motion": motor,
            "own_speed": qd / np.diag(self.T),
            "own_motion": joint * np.sign(np.diag(self.T)),
            "joint_acceleration": qdd,
            "elapsed": time - facts.since,
            "rest_direction": np.zeros_like(q),
        }
        if any(name.endswith("_temperature") for name, _ in kernel.signals):
            every |= temperatures(pd.DataFrame(dict(w.columns)), self.n)
        if any(name == "torque_rate" for name, _ in kernel.signals):
            every["torque_rate"] = np.gradient(measured, axis=0)
        predicted, inertial, design = kernel.evaluate({name: every[name][chosen] for name, _ in kernel.signals})
        counts = counts[chosen]
        if not self.accelerating:
            counts &= np.abs(inertial) <= INERTIA_SHARE * facts.noise
        breaks = np.r_[True, (run[1:] != run[:-1]) | (np.abs(np.diff(time) - facts.step) > 0.5 * facts.step)]
        stretch = np.cumsum(breaks)
        row = before + w.first + np.arange(len(q))
        fold = run if len(facts.runs) > 1 else (row * FIFTHS // facts.rows).astype(np.int64)
        own = before + w.first + w.start
        torque = measured[chosen] - predicted
        channels = []
        for c in range(self.n):
            used = np.flatnonzero(counts[:, c])
            at_row = chosen[used]
            columns, extra = self._still(run[at_row], c)
            width = design[c].shape[1]
            both = np.empty((len(used), width + len(columns) + 1))
            both[:, :width], both[:, width:-1], both[:, -1] = design[c][used], extra, torque[used, c]
            channels.append(
                Channel(
                    row=row[at_row],
                    own=int(np.count_nonzero(row[at_row] < own)),
                    stretch=stretch[at_row],
                    fold=fold[at_row],
                    columns=np.r_[kernel.touched[c], columns],
                    both=both,
                )
            )
        mine = slice(w.start, w.stop)
        return Block(own, own + w.stop - w.start, run[mine], fold[mine], tuple(channels)), held

    def _undecided(self, qd: Array, motion: Array, run: Integers) -> Bools:
        """Motors ``(w, n)`` that a coupled joint keeps open: it creeps, or has not moved yet in this run."""
        facts, out = self.facts, np.zeros(qd.shape, dtype=bool)
        for j in self.wrist:
            speed = np.abs(qd[:, j])
            slow = (speed > facts.rest[j]) & (speed <= facts.clear[j])
            out[:, j] = facts.moved[run, j] & (slow | (motion[:, j] == 0))
        return np.asarray((out.astype(float) @ (self.T != 0).T.astype(float)) > 0)

    def _still(self, run: Integers, motor: int) -> tuple[Integers, Array]:
        """The friction of joints that stand still in these rows' runs: which parameters, and their columns."""
        columns, values = [], []
        keys = self.offset_keys
        for k in np.flatnonzero(np.isin(keys[:, 0], run)) if len(run) else ():
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
