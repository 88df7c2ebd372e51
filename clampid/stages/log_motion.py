"""Positions, speeds and accelerations of a torque log, window by window, and which rows show them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from clampid.stages.motion_choice import Way
from clampid.stages.rows import Array, Bools, Integers
from experiments.log_windows import Window
from experiments.signals import MoveMotion, differentiate, misfit, motion_of_moves, speeds, stale_rows

__all__ = ["Motion", "Motions", "joint_columns", "stacked"]

KEPT_BYTES = 1 << 26  # of a short log the motion of all windows is kept


def joint_columns(kind: str, unit: str, n: int) -> list[str]:
    """Names of n numbered columns, such as ``q1_rad``."""
    return [f"{kind}{i + 1}_{unit}" for i in range(n)]


def stacked(window: Window, names: Sequence[str]) -> Array:
    """Columns of a window beside each other ``(w, c)``; in memory one after the other, as filters go through them."""
    return np.array([window.columns[name] for name in names]).T


class Motion(NamedTuple):
    """Positions, speeds and accelerations ``(w, n)`` of a window, rad, rad/s, rad/s²; which rows show them ``(w,)``."""

    position: Array
    speed: Array
    acceleration: Array
    resolved: Bools

    def of(self, rows: Bools | Integers | slice) -> Motion:
        """Some of the rows."""
        return Motion(self.position[rows], self.speed[rows], self.acceleration[rows], self.resolved[rows])


class Motions:
    """The motion of a log's windows; kept where the log is short.

    Parameters
    ----------
    n
        Number of joints.
    step
        The usual time step, s.
    way
        From which columns, and over how long a window.
    """

    def __init__(self, n: int, step: float, way: Way) -> None:
        self.n, self.step, self.way = n, step, way
        self._kept: dict[tuple[int, int, int], Motion] = {}
        self._room = KEPT_BYTES

    @property
    def columns(self) -> list[str]:
        """The columns that a window has to have."""
        kinds = [("q", "rad"), ("qd", "rad_s")] if self.way.logged else [("q", "rad")]
        return ["run", "time_s", *(c for kind, unit in kinds for c in joint_columns(kind, unit, self.n))]

    def of(self, part: int, window: Window) -> Motion:
        """The motion of a window of one of the log's parts."""
        key = part, window.first, len(window.columns["time_s"])
        if key not in self._kept:
            found = self.at(window)
            size = sum(v.nbytes for v in found)
            if size > self._room:
                return found
            self._kept[key] = found
            self._room -= size
        return self._kept[key]

    def at(self, window: Window) -> Motion:
        """The motion of a window."""
        return self._motion(window, self._moves(window), None)

    def with_misfit(self, window: Window, wanted: Bools) -> tuple[Motion, Array]:
        """The motion of the ``wanted`` rows ``(w,)`` of a window, the others' accelerations zero, and its misfit.

        The misfit ``(w, n)``, rad/s², is by how far its samples are from the curves taken for them, as accelerations.
        """
        moves = self._moves(window)
        return self._motion(window, moves, wanted), self._misfit(window, moves)

    def _motion(self, window: Window, moves: MoveMotion | None, wanted: Bools | None) -> Motion:
        motion = self._of_neighbours(window, wanted)
        if moves is not None:
            motion = motion._replace(
                speed=np.where(moves.known, moves.speed, motion.speed),
                acceleration=np.where(moves.known, moves.acceleration, motion.acceleration),
            )
        if not self.way.trusted:
            return motion
        shown = self._misfit(window, moves) <= np.array(self.way.trusted)
        return motion._replace(resolved=np.all(shown, axis=1))

    def _misfit(self, window: Window, moves: MoveMotion | None) -> Array:
        kind, unit, order = ("qd", "rad_s", 1) if self.way.logged else ("q", "rad", 2)
        values, time = stacked(window, joint_columns(kind, unit, self.n)), window.columns["time_s"]
        run = window.columns["run"].astype(np.int64)
        found = misfit(values, time, run, order, self.way.window_s, self.step)
        return found if moves is None else np.where(moves.known, moves.error, found)

    def _moves(self, window: Window) -> MoveMotion | None:
        """The motion of a window's rows that belong to moves."""
        if not self.way.in_moves:
            return None
        q = stacked(window, joint_columns("q", "rad", self.n))
        return motion_of_moves(q, window.columns["time_s"], window.columns["run"].astype(np.int64))

    def _of_neighbours(self, window: Window, wanted: Bools | None) -> Motion:
        """The motion by differences of neighbouring rows, all of them resolved."""
        q, time = stacked(window, joint_columns("q", "rad", self.n)), window.columns["time_s"]
        run, length, all_rows = window.columns["run"].astype(np.int64), self.way.window_s, np.ones(len(q), dtype=bool)
        if not self.way.logged:
            qd = speeds(q, time, run, length, self.step)
            of, order = (q, 2) if self.way.direct else (qd, 1)
            return Motion(q, qd, differentiate(of, time, run, order, length, None, self.step, wanted), all_rows)
        qd = stacked(window, joint_columns("qd", "rad_s", self.n))
        stale = stale_rows(q, run) if self.way.smoothed else None
        acceleration = differentiate(qd, time, run, 1, length, stale, self.step, wanted)
        if self.way.smoothed:
            qd = differentiate(qd, time, run, 0, length, stale, self.step, wanted)
        return Motion(q, qd, acceleration, all_rows)
