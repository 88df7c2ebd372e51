"""Facts of a whole torque log that are needed before any of its rows can be used: steps, noise, thresholds, runs.

Two passes over the log; the result is a few numbers and a line per run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from weakref import WeakKeyDictionary

import numpy as np

from clampid.stages import prewhitening
from clampid.stages.known_noise import upper_ends
from clampid.stages.log_motion import Motions, joint_columns, stacked
from clampid.stages.motion_choice import (
    Excerpt,
    Regression,
    Way,
    chosen_rows,
    chosen_way,
    trusted_rows,
    ways,
)
from clampid.stages.repeats import repeated_noise
from clampid.stages.rows import Array, Bools, Integers
from experiments.campaign import Campaign
from experiments.columns import LOGS
from experiments.log_windows import LogTable, Window, windows
from experiments.signals import medians, smallest_half, speed_counts, threshold_of_counts
from experiments.temperatures import filled

__all__ = ["LogFacts", "LogPart", "facts_of", "log_parts"]

WINDOW = 1 << 15  # rows at once: half as many cost a fifth more time
NEIGHBOURS_READ = 4  # neighbours that are read on either side, in halves of the differentiating window
NEIGHBOURS = 16  # at least
WINDOW_S = 0.02  # the shortest over which speeds and accelerations are taken
TOGETHER_S = 0.01  # rows within it are one number to the noise
CHOICE_EVERY, CHOICE_ROWS = 50 * WINDOW, 2 * WINDOW  # of a long log: by which it is chosen how its motion is taken
CLEAR_MOTION = 0.02  # of the top speed of the log
STEADY = 0.15  # of the log's largest acceleration of a joint
NORMAL = 1.4826  # median absolute deviation to standard deviation of a normal


@dataclass(frozen=True, eq=False)
class LogPart:
    """One table of one session: the campaign that says what it is of, and its rows."""

    campaign: Campaign
    session: int
    name: str
    table: LogTable


def log_parts(campaigns: Sequence[Campaign]) -> list[LogPart]:
    """The tables free_air and wrist of campaigns, in order; gaps of temperatures are filled, and all are smoothed."""
    out = []
    for s, campaign in enumerate(campaigns):
        logs = {name: campaign.placed(name) for name in LOGS if name in campaign.tables}
        for name, table in logs.items():
            others = [other for key, other in logs.items() if key != name]
            whole = campaign.long[name].table if name in campaign.long else LogTable.of(filled(table, others))
            out.append(LogPart(campaign, s, name, whole.steadied()))
    return out


@dataclass(frozen=True, eq=False)
class LogFacts:
    """Facts of the log.

    Attributes
    ----------
    step, spacing
        The usual time step, within runs and between any rows that follow each other, s.
    noise
        ``(n,)``: of the torques, between neighbouring rows, Nm.
    regression
        ``(n,)``: held-out error of a regression on rigid-body dynamics and friction, rms in Nm, plus two standard
        errors; infinite where the log is too short for one. It is independent of the model under test
        (:func:`clampid.stages.motion_choice.Regression`).
    repeated
        ``(n,)``, Nm: the same of runs that repeat a motion (:func:`clampid.stages.repeats.repeated_noise`); infinite
        where none does, or where the log is too long to be held in memory.
    motions
        How its rows move.
    rest, rest_motor, clear, clear_motor
        ``(n,)``, rad/s: speeds of rest and of clear motion, of joints and of motors.
    steady
        ``(n,)``, rad/s²: accelerations up to which motion counts as steady.
    since
        The first stamp, s.
    rows
        Number of rows of all parts.
    runs
        ``(R, 2)``: part and number of each run, in order.
    length
        ``(R,)``: rows of each.
    moved
        ``(R, n)``: whether the joint moves in that run.
    """

    step: float
    spacing: float
    noise: Array
    regression: Array
    repeated: Array
    motions: Motions
    rest: Array
    rest_motor: Array
    clear: Array
    clear_motor: Array
    steady: Array
    since: float
    rows: int
    runs: Integers
    length: Integers
    moved: Bools

    @property
    def known_noise(self) -> Array:
        """The smaller of the two figures that no model has shaped ``(n,)``, Nm."""
        return np.minimum(self.regression, self.repeated)

    @property
    def halo(self) -> int:
        """How many neighbours a window needs on either side."""
        return halo_of(self.step, self.motions.way.window_s)

    @property
    def together(self) -> int:
        """How many rows that follow each other are one number to the noise."""
        return together_of(self.step)


_KNOWN: WeakKeyDictionary[Campaign, dict[tuple[tuple[str, ...], int, int], LogFacts]] = WeakKeyDictionary()
"""Facts of campaigns' logs: a command asks for them several times, and tables are not changed once they are read."""


