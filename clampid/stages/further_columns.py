"""What a table of poses has recorded beyond the contract, such as a speed of approach, as signals."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from clampid.stages.rows import Array, Rows
from experiments.columns import further_columns, is_further
from experiments.further import numbers

__all__ = ["further_of", "further_signals"]


def further_signals(frame: pd.DataFrame, others: Mapping[str, pd.DataFrame], n: int) -> dict[str, Array]:
    """Every further column of numbers, by its name: ``(N,)``, in its own unit.

    An empty cell, or one that is not finite, has the mean of the others. Such a row does not determine the dependence.

    Parameters
    ----------
    frame
        The table ``(N rows)``.
    others
        All tables of its kind of the campaign, by name, of which one may have a column that it lacks.
    n
        Number of joints.
    """
    names = dict.fromkeys(c for table, f in others.items() for c in further_columns(map(str, f.columns), table, n))
    out: dict[str, Array] = {}
    for name in names:
        every = [numbers(f[name]) for f in (frame, *others.values()) if name in f]
        known = next((v[np.isfinite(v)] for v in every if np.isfinite(v).any()), None)
        if known is not None:
            own = every[0] if name in frame else np.full(len(frame), np.nan)
            out[name] = np.where(np.isfinite(own), own, known.mean())
    return out


def further_of(rows: Rows) -> dict[str, Array]:
    """The further columns ``(N,)`` that rows have as signals, by name."""
    return {name: values for name, values in rows.signals.items() if is_further(name)}
