"""Pose accuracy in a comparison: metrics of ISO 9283, of the universal model, and about a sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clampid.comparison.attained import as_sent, iso9283
from clampid.effect import Effect
from clampid.stages.rows import Array, Bools, Integers, Rows
from experiments.measures.metrics import norm_metrics, split_about

__all__ = ["placing"]


def placing(
    rows: Rows,
    residual: Array,
    test: Rows,
    test_residual: Array,
    chosen: Bools,
    effects: Mapping[str, Effect],
    sample: Sequence[float] | None = None,
) -> dict[str, Any]:
    """Further fields of a comparison of poses.

    Parameters
    ----------
    rows, residual
        All rows of the table, and their residual by the model ``(N, 3)`` or more, m.
    test, test_residual, chosen
        Rows that contain the held-out ones, their residual by the model, and which of them are held out.
    effects
        The catalogue: name → effect.
    sample
        Position of a sample ``(3,)``, m, base frame; None: none.

    Returns
    -------
    dict
        ``iso9283`` has ``robot``, of the uncompensated robot, and ``compensated``, with the model's prediction as the
        command: its AP is what a compensation would leave. ``compensated_rows`` says of which rows: ``held out`` if
        poses among these were visited again, else ``all``. ``universal`` has P_mean, P_std and P_max of held-out
        errors, ``sample`` their radial and tangential parts (rms and maximum), m. ``robot`` has ``rows``,
        ``universal`` and ``sample`` of the uncompensated robot.
    """
    sent = as_sent(rows, effects)
    held_out = test.take(chosen)
    returned = _returned(held_out)
    compensated = iso9283(held_out, test_residual[chosen]) if returned else iso9283(rows, residual)
    out: dict[str, Any] = {
        "iso9283": {
            "robot": iso9283(rows, sent.residual),
            "compensated": compensated,
            "compensated_rows": "held out" if returned else "all",
            "reported_angles_differ_m": sent.reported,
        },
        "robot": _errors(rows, sent.residual, np.flatnonzero(rows.used[:, 0]), sample),
    }
    counts = np.flatnonzero(chosen & test.used[:, 0])
    if len(counts):
        out |= {k: v for k, v in _errors(test, test_residual, counts, sample).items() if k != "rows"}
    return out


def _returned(rows: Rows) -> bool:
    """Whether any target was measured more than once at one pose."""
    used = rows.used[:, 0]
    keys = np.c_[rows.session, rows.fold, rows.signals["target_is"]][used]
    return len(keys) > len(np.unique(keys, axis=0))


def _errors(rows: Rows, residual: Array, chosen: Integers, sample: Sequence[float] | None) -> dict[str, Any]:
    """Metrics of the universal model of the errors of rows ``chosen``, and their two parts about a sample."""
    out: dict[str, Any] = {"rows": len(chosen)}
    out["universal"] = norm_metrics(np.linalg.norm(residual[chosen, :3], axis=1))
    if sample is None:
        return out
    frames = rows.pose.base_reference[chosen]
    points = np.einsum("nji,nj->ni", frames[:, :3, :3], rows.measured[chosen, :3] - frames[:, :3, 3])
    errors = np.einsum("nji,nj->ni", frames[:, :3, :3], residual[chosen, :3])
    radial, along = split_about(errors, points, np.asarray(sample, dtype=float))
    out["sample"] = {"rows": len(chosen)} | {
        name: {"rms": float(np.sqrt(np.mean(part**2))), "max": float(np.abs(part).max())}
        for name, part in (("radial", radial), ("along", along))
    }
    return out
