"""Repeatability along one line, from repeated measurements of one distance at several places.

At a place, distances come from one side (+) or from the other (-). With s the scatter about the mean of a place and a
side, pooled over places, and B the difference of a place's two means,

    one side:    R = 4 s
    both sides:  R = max over places of (2 s+ + 2 s- + |B|)

as ISO 230-2:2014 (3.13 to 3.17) has it for one axis of a machine. Sides are those of the joint that turns most along
the line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

__all__ = ["LineRepeatability", "line_repeatability"]


@dataclass(frozen=True)
class LineRepeatability:
    """Of a table of distances.

    Attributes
    ----------
    one_side
        m, from the pooled scatter.
    both_sides
        m, the largest of the places; None: no place was come to twice from both sides.
    reversal
        m, the largest difference between the sides' means; None likewise.
    places, freedom
        How many places came twice or more from one side, and the degrees of freedom of the scatter.
    """

    one_side: float
    both_sides: float | None
    reversal: float | None
    places: int
    freedom: int


def line_repeatability(frame: pd.DataFrame) -> LineRepeatability | None:
    """Of the table ``distances``; None where no place was measured twice from one side.

    Several targets or anchors at one pose are places of their own.
    """
    sides = frame[[name for name in frame if str(name).startswith("dir")]].to_numpy()
    both = [k for k in range(sides.shape[1]) if len(np.unique(sides[:, k])) > 1]
    angles = frame[[name for name in frame if str(name).startswith("q")]].to_numpy(dtype=np.float64)
    side = sides[:, max(both, key=lambda k: float(np.ptp(angles[:, k])))] if both else np.ones(len(frame))
    squares, freedom, places, widths, reversals = 0.0, 0, 0, [], []
    for _, rows in frame.assign(_side=side).groupby(["anchor", "target", "pose"], sort=True):
        parts = [part["distance_m"].to_numpy(dtype=np.float64) for _, part in rows.groupby("_side", sort=True)]
        parts = [part for part in parts if len(part) > 1]
        squares += sum(float(np.sum((part - part.mean()) ** 2)) for part in parts)
        freedom += sum(len(part) - 1 for part in parts)
        places += bool(parts)
        if len(parts) == 2:
            reversals.append(abs(float(parts[0].mean() - parts[1].mean())))
            widths.append(2.0 * sum(float(part.std(ddof=1)) for part in parts) + reversals[-1])
    if not freedom:
        return None
    width, reversal = (max(widths), max(reversals)) if widths else (None, None)
    return LineRepeatability(4.0 * float(np.sqrt(squares / freedom)), width, reversal, places, freedom)
