"""The misfit of local polynomials: whether a log is sampled closely enough to be differentiated."""

from __future__ import annotations

import numpy as np

from experiments.signals.typing_ import Array, Integers

__all__ = ["misfit"]

_FIFTH = np.array([1.0, -4.0, 6.0, -4.0, 1.0])  # of five even samples: zero for every cubic
_LATE = 1.5  # of its usual length, that a window may have


def misfit(values: Array, time: Array, run: Integers, order: int, window_s: float, step: float) -> Array:
    """By how far five samples across the window of a local cubic are from any cubic, as a derivative ``(N, c)``.

    It is nearly zero if the motion changes slowly within the window. Where a move begins or ends between two samples,
    it is as large as the acceleration itself. It is the fourth difference over the power of the
    spacing; infinite where a run ends or a sample is missing within the window.

    Parameters
    ----------
    values
        Columns ``(N, c)``, in order of time.
    time, run
        ``(N,)``, s, and numbers of the runs.
    order
        Of the derivative that is taken of them, 1 or 2; per s^order.
    window_s
        Length of the window, s; at least five samples.
    step
        The usual step, s.
    """
    out = np.full(values.shape, np.inf)
    apart = max(1, round(window_s / step / 4.0))
    reach = 2 * apart
    if len(values) <= 2 * reach:
        return out
    inner = slice(reach, len(values) - reach)
    shifted = [values[k : len(values) - 2 * reach + k] for k in range(0, 2 * reach + 1, apart)]
    fourth = sum(weight * part for weight, part in zip(_FIFTH, shifted, strict=True))
    length = time[2 * reach :] - time[: -2 * reach]
    whole = (run[2 * reach :] == run[: -2 * reach]) & (length <= _LATE * 2 * reach * step)
    out[inner] = np.where(whole[:, None], np.abs(fourth) / (apart * step) ** order, np.inf)
    return out
