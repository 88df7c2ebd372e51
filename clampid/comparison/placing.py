"""How well a robot reaches its poses, beside a comparison: metrics of ISO 9283, and errors about a sample."""

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
    """Extra fields of a comparison of poses.

    Parameters
    ----------
    rows, residual
        All rows of the table and what the model leaves of them, ``(N, 3)`` or more, m.
    test, test_residual, chosen
        Rows held out.
    effects
        The catalogue.
    sample
        ``(3,)`` m, base frame.

    Returns
    -------
    dict
        ``iso9283``: ``robot``, as its controller has it, ``compensated``, the command being where the model says that
        the point is, so that AP is what compensation would leave, and ``compensated_rows``, of which rows that is
        (``held out`` where places among these were returned to, else ``all``). ``universal`` (P_mean, P_std, P_max of
        held-out errors) and ``sample`` (radial and along the sphere, root mean square and maximum), m. ``robot``:
        ``rows``, ``universal`` and ``sample`` of the robot as its controller has it.
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
    """Whether any target was measured twice at one pose."""
    used = rows.used[:, 0]
    keys = np.c_[rows.session, rows.fold, rows.signals["target_is"]][used]
    return len(keys) > len(np.unique(keys, axis=0))


def _errors(rows: Rows, residual: Array, chosen: Integers, sample: Sequence[float] | None) -> dict[str, Any]:
    """The universal model's figures of chosen rows' errors and, about a sample, their two parts."""
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
