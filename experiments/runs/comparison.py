"""Compares the places of the clamp: a drive that seems softer in one of them shows that the block yields there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from experiments.plans.model import Plan
from experiments.plans.motion import Array
from experiments.runs.folder import tables_of
from experiments.runs.load import slope_of

__all__ = ["compared_places"]

DIFFERENT = 3.0  # standard errors
AT_LEAST = 0.05  # of the stiffness: smaller differences may come from clearance and load-dependent friction


def compared_places(plan: Plan, entries: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """A sentence for each joint that was driven in two places of the clamp; one if none was.

    Parameters
    ----------
    plan
        With its sweeps.
    entries
        Of the journal.
    """
    frame = tables_of(entries).get("clamped")
    if frame is None:
        return
    if len({sweep.clamping for sweep in plan.sweeps}) < 2:
        yield "The flange was clamped in one place only: a yielding block cannot be separated from soft springs."
        return
    found: dict[int, dict[int, list[tuple[float, float]]]] = {}
    for number, sweep in enumerate(plan.sweeps, 1):
        rows = frame[frame["sweep"] == number]
        j = sweep.joint + 1
        motor, torque = (rows[f"{name}{j}_{unit}"].to_numpy(float) for name, unit in (("motor", "rad"), ("tau", "Nm")))
        value = _both_ways(motor, torque, np.asarray(sweep.offset[: len(rows)], dtype=float))
        if value is not None:
            found.setdefault(j, {}).setdefault(sweep.clamping, []).append(value)
    if all(len(places) < 2 for places in found.values()):
        yield "No joint was driven in two places of the clamp: whether the block yields is not compared."
    for joint, places in sorted(found.items()):
        if len(places) < 2:
            continue
        means = {place: _mean(values) for place, values in places.items()}
        (_, low), (_, high) = (f(means.items(), key=lambda item: item[1][0]) for f in (min, max))
        stiffnesses = ", ".join(f"{v:.2f} ± {e:.2f} Nm/rad in place {place}" for place, (v, e) in sorted(means.items()))
        apart = high[0] - low[0]
        differs = apart > DIFFERENT * np.hypot(low[1], high[1]) and apart > AT_LEAST * high[0]
        verdict = "the block yields in the softer place" if differs else "the same"
        yield f"Stiffness of joint {joint} at its motor: {stiffnesses}: {verdict}."


def _both_ways(motor: Array, torque: Array, offset: Array) -> tuple[float, float] | None:
    """Mean slope of the two directions; in each of them friction has one sign."""
    steps = np.sign(np.diff(np.r_[0.0, offset]))
    turns = np.r_[0, np.flatnonzero(np.diff(steps)) + 1, len(steps)]
    slopes = [slope_of(motor[a + 1 : b], torque[a + 1 : b]) for a, b in pairwise(turns) if b - a > 4]
    return _mean(slopes) if slopes else None


def _mean(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    v, e = np.array(values).T
    own = float(np.sqrt(np.sum(e**2))) / len(v)
    spread = float(np.std(v, ddof=1) / np.sqrt(len(v))) if len(v) > 1 else 0.0
    return float(v.mean()), max(own, spread)