def halo_of(step: float, window_s: float = WINDOW_S) -> int:
    """Rows on either side of a window that it needs: for the noise's correlation, and for speeds and accelerations."""
    return prewhitening.LONGEST_LAG * together_of(step) + max(NEIGHBOURS, NEIGHBOURS_READ * round(window_s / step))


def together_of(step: float) -> int:
    """How many neighbouring rows are averaged as one number for the noise; faster changes are the drives' vibration."""
    return max(1, round(TOGETHER_S / step))


def facts_of(
    parts: Sequence[LogPart],
    window: int = WINDOW,
    in_memory: int = 1 << 22,
) -> LogFacts:
    """Find the facts of a log.

    Parameters
    ----------
    parts
        Its tables, in order.
    window
        Rows read at once.
    in_memory
        How many numbers may be held for a median; see `experiments.signals.medians`.
    """
    one = parts[0].campaign if len({part.session for part in parts}) == 1 else None
    key = tuple(part.name for part in parts), window, in_memory
    if one is not None and key in _KNOWN.get(one, {}):
        return _KNOWN[one][key]
    facts = _facts_of(parts, window, in_memory)
    if one is not None:
        _KNOWN.setdefault(one, {})[key] = facts
    return facts


def _facts_of(parts: Sequence[LogPart], window: int, in_memory: int) -> LogFacts:
    n = parts[0].campaign.robot.n
    middle = medians(lambda: _differences(parts, n), in_memory)
    step = float(middle[0]) if np.isfinite(middle[0]) else 1.0
    names_qd = joint_columns("qd", "rad_s", n)
    logged = all(set(names_qd) <= set(p.table.names) for p in parts) and not _missing(parts, names_qd)
    motions, left_out = _motions_of(parts, step, Way(logged, WINDOW_S), window)
    to_motor = np.linalg.inv(np.asarray(parts[0].campaign.robot.transmission))
    counts = [speed_counts(np.zeros((0, n))) for _ in range(2)]
    top = np.zeros((3, n))
    since, rows = np.inf, 0
    found: dict[tuple[int, int], tuple[int, Array]] = {}
    for p, part in enumerate(parts):
        for w in windows(part.table, motions.columns, window, halo_of(step, motions.way.window_s)):
            own = slice(w.start, w.stop)
            _, qd, qdd, _ = motions.of(p, w).of(own)
            wm = qd @ to_motor
            for kind, v in enumerate((qd, wm)):
                counts[kind] += speed_counts(v)
            top = np.maximum(top, [np.abs(v).max(axis=0) for v in (qd, wm, qdd)])
            since, rows = min(since, float(w.columns["time_s"][own].min())), rows + len(qd)
            run = w.columns["run"][own].astype(np.int64)
            first = np.flatnonzero(np.r_[True, run[1:] != run[:-1]])
            fastest = np.maximum.reduceat(np.abs(qd), first, axis=0)
            for k, length, speed in zip(run[first], np.diff(np.r_[first, len(run)]), fastest, strict=True):
                before, size = found.get((p, int(k)), (0, np.zeros(n)))
                found[p, int(k)] = before + int(length), np.maximum(size, speed)
    keys = sorted(found)
    rest, rest_motor = threshold_of_counts(counts[0], top[0]), threshold_of_counts(counts[1], top[1])
    return LogFacts(
        step=step,
        spacing=float(middle[1]) if np.isfinite(middle[1]) else 0.0,
        noise=NORMAL * middle[2:] / np.sqrt(2.0),
        regression=upper_ends(left_out),
        repeated=_repeated(parts, n) if rows * (2 * n + 2) <= in_memory else np.full(n, np.inf),
        motions=motions,
        rest=rest,
        rest_motor=rest_motor,
        clear=CLEAR_MOTION * top[0],
        clear_motor=CLEAR_MOTION * top[1],
        steady=STEADY * top[2],
        since=float(since),
        rows=rows,
        runs=np.array(keys, dtype=np.int64).reshape(-1, 2),
        length=np.array([found[k][0] for k in keys], dtype=np.int64),
        moved=np.array([found[k][1] > rest for k in keys]).reshape(-1, n),
    )


