"""Temperatures that a table recorded, as signals."""

from __future__ import annotations

import numpy as np

from clampid.stages.rows import Array

__all__ = ["temperatures"]


def temperatures(table: object, n: int) -> dict[str, Array]:
    """Temperatures of links and motors less 20 degC, ``(N, n)``; zeros where no sensor is."""
    out = {}
    for kind in ("link", "motor"):
        values = np.zeros((len(table), n))  # type: ignore[arg-type]
        for i in range(n):
            column = f"temp_{kind}{i + 1}_C"
            if column in table.columns:  # type: ignore[attr-defined]
                values[:, i] = np.nan_to_num(table[column].to_numpy(float) - 20.0)  # type: ignore[index]
        out[f"{kind}_temperature"] = values
    return out
