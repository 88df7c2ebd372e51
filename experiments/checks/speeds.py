"""Judges whether torque logs have the speeds and directions that separate the parts of friction."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from experiments.campaign import Campaign
from experiments.checks.finding import Finding
from experiments.checks.motion import STILL_RAD, moved_joints
from experiments.columns import joint_columns
from experiments.signals import rest_threshold, speeds
from experiments.signals.typing_ import Array

__all__ = ["speed_findings"]

TABLES = ("free_air", "wrist")
# Share of the top speed from which a row counts as moving: what fits of friction use.
CLEAR_SPEED = 0.02
# Dry friction is friction extrapolated to speed zero. From speeds that scatter by the share c of their mean, its
# standard error is sqrt(1 + 1/c²) times that of the friction at the mean speed (a straight line, extrapolated): twenty
# times at 5 %. Full and 80 % speed make 11 %.
SCATTER = 0.05
# What a standard deviation covers to both sides. Ramps, in which friction builds up and inertia acts, do not count as
# speeds while they take less than the rest.
ONE_SIGMA = 0.683
ROWS = 10


def speed_findings(campaign: Campaign, angles_wrong: frozenset[str]) -> Iterator[Finding]:
    """Look at directions and speeds of each joint, in free air and wrist together.

    Parameters
    ----------
    campaign
        The campaign.
    angles_wrong
        Tables whose angles are known to be in another unit.

    Yields
    ------
    Finding
        Warnings for joints that never reverse, or have one speed only.
    """
    sizes: dict[int, list[Array]] = {}
    travel: dict[int, Array] = {}
    first: dict[int, str] = {}
    for table in TABLES:
        if table not in campaign.tables or table in angles_wrong:
            continue
        moved = moved_joints(campaign, table)
        for i, (there, back, size) in zip(moved, _motion(campaign, table, moved), strict=True):
            first.setdefault(i, table)
            travel[i] = travel.get(i, np.zeros(2)) + np.array([there, back])
            sizes.setdefault(i, []).append(size)
    for i, table in sorted(first.items()):
        there, back = travel[i]
        if min(there, back) < STILL_RAD <= max(there, back):
            message = (
                f"joint {i + 1} never reverses ({there:.3g} rad forwards, {back:.2g} rad back): its dry friction and "
                "its torque's offset are not separable"
            )
            yield Finding("warning", table, f"q{i + 1}_rad", None, message)
        middle, scatter = _usual(np.concatenate(sizes[i]))
        if scatter < SCATTER * middle:
            message = (
                f"joint {i + 1} moves at one speed only ({middle:.3g} rad/s, scatter {scatter / middle:.1%}): its "
                "Coulomb and viscous friction are not separable"
            )
            yield Finding("warning", table, f"q{i + 1}_rad", None, message)


def _usual(sizes: Array) -> tuple[float, float]:
    """Middle and half-width of the shortest interval with 68 % of speeds ``(N,)``: of normal ones mean and sigma."""
    if len(sizes) < ROWS:
        return 0.0, 0.0
    ordered = np.sort(sizes)
    inside = int(np.ceil(ONE_SIGMA * len(ordered)))
    width = ordered[inside - 1 :] - ordered[: len(ordered) - inside + 1]
    k = int(np.argmin(width))
    return float(ordered[k] + 0.5 * width[k]), float(0.5 * width[k])


def _motion(campaign: Campaign, table: str, moved: list[int]) -> Iterator[tuple[float, float, Array]]:
    """Per moved joint: travel forwards and back [rad] in clear motion, and the sizes of its speeds there [rad/s]."""
    frame, n = campaign.tables[table], campaign.robot.n
    time, run = frame["time_s"].to_numpy(dtype=np.float64), frame["run"].to_numpy(dtype=np.int64)
    q = frame[list(joint_columns("q{}_rad", n))].to_numpy(dtype=np.float64)[:, moved]
    stated = list(joint_columns("qd{}_rad_s", n))
    qd = frame[stated].to_numpy(dtype=np.float64)[:, moved] if stated[0] in frame else speeds(q, time, run)
    if len(q) == 0 or not moved:
        return
    clear = np.abs(qd) > np.maximum(rest_threshold(qd), CLEAR_SPEED * np.abs(qd).max(axis=0))
    change = np.r_[np.zeros((1, len(moved))), np.where((run[1:] == run[:-1])[:, None], np.diff(q, axis=0), 0.0)]
    change = np.where(clear, change, 0.0)
    for k in range(len(moved)):
        there, back = change[change[:, k] > 0.0, k].sum(), -change[change[:, k] < 0.0, k].sum()
        yield float(there), float(back), np.abs(qd[clear[:, k], k])
