"""States of the motors' dry friction along a log, for some presliding lengths and relaxation times.

Dahl's law with relaxation, dz/dt = |w|/s (sign(w) - z) - z/t: the state needs the whole motion before a row, so that it
is a signal of the log and not a function of one row. Between two rows, with the motor turning steadily by dx in dt, it
moves by k = |dx|/s + dt/t towards sign(dx) (|dx|/s)/k, exactly. Source: Olsson et al. (1998), section 3, Dahl's model;
the relaxation is the creep of the contacts at rest.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from clampid.effect import PRESLIDING_LENGTHS, RELAXATION_TIMES
from clampid.stages.rows import Array, Bools, Integers

__all__ = ["dry_states", "friction_states", "recurrence"]


def friction_states(signals: Mapping[str, Array], time: Array, run: Integers, logged: bool) -> Array:
    """Return the states of dry friction ``(N, n, S x K)`` of a log.

    Parameters
    ----------
    signals
        ``motor`` ``(N, n)``, rad, and ``motor_speed``, rad/s.
    time, run
        ``(N,)``, s and number of the run.
    logged
        Whether the log has speeds of its own. Such a log may be too sparse to integrate them; speeds taken over a
        window do not have the jitter of an encoder's counts, which would wear the state down.
    """
    if logged:
        turned = np.diff(signals["motor"], axis=0, prepend=signals["motor"][:1])
    else:
        speed, steps = signals["motor_speed"], np.diff(time, prepend=time[:1])[:, None]
        turned = 0.5 * (speed + np.vstack([speed[:1], speed[:-1]])) * steps
    return dry_states(turned, time, run)


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
