"""How well a robot reaches its poses, beside a comparison: metrics of ISO 9283, and errors about a sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clampid.stages.rows import Array, Bools, Integers, Rows
from experiments.metrics import norm_metrics, pose_metrics, split_about

__all__ = ["placing"]


def placing(
    rows: Rows,
    residual: Array,
    test: Rows,
    test_residual: Array,
    chosen: Bools,
    sample: Sequence[float] | None = None,
) -> dict[str, Any]:
    """Extra fields of a comparison of poses.

    Parameters
    ----------
    rows, residual
        All rows of the table and what the model leaves of them, ``(N, 3)`` or more, m: the returns of ISO 9283. Its
        command is where the model says that the point is, so that AP is what compensation with it would leave.
    test, test_residual, chosen
        Rows held out, which errors about a sample are given of.
    sample
        ``(3,)`` m, base frame.

    Returns
    -------
    dict
        ``iso9283`` where something was repeated, and ``universal`` (P_mean, P_std, P_max of held-out errors), and
        ``sample`` (radial and along the sphere, root mean square and maximum), m.
    """
    out: dict[str, Any] = {}
    used = np.flatnonzero(rows.used[:, 0])
    error = residual[used, :3]
    place, side = _labels(rows, used)
    metrics = pose_metrics(error, np.zeros_like(error), place, side, rows.constants["time"][used]).to_json()
    if metrics:
        out["iso9283"] = metrics
    held = np.flatnonzero(chosen & test.used[:, 0])
    if not len(held):
        return out
    norms = np.linalg.norm(test_residual[held, :3], axis=1)
    out["universal"] = norm_metrics(norms)
    if sample is not None:
        frames = test.constants["base_reference"][held]
        points = np.einsum("nji,nj->ni", frames[:, :3, :3], test.measured[held, :3] - frames[:, :3, 3])
        errors = np.einsum("nji,nj->ni", frames[:, :3, :3], test_residual[held, :3])
        radial, along = split_about(errors, points, np.asarray(sample, dtype=float))
        out["sample"] = {"rows": len(held)} | {
            name: {"rms": float(np.sqrt(np.mean(part**2))), "max": float(np.abs(part).max())}
            for name, part in (("radial", radial), ("along", along))
        }
    return out


def _labels(rows: Rows, used: Integers) -> tuple[Integers, Integers]:
    """Numbers of pose and target, and of the side that a row was approached from, -1 if not known, ``(k,)`` each."""
    keys = np.c_[rows.session, rows.fold, rows.signals["target_is"]][used]
    direction = rows.signals["direction"][used]
    _, place = np.unique(keys, axis=0, return_inverse=True)
    _, side = np.unique(direction, axis=0, return_inverse=True)
    return place.astype(np.int64), np.where(np.all(direction != 0, axis=1), side, -1).astype(np.int64)
