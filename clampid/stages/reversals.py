"""How far each joint has come since it last turned back, from the order in which poses were visited.

Between two visits a joint goes straight from one angle to the other. If its recorded last motion has the other sign,
it went beyond the pose and came back: from how far is not recorded.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from clampid.stages.rows import Array
from experiments.campaign import Campaign
from experiments.columns import POSES

__all__ = ["UNKNOWN_WAY", "since_reversal"]

UNKNOWN_WAY = 100.0  # rad: way of a joint of which nothing is known, which is longer than any on which an error depends
STILL = 1e-6  # rad: a joint that moved by less between two visits did not move


def since_reversal(campaign: Campaign, table: str) -> tuple[Array, Array]:
    """Way since the last reversal, and whether the last motion was against the way to the pose, of a table's rows.

    Returns
    -------
    way
        ``(N, n)``, rad, :data:`UNKNOWN_WAY` where it is not known.
    turned_back
        ``(N, n)``: 1 where the joint's last motion was against the way from the visit before, else 0.
    """
    n = campaign.robot.n
    angles, sides = [f"q{i + 1}_rad" for i in range(n)], [f"dir{i + 1}" for i in range(n)]
    names = ["pose", "visit", "time_s", *angles, *sides]
    frame = pd.concat([campaign.tables[t][names].assign(table=t) for t in POSES if t in campaign.tables])
    key = ["table", "pose", "visit"]
    visits = frame.groupby(key, sort=False).mean().sort_values("time_s", kind="stable")
    way, back = _of_visits(visits[angles].to_numpy(float), np.sign(visits[sides].to_numpy(float)))
    of = visits.index.get_indexer(pd.MultiIndex.from_frame(campaign.tables[table].assign(table=table)[key]))
    return way[of], back[of]


def _of_visits(q: Array, side: Array) -> tuple[Array, Array]:
    """Of visits in the order of time: angles ``(V, n)``, rad, and the signs ``(V, n)`` of their last motions."""
    way, back = np.full(q.shape, UNKNOWN_WAY), np.zeros(q.shape)
    gone, towards = np.full(q.shape[1], UNKNOWN_WAY), side[0].copy()
    for k in range(1, len(q)):
        step = q[k] - q[k - 1]
        moved = np.abs(step) > STILL
        onwards = np.sign(step) == towards
        gone = np.where(moved, np.where(onwards, gone + np.abs(step), np.abs(step)), gone)
        towards = np.where(moved, np.sign(step), towards)
        turned = (side[k] != 0.0) & (side[k] != towards)
        back[k] = turned
        way[k] = np.where(turned, UNKNOWN_WAY, gone)
        gone, towards = np.where(turned, 0.0, gone), np.where(turned, side[k], towards)
    return way, back
