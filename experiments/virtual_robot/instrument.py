"""The readings: points in the instrument's own frame, torques with noise that is correlated in time."""

from __future__ import annotations

import numpy as np

from experiments.virtual_robot.description import Array
from experiments.virtual_robot.plant import Instrument

CORRELATION_TIME = 2.0  # s, of the slow part of the torque noise
SLOW_SHARE = 0.5  # of the variance


def to_instrument(instrument: Instrument, points: Array) -> Array:
    """Return base-frame points, m, (N, 3), as the instrument would read them without noise."""
    return np.asarray(instrument.scale * (points @ instrument.rotation.T + instrument.origin), dtype=float)


def torque_noise(sigma: Array, rows: int, step: float, rng: np.random.Generator) -> Array:
    """Return torque noise, Nm, (rows, n), of standard deviation ``sigma`` (n,), logged every ``step`` seconds."""
    from scipy.signal import lfilter  # half of what starting a virtual controller takes, which does without

    memory = np.exp(-step / CORRELATION_TIME)
    white, drive = rng.standard_normal((2, rows, len(sigma)))
    drive[1:] *= np.sqrt(1 - memory**2)  # the first row starts in the stationary state
    slow = lfilter([1.0], [1.0, -memory], drive, axis=0)
    return np.asarray(sigma * (np.sqrt(1 - SLOW_SHARE) * white + np.sqrt(SLOW_SHARE) * slow), dtype=float)
