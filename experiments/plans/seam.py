"""The interface of a plan's runner to what executes the plan: a controller behind a link, or the virtual robot."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

import pandas as pd

from experiments.plans.motion import Array, Course

__all__ = ["RobotSeam"]


class RobotSeam(Protocol):
    """A robot with its instruments, as the runner needs them; all angles are those that the controller reports.

    Tables come with the columns of the campaign format but those that number runs, sweeps, poses and visits. ``time_s``
    is the peer's own clock, which must not run backwards within a session.
    """

    def declared(self) -> Mapping[str, Any]:
        """The cell in the keys of ``campaign.toml``; empty if only the plan states it."""

    def log(self, course: Course, rate: float) -> pd.DataFrame:
        """Go to the course's start, follow it, and give the log, ``rate`` Hz: a table like ``free_air``."""

    def clamp(self, posture: Array) -> None:
        """Go to a posture ``(n,)``, rad, and have the flange clamped there; returns when it is."""

    def press(self, joint: int, offset: Array, dwell: float) -> Iterator[Mapping[str, float]]:
        """Command one joint (from 0) by ``offset`` ``(m,)``, rad, beyond the clamped posture, and read after each step.

        A step is taken only when its reading is asked for, so that a runner that stops asking stops the robot.
        """

    def release(self) -> None:
        """Unwind the drives to the clamped posture and have the clamp opened."""

    def visit(self, course: Course, targets: Sequence[str], measure_time: float) -> pd.DataFrame:
        """Follow a course and measure at its end: a table like ``poses``, a row for each target."""
