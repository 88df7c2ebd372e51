"""Errors of one table of a comparison: of fitted and held-out rows, with the noise floor, and for each motor."""

from __future__ import annotations

from typing import Any

import numpy as np

from clampid.fitting.accuracy import Floor, size_of
from clampid.stages.rows import Array, Bools, Rows

__all__ = ["table_errors"]


def table_errors(
    rows: Rows,
    residual: Array,
    shown: Bools,
    test: Rows,
    test_residual: Array,
    chosen: Bools,
    floor: Floor,
) -> dict[str, Any]:
    """The errors of one table.

    Parameters
    ----------
    rows, residual, shown
        Rows with their residual ``(N, m)``, SI, and which of them count as fitted ``(N,)``.
    test, test_residual, chosen
        The same of the held-out rows.
    floor
        The noise floor.
    """
    poses, counts = rows.kind.points, rows.used.any(axis=1)
    entry: dict[str, Any] = {
        "unit": "m" if poses else "sigma",
        "rows": int((shown & counts).sum()),
        **_numbers(rows, residual, shown, floor),
        "noise_floor": floor.norm if poses else 1.0,
        "noise_source": floor.source,
    }
    if poses and rows.ranged[shown].any():
        entry["measured"] = "distances"
    seen = test.used.any(axis=1)
    entry["heldout"] = {"rows": int((chosen & seen).sum()), **_numbers(test, test_residual, chosen, floor)}
    wrong = chosen & ~seen & (test.table == "verification")
    if wrong.any():
        whole = np.linalg.norm(test_residual[chosen, :3], axis=1)
        entry["heldout"] |= {
            "outliers": test.row[wrong].tolist(),
            "rms_with_outliers": float(np.sqrt(np.mean(whole**2))),
        }
    if rows.kind.moving or rows.kind.solved:
        entry["per_motor"] = [
            {
                **_motor(rows, residual, shown, c),
                "noise_floor_Nm": float(floor.sigma[c]),
                "heldout": _motor(test, test_residual, chosen, c),
            }
            for c in range(rows.robot.n)
        ]
    return entry


def _numbers(rows: Rows, residual: Array, chosen: Bools, floor: Floor) -> dict[str, float | None]:
    """Rms, mean, maximum and 95th percentile of the errors of rows ``chosen`` ``(N,)``; None without rows."""
    size, counts = size_of(rows, residual, floor)
    picked = np.abs(size[chosen][counts[chosen]])
    if not picked.size:
        return {"rms": None, "mean": None, "max": None, "p95": None}
    return {
        "rms": float(np.sqrt(np.mean(picked**2))),
        "mean": float(np.mean(picked)),
        "max": float(np.max(picked)),
        "p95": float(np.quantile(picked, 0.95)),
    }


def _motor(rows: Rows, residual: Array, chosen: Bools, motor: int) -> dict[str, float | None]:
    """Rms error, Nm, and R² of one motor's torques in rows ``chosen`` ``(N,)``; None with fewer than two rows."""
    used = chosen & rows.used[:, motor]
    if used.sum() < 2:
        return {"rms_Nm": None, "r2": None}
    r, y = residual[used, motor], rows.measured[used, motor]
    spread = float(np.sum((y - y.mean()) ** 2))
    r2 = 1.0 - float(np.sum(r**2)) / spread if spread > 0 else None
    return {"rms_Nm": float(np.sqrt(np.mean(r**2))), "r2": r2}
