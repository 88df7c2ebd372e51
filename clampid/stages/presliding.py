"""States of the motors' dry friction along a log, for some presliding lengths and relaxation times.

Dahl's law with relaxation, dz/dt = |w|/s (sign(w) - z) - z/t: the state needs the whole motion before a row, so that it
is a signal of the log and not a function of one row. Between two rows, with the motor turning steadily by dx in dt, it
moves by k = |dx|/s + dt/t towards sign(dx) (|dx|/s)/k, exactly. Source: Olsson et al. (1998), section 3, Dahl's model;
the relaxation is the creep of the contacts at rest.
"""

from __future__ import annotations

from math import comb

import numpy as np
from scipy import stats

from clampid.effect import PRESLIDING_LENGTHS, RELAXATION_TIMES
from clampid.stages.rows import Array, Bools, Integers

__all__ = ["dry_states", "friction_states", "recurrence", "with_play"]

BELOW = 0.75  # the quantile of differences that is taken
AT_REST, ANYWHERE = 2, 4  # orders of the differences at rest, and of those in motion


def friction_states(position: Array, resting: Bools, time: Array, run: Integers) -> Array:
    """Return the states of dry friction ``(N, n, S x K)`` of a log.

    Recorded positions jitter, which would wear the states down at rest. Positions smoothed over a window swing beyond
    the end of a quick move, as if the motor had turned back. So the recorded positions are followed with a play that
    is as wide as they jitter.

    Parameters
    ----------
    position
        Motor positions ``(N, n)``, rad, as recorded.
    resting
        ``(N, n)``: whether the motor is at rest.
    time, run
        ``(N,)``, s and number of the run.
    """
    followed = with_play(position, _play(position, resting, run), run)
    return dry_states(np.diff(followed, axis=0, prepend=followed[:1]), time, run)


def _play(position: Array, resting: Bools, run: Integers) -> Array:
    """Four standard deviations of each motor's positions ``(n,)``, rad, by differences that motion changes little.

    Second differences at rest, or fourth ones anywhere: motion can only enlarge either, so the smaller one counts. In
    rests a quantile of them covers the flicker of an encoder by a count, too.
    """
    found = np.full((2, position.shape[1]), np.inf)
    for row, order in enumerate((AT_REST, ANYWHERE)):
        if len(position) <= order:
            continue
        normal = np.sqrt(comb(2 * order, order)) * stats.norm.isf(0.5 * (1.0 - BELOW))  # of independent numbers
        inside = run[order:] == run[:-order]
        differences = np.abs(np.diff(position, order, axis=0))
        for motor in range(position.shape[1]):
            chosen = inside.copy()
            for k in range(order + 1 if order == AT_REST else 0):
                chosen &= resting[k : len(resting) - order + k, motor]
            if chosen.any():
                found[row, motor] = float(np.quantile(differences[chosen, motor], BELOW)) / normal
    least = found.min(axis=0)
    return np.where(np.isfinite(least), 4.0 * least, 0.0)


def with_play(position: Array, play: Array, run: Integers) -> Array:
    """Positions ``(N, n)`` that follow others only where these leave a play of half width ``(n,)`` about them."""
    low, high = position - play, position + play
    first = np.r_[True, run[1:] != run[:-1]]
    low[first] = high[first] = position[first]
    # y[i] = clip(y[i - 1], low[i], high[i]); what several of these do to y is one such clip.
    count, block = len(position), max(int(np.sqrt(len(position))), 1)
    blocks = -(-count // block)
    padding = ((0, blocks * block - count), (0, 0))
    low, high = (np.pad(x, padding, mode="edge").reshape(blocks, block, -1) for x in (low, high))
    for i in range(1, block):
        at = low[:, i].copy(), high[:, i].copy()
        low[:, i], high[:, i] = np.clip(low[:, i - 1], *at), np.clip(high[:, i - 1], *at)
    y = np.empty_like(low)
    y[0] = low[0]
    for b in range(1, blocks):
        y[b] = np.clip(y[b - 1, -1], low[b], high[b])
    return np.asarray(y.reshape(-1, position.shape[1])[:count])


def dry_states(turned: Array, time: Array, run: Integers) -> Array:
    """Return the states of dry friction ``(N, n, S x K)``, -1 to +1.

    Parameters
    ----------
    turned
        ``(N, n)``: by how much each motor has turned since the row before, rad; of a run's first row it is not read.
    time
        ``(N,)``, s.
    run
        ``(N,)``. At the start of a run the friction is unknown: all states are zero.
    """
    first = np.r_[True, run[1:] != run[:-1]]
    elapsed = np.where(first, 0.0, np.maximum(np.diff(time, prepend=time[:1]), 0.0))
    lengths = np.repeat(PRESLIDING_LENGTHS, len(RELAXATION_TIMES))
    relaxed = elapsed[:, None] / np.tile(RELAXATION_TIMES, len(PRESLIDING_LENGTHS))
    out = np.empty((*turned.shape, len(lengths)))
    for motor, moved in enumerate(turned.T):
        out[:, motor] = _of_motor(moved[:, None] / lengths, relaxed, first)
    return out


def _of_motor(wound: Array, relaxed: Array, first: Bools) -> Array:
    """States ``(N, S x K)`` of one motor from travels in units of the length and times in units of the time."""
    k = np.abs(wound) + relaxed
    goal = np.divide(wound, k, out=np.zeros_like(k), where=k > 0.0)
    decay = np.exp(-k)
    gain = -goal * np.expm1(-k)
    decay[first], gain[first] = 0.0, 0.0
    return recurrence(decay, gain)


def recurrence(decay: Array, gain: Array) -> Array:
    """Return z ``(N, S)`` with ``z[i] = decay[i] z[i - 1] + gain[i]``, ``z[-1] = 0``.

    Blocks side by side, and then the blocks one after the other: about 2 sqrt(N) steps of numpy instead of N.

    Parameters
    ----------
    decay, gain
        ``(N, S)``; of a decay that all columns share, ``(N, 1)`` will do.
    """
    count, width = gain.shape
    block = max(int(np.sqrt(count)), 1)
    blocks = -(-count // block)
    padding = ((0, blocks * block - count), (0, 0))
    a = np.pad(decay, padding).reshape(blocks, block, decay.shape[1])
    z = np.pad(gain, padding).reshape(blocks, block, width)
    for i in range(1, block):
        z[:, i] += a[:, i] * z[:, i - 1]
        a[:, i] *= a[:, i - 1]
    for b in range(1, blocks):
        z[b] += a[b] * z[b - 1, -1]
    return np.asarray(z.reshape(-1, width)[:count])