def _motions_of(parts: Sequence[LogPart], step: float, default: Way, window: int) -> tuple[Motions, Array]:
    """The motion of the log by the choice of least torque error, and its mean squares ``(n, blocks)``, Nm²."""
    n = parts[0].campaign.robot.n
    candidates = ways(default, step, 2 * smallest_half())
    rows = sum(part.table.rows for part in parts)
    longest = max([default.window_s, *(way.window_s for source in candidates for way in source)])
    columns = list(dict.fromkeys([*Motions(n, step, default).columns, *joint_columns("tau", "Nm", n)]))
    read = [
        (part.campaign, before, w)
        for part, before in zip(parts, _rows_before(parts), strict=True)
        for w in _some_windows(part.table, columns, window, halo_of(step, longest))
    ]
    torques = joint_columns("tau", "Nm", n)
    if not any(stacked(w, torques).any() for _, _, w in read):  # a plan: no way predicts what was not measured better
        return Motions(n, step, default), np.full((n, 2), np.nan)
    to_motor = np.linalg.inv(np.asarray(parts[0].campaign.robot.transmission))
    speed = [np.abs(_smoothest(w, n, step, longest)[w.start : w.stop] @ to_motor) for _, _, w in read]
    slow = CLEAR_MOTION * np.max([v.max(axis=0) for v in speed], axis=0)

    @lru_cache(maxsize=2)  # the last two are needed again, and of a long log each is large
    def score(way: Way) -> Regression:
        motions = Motions(n, step, way)
        excerpts = []
        for (campaign, before, w), fast in zip(read, speed, strict=True):
            own = np.zeros(len(w.columns["time_s"]), dtype=bool)
            own[w.start : w.stop] = chosen_rows(before + w.first + np.arange(w.start, w.stop), rows)
            motion, misfit = motions.with_misfit(w, own)
            torque, moving = stacked(w, torques)[own], (fast > slow)[own[w.start : w.stop]]
            number = before + w.first + np.flatnonzero(own)
            excerpts.append(Excerpt(campaign, motion.of(own), torque, moving, number, misfit[own]))
        return Regression(excerpts, rows)

    way, left_out = chosen_way(default, candidates, lambda way: score(way).squares())
    if 2 * smallest_half() * step > WINDOW_S:  # a sparse log: five samples do not fit into the shortest window
        way, left_out = chosen_way(way, [[replace(way, in_moves=True)]], lambda way: score(way).squares())
    direct = replace(way, direct=not way.logged and way.window_s <= 2 * smallest_half() * step)
    trusted, left_out = trusted_rows(score(way), score(direct), left_out)
    return Motions(n, step, replace(direct, trusted=trusted) if trusted else way), left_out


def _repeated(parts: Sequence[LogPart], n: int) -> Array:
    """The noise ``(n,)``, Nm, that runs of one motion show, of all tables."""
    positions, torques = joint_columns("q", "rad", n), joint_columns("tau", "Nm", n)
    read = [part.table.frame(["run", "time_s", *positions, *torques]).assign(part=p) for p, part in enumerate(parts)]
    every = [table[[*positions, *torques]].to_numpy(float) for table in read]
    _, run = np.unique(np.concatenate([t[["part", "run"]].to_numpy() for t in read]), axis=0, return_inverse=True)
    time, both = np.concatenate([t["time_s"].to_numpy(float) for t in read]), np.concatenate(every)
    return repeated_noise(run.astype(np.int64), time, both[:, :n], both[:, n:])


def _smoothest(w: Window, n: int, step: float, window_s: float) -> Array:
    """Speeds ``(w, n)`` over a long window, rad/s: differences across it, which separate motion from rest."""
    q, half = stacked(w, joint_columns("q", "rad", n)), max(1, round(0.5 * window_s / step))
    ahead, behind = np.minimum(np.arange(len(q)) + half, len(q) - 1), np.maximum(np.arange(len(q)) - half, 0)
    same = w.columns["run"][ahead] == w.columns["run"][behind]
    return np.asarray(np.where(same[:, None], q[ahead] - q[behind], 0.0) / (2.0 * half * step))


def _rows_before(parts: Sequence[LogPart]) -> list[int]:
    """How many rows of the log the parts before each have."""
    return [sum(part.table.rows for part in parts[:p]) for p in range(len(parts))]


def _some_windows(table: LogTable, columns: Sequence[str], window: int, halo: int) -> Iterator[Window]:
    """The windows of a short table; of a long one those that begin in the first rows of every stretch."""
    for w in windows(table, columns, window, halo):
        if (w.first + w.start) % CHOICE_EVERY < CHOICE_ROWS:
            yield w


def _missing(parts: Sequence[LogPart], names: Sequence[str]) -> bool:
    return any(np.isnan(v).any() for p in parts for chunk in p.table.chunks(names) for v in chunk.values())


def _differences(parts: Sequence[LogPart], n: int) -> Iterator[list[Array]]:
    """Time steps within runs and between all rows, s, and what torques change by, Nm, of rows in order."""
    torques = joint_columns("tau", "Nm", n)
    last: list[Array] = []
    for p, part in enumerate(parts):
        for chunk in part.table.chunks(["run", "time_s", *torques]):
            now = [chunk["run"] + 0.0, np.full(len(chunk["run"]), float(p)), chunk["time_s"]]
            now += [chunk[name] for name in torques]
            both = [np.r_[a, b] for a, b in zip(last, now, strict=True)] if last else now
            run, table, time = both[:3]
            steps = np.diff(time)
            within = (run[1:] == run[:-1]) & (table[1:] == table[:-1]) & (steps > 0.0)
            yield [steps[within], steps, *(np.abs(np.diff(tau)) for tau in both[3:])]
            last = [v[-1:] for v in now]
