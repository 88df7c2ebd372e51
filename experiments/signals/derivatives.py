"""Speeds and accelerations of a log, and the same filter for anything else in it.

**No filter adds a lag.** Every filter is symmetric in time. A filter still changes shapes (steps of friction become
ramps), so both sides of an equation must pass it. For τ = Y(q, q̇, q̈)·φ with constant φ, filtering each
column of Y and τ alike changes neither φ nor its bias::

    window = choose_window(q, time, run, order=2)
    qd, qdd = speeds(q, time, run, window), accelerations(q, time, run, window)
    Y = regressor(q, qd, qdd)                        # (N, p): friction's signs too are taken before the filter
    Yf, tauf = low_pass(Y, time, run, 2 * window), low_pass(tau[:, None], time, run, 2 * window)

Both sides pass the longer filter, so that the blur of the derivatives is in τ as well.
"""

from __future__ import annotations

import numpy as np

from experiments.signals.clock import stale_rows, typical_step
from experiments.signals.polynomial import local_polynomial, smallest_half
from experiments.signals.typing_ import Array, Bools, Integers
from experiments.signals.window import choose_window

__all__ = ["acceleration", "accelerations", "differentiate", "low_pass", "speeds"]


def speeds(q: Array, time: Array, run: Integers, window_s: float | None = None, step: float | None = None) -> Array:
    """Joint speeds ``(N, n)`` [rad/s] from positions ``(N, n)`` [rad]; see :func:`differentiate`."""
    return differentiate(q, time, run, 1, window_s, stale_rows(q, run), step)


def accelerations(q: Array, time: Array, run: Integers, window_s: float | None = None) -> Array:
    """Joint accelerations ``(N, n)`` [rad/s²] from positions ``(N, n)`` [rad], in one step.

    For logs without speeds: the window is chosen for the second derivative, and noise passes one filter, not two.
    """
    return differentiate(q, time, run, 2, window_s, stale_rows(q, run))


def acceleration(
    speed: Array, time: Array, run: Integers, window_s: float | None = None, step: float | None = None
) -> Array:
    """Joint accelerations ``(N, n)`` [rad/s²] from speeds ``(N, n)`` [rad/s]; see :func:`differentiate`."""
    return differentiate(speed, time, run, 1, window_s, step=step)


def low_pass(values: Array, time: Array, run: Integers, window_s: float, stale: Bools | None = None) -> Array:
    """Any columns ``(N, c)``, smoothed with no lag by the filter that also gives speeds; how to use it: the module."""
    return differentiate(values, time, run, 0, window_s, stale)


def differentiate(
    values: Array,
    time: Array,
    run: Integers,
    order: int,
    window_s: float | None = None,
    stale: Bools | None = None,
    step: float | None = None,
    wanted: Bools | None = None,
) -> Array:
    """Differentiate columns of a log by local cubics, without lag, run by run.

    A polynomial ends where a run does, where the clock goes back, and at gaps longer than half the window; shorter
    gaps and irregular steps are taken as the stamps say. See :mod:`experiments.signals.polynomial`.

    Parameters
    ----------
    values
        Columns ``(N, c)``.
    time
        Stamps ``(N,)`` [s].
    run
        Numbers of the runs ``(N,)``, each of them contiguous.
    order
        0 (smooth), 1 or 2.
    window_s
        Length of the window [s]; at least five samples are taken. By default chosen from the data:
        :func:`~experiments.signals.window.choose_window`.
    stale
        Rows ``(N,)`` that only repeat the one before and are not measurements.
    step
        The usual step of the log that the rows are a part of [s]; by default that of the rows.
    wanted
        Rows ``(N,)`` whose derivatives are asked for, by default all; the others stay zero.

    Returns
    -------
    Array
        ``(N, c)``, per s^order.

    Raises
    ------
    ValueError
        If the shapes do not fit, or the order or the window is not one.
    """
    values, time = np.asarray(values, dtype=np.float64), np.asarray(time, dtype=np.float64)
    if values.ndim != 2 or time.shape != (len(values),) or np.shape(run) != time.shape:
        found = f"{values.shape}, {time.shape} and {np.shape(run)}"
        raise ValueError(f"values, time and run: expected shapes (N, c), (N,) and (N,), found {found}")
    if order not in (0, 1, 2):
        raise ValueError(f"order: expected 0, 1 or 2, found {order}")
    if window_s is not None and not window_s > 0.0:
        raise ValueError(f"window_s: expected a positive number of seconds, found {window_s}")
    if len(values) == 0:
        return np.zeros_like(values)
    length = choose_window(values, time, run, order) if window_s is None else window_s
    step = typical_step(time, run) if step is None else step
    half = max(int(np.rint(length / step / 2.0)), smallest_half())
    usable = np.ones(len(values), dtype=bool) if stale is None else ~stale
    return local_polynomial(values, time, run, half, order, usable, step, wanted)
