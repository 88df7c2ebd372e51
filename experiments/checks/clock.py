"""Judges the clocks of logs: samples that are missing or repeated, steps that are irregular, clocks that jump."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from experiments.campaign import Campaign
from experiments.checks.finding import Finding
from experiments.columns import joint_columns
from experiments.signals import gaps, irregularity, stale_rows

__all__ = ["clock_findings", "counts_rows"]

# Coarsely rounded positions repeat by chance, once in ten thousand rows; a source slower than the log
# holds a fifth of its rows or more.
SHARE_OF_REPEATS = 0.01
# Speeds are taken on the stamps as they are, so that irregular steps do no harm by themselves. Where the stamps are
# wrong by this share of a step, so are speeds over five samples.
IRREGULAR = 0.05


def clock_findings(campaign: Campaign) -> Iterator[Finding]:
    """Look at the clocks of free air and wrist, and whether poses have one.

    A step counts as a gap or a jump when it is half a usual step off and beyond six times the jitter (normal jitter
    does that once in 5e8 steps); stamps that are only rounded count as even.

    Parameters
    ----------
    campaign
        The campaign.

    Yields
    ------
    Finding
        A note where times of poses only count rows. Warnings for missing and repeated samples and jumps, a note on
        irregular steps; each with count, first row and size.
    """
    for table in ("poses", "verification"):
        if table in campaign.tables and counts_rows(_numbers(campaign.tables[table], "time_s")):
            message = (
                "counts rows (0, 1, 2, …) and is no clock: drift and warming up can only be examined in the order of "
                "the rows"
            )
            yield Finding("note", table, "time_s", None, message)
    for table in ("free_air", "wrist"):
        if table in campaign.tables:
            frame, n = campaign.tables[table], campaign.robot.n
            yield from _gaps(table, frame, n)
            yield from _repeats(table, frame, n)
            share = irregularity(_numbers(frame, "time_s"), frame["run"].to_numpy(dtype=np.int64))
            if share > IRREGULAR:
                message = (
                    f"time steps vary by {share:.0%} (one standard deviation) of the usual step: speeds are taken on "
                    "the stamps as they are"
                )
                yield Finding("note", table, "time_s", None, message)


def counts_rows(time: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> bool:
    """Whether times ``(N,)`` are the numbers of their rows."""
    return len(time) > 2 and bool(np.all(np.diff(time) == 1.0))


def _numbers(frame: pd.DataFrame, *names: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return frame[names[0] if len(names) == 1 else list(names)].to_numpy(dtype=np.float64)


def _gaps(table: str, frame: pd.DataFrame, n: int) -> Iterator[Finding]:
    q, time = _numbers(frame, *joint_columns("q{}_rad", n)), _numbers(frame, "time_s")
    found = gaps(q, time, frame["run"].to_numpy(dtype=np.int64))
    dropped = [gap for gap in found if gap.kind == "dropped"]
    if dropped:
        worst = max(dropped, key=lambda gap: gap.seconds)
        message = (
            f"{sum(gap.missing for gap in dropped)} samples are missing in {len(dropped)} places, first before row "
            f"{dropped[0].row + 1} ({dropped[0].seconds:.4g} s where steps are {dropped[0].step:.4g} s); the longest "
            f"gap, before row {worst.row + 1}, is {worst.seconds:.4g} s"
        )
        yield Finding("warning", table, "time_s", dropped[0].row + 1, message)
    jumps = [gap for gap in found if gap.kind == "jump"]
    if jumps:
        worst = max(jumps, key=lambda gap: abs(gap.seconds - gap.step))
        message = (
            f"the clock jumps in {len(jumps)} places, first before row {jumps[0].row + 1} (by "
            f"{jumps[0].seconds - jumps[0].step:+.4g} s besides the step of {jumps[0].step:.4g} s; positions moved as "
            f"in one step), farthest before row {worst.row + 1} (by {worst.seconds - worst.step:+.4g} s)"
        )
        yield Finding("warning", table, "time_s", jumps[0].row + 1, message)


def _repeats(table: str, frame: pd.DataFrame, n: int) -> Iterator[Finding]:
    q, tau = (_numbers(frame, *joint_columns(p, n)) for p in ("q{}_rad", "tau{}_Nm"))
    stale = stale_rows(q, frame["run"].to_numpy(dtype=np.int64))
    whole = stale & np.r_[False, np.all(np.diff(tau, axis=0) == 0.0, axis=1)]
    if whole.any():
        row = int(np.flatnonzero(whole)[0]) + 1
        count = np.count_nonzero(whole)
        message = (
            f"{count} {'row repeats' if count == 1 else 'rows repeat'} positions and torques of the row before while "
            f"the robot moves, first row {row}: samples were lost, and the last one written again"
        )
        yield Finding("warning", table, "q1_rad", row, message)
        return
    moving = np.any(np.diff(q, axis=0) != 0.0, axis=1)
    if stale.sum() > SHARE_OF_REPEATS * np.count_nonzero(moving) and stale.sum() > 1:
        row = int(np.flatnonzero(stale)[0]) + 1
        message = (
            f"{np.count_nonzero(stale)} rows repeat the positions of the row before while the robot moves and torques "
            f"go on, first row {row}: the positions' source is slower than the log, or lost samples"
        )
        yield Finding("warning", table, "q1_rad", row, message)
