"""Single rows that are wrong: a lost beam, a spike on a current."""

from __future__ import annotations

import numpy as np
import pandas as pd

POINT_ERROR = (1e-3, 5e-3)  # m
TORQUE_ERROR = (3.0, 8.0)  # times the spread of that torque


def spoil(table: pd.DataFrame, share: float, rng: np.random.Generator) -> tuple[pd.DataFrame, tuple[int, ...]]:
    """Return the table with a share of its rows spoilt, and which rows those are."""
    rows = np.sort(rng.choice(len(table), round(share * len(table)), replace=False))
    if len(rows) == 0:
        return table, ()
    table = table.copy()
    sign = rng.choice([-1.0, 1.0], len(rows))
    if "distance_m" in table:
        table.loc[rows, "distance_m"] += sign * rng.uniform(*POINT_ERROR, len(rows))
    elif "x_m" in table:
        way = rng.standard_normal((len(rows), 3))
        error = way / np.linalg.norm(way, axis=1, keepdims=True) * rng.uniform(*POINT_ERROR, (len(rows), 1))
        table.loc[rows, ["x_m", "y_m", "z_m"]] += error
    else:
        names = [c for c in table.columns if c.startswith("tau")]
        hit = rng.integers(0, len(names), len(rows))
        for row, k, s in zip(rows, hit, sign, strict=True):
            table.loc[row, names[k]] += s * rng.uniform(*TORQUE_ERROR) * float(table[names[k]].std())
    return table, tuple(int(r) for r in rows)
