"""Repeated samples of one point become their median, with the scatter of a single one.

The median absolute deviation of few samples is biased low, because their median follows them.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from experiments.columns import POSITION, QUATERNION
from experiments.foreign.numbering import SAME_POSE_RAD
from experiments.tables import TableFile

__all__ = ["medians"]

ROBUST = 1.4826  # median absolute deviation to standard deviation of a normal
# By the number of samples, so that half of all normal points come out too large; from 4 million drawn points each.
SMALL_SAMPLE_FACTORS = np.array([1.0, 1.0, 1.414, 1.869, 1.488, 1.340, 1.264, 1.208, 1.178, 1.150])
LARGE_SAMPLE_OFFSET = 1.15  # beyond these n / (n - LARGE_SAMPLE_OFFSET), within 0.3 %
KEYS = ["pose", "visit", "target"]


def medians(
    frame: pd.DataFrame, source: TableFile, n: int
) -> tuple[pd.DataFrame, tuple[float, float, float], npt.NDArray[np.intp]]:
    """One row for all samples of a pose, visit and target.

    Parameters
    ----------
    frame
        Rows of ``poses`` or ``verification``; modified.
    source
        Words what is wrong in a row.
    n
        Number of joints.

    Returns
    -------
    table
        Medians, ``samples`` and ``scatter_x_m`` …; texts and directions of the first sample, its time the earliest.
    scatter
        Robust standard deviation of a single sample ``(3,)``, m, from all points that were sampled several times.
    first
        The first sample ``(rows,)`` of each row.

    Raises
    ------
    CampaignError
        Samples of one pose are of several postures.
    """
    axes = list(POSITION)
    grouped = frame.groupby(KEYS, sort=False)
    first = np.asarray(grouped.head(1).index, dtype=np.intp)
    angles = [f"q{i + 1}_rad" for i in range(n)]
    apart = (frame[angles] - grouped[angles].transform("first")).abs().to_numpy().max(axis=1)
    if (apart > SAME_POSE_RAD).any():
        row = int(np.flatnonzero(apart > SAME_POSE_RAD)[0])
        said = ", ".join(f"{key} {frame[key].iloc[row]}" for key in KEYS)
        found = f"a joint {apart[row]:.3g} rad from that of the first"
        raise source.fault(expected=f"samples of {said} in one posture", found=found, row=row)
    turned = [name for name in QUATERNION if name in frame]
    if turned:  # q and -q are the same orientation: all samples on the side of the first
        values = frame[turned].to_numpy(dtype=np.float64)
        same = np.sign(np.sum(values * grouped[turned].transform("first").to_numpy(dtype=np.float64), axis=1))
        frame[turned] = np.where(same == 0.0, 1.0, same)[:, None] * values
    names = [name for name in frame.select_dtypes("number").columns if name not in (*KEYS, "time_s")]
    names = [name for name in names if not name.startswith("dir")]
    out = frame.loc[first].reset_index(drop=True)
    middle = grouped[names].median().reset_index(drop=True)
    out[names] = middle[names]
    out["time_s"] = grouped["time_s"].min().to_numpy()
    if turned:
        out[turned] = out[turned].to_numpy() / np.linalg.norm(out[turned].to_numpy(), axis=1, keepdims=True)
    out["samples"] = grouped.size().to_numpy()
    off = (frame[axes] - grouped[axes].transform("median")).abs()
    size = out["samples"].to_numpy()
    factor = np.where(
        size < len(SMALL_SAMPLE_FACTORS),
        SMALL_SAMPLE_FACTORS[np.minimum(size, len(SMALL_SAMPLE_FACTORS) - 1)],
        size / (size - LARGE_SAMPLE_OFFSET).clip(min=1.0),
    )
    spread = off.groupby([frame[key] for key in KEYS], sort=False).median().mul(ROBUST * factor, axis=0)
    for axis in axes:
        out[f"scatter_{axis}"] = spread[axis].to_numpy()
    x, y, z = (float(spread.loc[size > 1, axis].median()) for axis in axes)
    return out, (x, y, z), first
