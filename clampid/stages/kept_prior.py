"""Prior of the friction that motors at rest keep while the flange is clamped."""

from __future__ import annotations

import numpy as np

from clampid.stages.rows import Array, Rows

__all__ = ["with_kept_friction"]

CREEP_SHARE = 0.05  # of its friction: what a motor at rest loses between sweeps
LOOP_SHARE = 0.25  # of its friction: how exactly the loops of its last motion show it


def with_kept_friction(rows: Rows, first: int, precision: Array, mean: Array) -> tuple[Array, Array]:
    """A prior ``(P + K, P + K)``, ``(P + K,)`` with that of motors that stood still, offsets from ``first`` on.

    A motor at rest keeps its friction, except for a small creep. Its prior mean is the friction of its last motion,
    known from its own loops; if the motor has not moved since the arm was clamped, the prior is wide.
    """
    sweep, n = rows.sweep, rows.robot.n
    keys = [(int(s), int(k)) for s, k in sweep.offset_keys]
    place = {key: first + i for i, key in enumerate(keys)}
    for s, k in keys:
        at, before = place[s, k], place.get((s - 1, k))
        if k < n or not sweep.stood[s, k - n]:
            continue
        friction = float(sweep.loop_friction[k - n])
        if before is not None:
            pair = np.ix_([before, at], [before, at])
            mean[at], precision[at, at] = mean[before], 0.0
            precision[pair] += np.array([[1.0, -1.0], [-1.0, 1.0]]) / (CREEP_SHARE * friction) ** 2
        elif sweep.kept_sign[s, k - n]:
            mean[at] = sweep.kept_sign[s, k - n] * friction
            precision[at, at] = 1.0 / (LOOP_SHARE * friction) ** 2
    return precision, mean
