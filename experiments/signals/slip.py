"""Path-dependent signals: elements of dry friction that stick, are wound up by motion, and slip.

The stop operator of Prandtl and Ishlinskii: z follows the motion in units of its width and is held within −1 … 1. A row
of them with fixed widths is what Maxwell slip models are made of, and linear in their forces. Source: Krasnosel'skii
and Pokrovskii, Systems with Hysteresis, 1989.
"""

from __future__ import annotations

import numpy as np

from experiments.signals.typing_ import Array, Integers

__all__ = ["slip_states"]


def slip_states(motion: Array, widths: Array, stretch: Integers) -> Array:
    """States of slipping elements along a motion.

    Parameters
    ----------
    motion
        Positions ``(N, n)`` in the order of time, rad.
    widths
        ``(n, k)``, rad: the motion over which an element is wound up from nothing until it slips.
    stretch
        ``(N,)``: where the number changes, all elements start again from nothing.

    Returns
    -------
    Array
        ``(N, n, k)``, −1 … 1: +1 while slipping forward; standing still keeps it.
    """
    step = np.diff(motion, axis=0, prepend=motion[:1])[:, :, None] / widths
    fresh = np.r_[True, stretch[1:] != stretch[:-1]]
    out = np.zeros_like(step)
    now = np.zeros(step.shape[1:])
    for i in range(len(step)):
        now = np.zeros_like(now) if fresh[i] else np.clip(now + step[i], -1.0, 1.0)
        out[i] = now
    return out
