"""Share of a log that counts in a model without inertia; if it is small, the model needs the bodies' dynamics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clampid.stages.counting import counting, motion_signals, negligible
from clampid.stages.layout import layout_of
from clampid.stages.loads import inertia_torque
from clampid.stages.log_facts import WINDOW, LogPart, facts_of
from experiments.log_windows import windows

__all__ = ["steady_share"]

WEIGHED = 20_000
"""Rows of a table of which the bodies' inertia is computed; of a longer one every so many."""


def steady_share(parts: Sequence[LogPart], window: int = WINDOW) -> float:
    """How much of the motors' motion a log shows without inertia, 0 to 1; 1 for a session without logs.

    It is the smaller of two numbers: the share of the rows in motion that count without inertia, and how large the mean
    squared speed of these is beside that of all rows in motion. A log of several speeds may lose its fast runs, and
    what friction tells of speed, although nearly all of its rows, which are slow, count.

    A row that counts without inertia is hardly accelerated, and the inertia torque of the described bodies is small
    compared with the noise (:func:`clampid.stages.counting.negligible`).
    """
    if not parts:
        return 1.0
    steady, moving = np.zeros(2), np.zeros(2)
    facts = facts_of(parts, window)
    for p, part in enumerate(parts):
        robot, runs = part.campaign.robot, np.flatnonzero(facts.runs[:, 0] == p)
        T, wrist = np.asarray(robot.transmission), layout_of([part.campaign]).wrist
        every = max(1, part.table.rows // WEIGHED)
        last_run, moved = -1, np.zeros(robot.n, dtype=bool)
        for w in windows(part.table, facts.motions.columns, window, facts.halo):
            chosen = np.arange(w.start, w.stop)
            chosen = chosen[(w.first + chosen) % every == 0]
            run = runs[0] + np.searchsorted(facts.runs[runs, 1], w.columns["run"].astype(np.int64))
            motion = facts.motions.of(p, w)
            signals = motion_signals(motion, T, facts, run, w.columns["time_s"])
            still = signals["joint_motion"] == 0.0
            signals["joint_motion"][still & (run == last_run)[:, None] & moved] = 1.0  # moved in an earlier window
            shown = motion.resolved[:, None]
            moves, calm = (shown & counting(signals, T, facts, run, wrist, kind) for kind in (True, False))
            moves, calm = moves[chosen], calm[chosen]
            # In units of each motor's own speeds: no motor counts for more than another.
            fast = (signals["motor_speed"][chosen] / np.maximum(facts.clear_motor, 1e-300)) ** 2
            moving += moves.sum(), fast[moves].sum()
            some = np.flatnonzero(calm.any(axis=1))
            q, qd, qdd, _ = motion.of(chosen[some])
            counts = calm[some] & negligible(inertia_torque(part.campaign, q, qd, qdd) @ T.T, facts)
            steady += counts.sum(), fast[some][counts].sum()
            last_run = int(run[w.stop - 1])
            moved = np.any(signals["joint_motion"][: w.stop][run[: w.stop] == last_run] != 0.0, axis=0)
    if not np.all(moving > 0.0):
        return 1.0
    rows, squares = (steady / moving).tolist()
    return float(min(rows, squares / rows)) if rows else 0.0
