"""Signals of a log, computed without a model: speeds, states of motion, contiguous stretches, faults of its clock.

Nothing here knows of effects or of a robot.
"""

from experiments.signals.clock import Gap, gaps, irregularity, segments, stale_rows, typical_step
from experiments.signals.definite import solve_definite
from experiments.signals.derivatives import acceleration, accelerations, differentiate, low_pass, speeds
from experiments.signals.misfit import misfit
from experiments.signals.motion import carried_sign, rest_threshold, speed_counts, threshold_of_counts
from experiments.signals.moves import MoveMotion, motion_of_moves
from experiments.signals.polynomial import smallest_half
from experiments.signals.selection import medians
from experiments.signals.shift import Shift, combine_shifts, time_shift
from experiments.signals.slip import slip_states
from experiments.signals.window import choose_window

__all__ = [
    "Gap",
    "MoveMotion",
    "Shift",
    "acceleration",
    "accelerations",
    "carried_sign",
    "choose_window",
    "combine_shifts",
    "differentiate",
    "gaps",
    "irregularity",
    "low_pass",
    "medians",
    "misfit",
    "motion_of_moves",
    "rest_threshold",
    "segments",
    "slip_states",
    "smallest_half",
    "solve_definite",
    "speed_counts",
    "speeds",
    "stale_rows",
    "threshold_of_counts",
    "time_shift",
    "typical_step",
]
