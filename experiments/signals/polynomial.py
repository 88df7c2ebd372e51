r"""Local polynomials on the stamps as they are: the one zero-phase filter of this package.

At time t, with the 2m + 1 samples nearest in the same stretch, h = (m + 1)/m times the distance to the farthest, and
Epanechnikov's weights w = 1 - ((t_k - t)/h)², the polynomial of third degree that minimises
Σ w_k (y_k - Σ_p c_p (t_k - t)^p)² gives value, speed and acceleration as c_0, c_1 and 2·c_2.

* Polynomials up to the third degree come out exactly, everywhere.
* Inside a stretch the window is symmetric, and so is the filter: no lag. At its ends the window stays and the
  polynomial is evaluated off its centre: no padding, no samples made up, at the price of more noise.
* On even steps it is a convolution; only ends and the surroundings of uneven steps are solved row by row.

Sources: Savitzky & Golay, Anal. Chem. 36 (1964) 1627; Fan & Gijbels, Local Polynomial Modelling and Its Applications
(1996), on weights and ends.
"""

from __future__ import annotations

from itertools import pairwise
from math import factorial

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import correlate1d
from scipy.signal import oaconvolve

from experiments.signals.clock import regular_time, typical_step
from experiments.signals.definite import solve_definite
from experiments.signals.typing_ import Array, Bools, Integers

__all__ = ["DEGREE", "kernel", "local_polynomial", "smallest_half"]

DEGREE = 3
# From here on convolving by Fourier transform is faster.
_LONG = 100
# A window of so many samples on a side does not see how the steps between them vary; where windows of even steps are
# rarer than this share, rows are not solved one by one.
_MANY, _SHARE = 16, 0.8
# Rows solved at once: their windows should stay in the processor's cache.
_BLOCK = 1 << 17


def smallest_half() -> int:
    """Half the shortest window: five samples, one more than a cubic needs."""
    return 2


def kernel(half: int, order: int) -> Array:
    """Weights ``(2·half + 1,)`` of the samples for the derivative of an order in the middle of even unit steps."""
    offset = np.arange(-half, half + 1) / (half + 1.0)
    weight = 1.0 - offset**2
    powers = offset[:, None] ** np.arange(DEGREE + 1)
    chosen = np.linalg.solve(powers.T @ (weight[:, None] * powers), np.eye(DEGREE + 1)[order])
    return np.asarray(factorial(order) * weight * (powers @ chosen) / (half + 1.0) ** order)


def local_polynomial(
    values: Array,
    time: Array,
    run: Integers,
    half: int,
    order: int,
    usable: Bools,
    step: float | None = None,
    wanted: Bools | None = None,
) -> Array:
    """Derivatives of columns by local polynomials.

    Parameters
    ----------
    values
        Columns ``(N, c)``.
    time
        Stamps ``(N,)`` [s].
    run
        Numbers of the runs ``(N,)``.
    half
        m, at least 2; the window is 2m + 1 samples, or the whole stretch where that is shorter.
    order
        0, 1 or 2.
    usable
        Rows ``(N,)`` that are measurements; others are predicted from these.
    step
        The log's usual step [s]; by default that of these rows.
    wanted
        Rows ``(N,)`` whose derivatives are asked for, by default all; the others stay zero.

    Returns
    -------
    Array
        ``(N, c)``, in units of the columns per s^order. Where a stretch has too few samples, the degree is what
        they allow; a derivative that they do not determine is 0.
    """
    values = np.asfortranarray(values)  # all that follows goes down the columns
    out = np.zeros_like(values)
    step = typical_step(time, run) if step is None else step
    # A polynomial is not used across a gap of more than half its window.
    reach = (half + 0.5) * step
    for rows in _stretches(time, run, reach):
        own, stamps = values[rows], time[rows]
        known = np.flatnonzero(usable[rows])
        # A repeated stamp is no second sample of its time.
        known = known[np.r_[True, np.diff(stamps[known]) > 0.0]] if len(known) else known
        if wanted is not None:
            at = np.flatnonzero(wanted[rows])
            if len(known) and len(at):
                out[rows.start + at] = _stretch(own[known], stamps[known], stamps[at], half, order, step)
        elif len(known) == len(own):
            out[rows] = _stretch(own, stamps, stamps, half, order, step)
        elif len(known):
            out[rows] = _stretch(own[known], stamps[known], stamps, half, order, step)
    return out


def _stretches(time: Array, run: Integers, reach: float) -> list[slice]:
    steps = np.diff(time)
    breaks = np.flatnonzero((run[1:] != run[:-1]) | (steps < 0.0) | (steps > reach)) + 1
    return [slice(int(a), int(b)) for a, b in pairwise(np.r_[0, breaks, len(time)]) if b > a]


def _stretch(values: Array, known: Array, wanted: Array, half: int, order: int, step: float) -> Array:
    """One stretch: values ``(L, c)`` known at increasing times ``(L,)``, derivatives wanted at times ``(W,)``."""
    length = len(known)
    base = values.mean(axis=0)  # rounding is relative to the size of what is summed
    values = values - base
    out = np.empty((len(wanted), values.shape[1]), order="F")
    known, pieces = _evened(known, step)
    if half >= _MANY and length > 4 * half and _inside(pieces, half) < _SHARE * (length - 2 * half):
        return _through_grid(values, known, wanted, half, order, step) + (base if order == 0 else 0.0)
    if len(wanted) == length:
        place, wanted = np.arange(length), known
    else:
        place = np.minimum(np.searchsorted(known, wanted), length - 1)
        before = np.maximum(place - 1, 0)
        place = np.where(np.abs(known[before] - wanted) < np.abs(known[place] - wanted), before, place)
        exact = np.abs(known[place] - wanted) < 1e-3 * step
        wanted = np.where(exact, known[place], wanted)
    solved = np.zeros(len(wanted), dtype=bool)
    for first, last, even in pieces:  # samples first … last - 1 are evenly spaced
        inside = np.flatnonzero((place >= first + half) & (place < last - half) & (wanted == known[place]))
        if len(inside):
            out[inside] = _convolved(values[first:last], half, order)[place[inside] - first] / even**order
            solved[inside] = True
    rest = np.flatnonzero(~solved)
    window = min(2 * half + 1, length)
    start = np.clip(place[rest] - half, 0, length - window)
    block = max(_BLOCK // window, 1)
    for at in range(0, len(rest), block):
        chosen = slice(at, at + block)
        weights = _weights(known, wanted[rest[chosen]], start[chosen], window, half, order)
        index = start[chosen] + np.arange(window)[:, None]
        # The value at a row itself is taken off first, and with it what rounding makes of a large constant.
        centre = values[place[rest[chosen]]]
        near = values[index] - centre  # (window, B, c)
        out[rest[chosen]] = np.einsum("kb,kbc->bc", weights, near) + (centre if order == 0 else 0.0)
    return out + base if order == 0 else out


def _inside(pieces: list[tuple[int, int, float]], half: int) -> int:
    """How many samples have a whole window of even steps around them."""
    return sum(max(last - first - 2 * half, 0) for first, last, _ in pieces)


def _through_grid(values: Array, known: Array, wanted: Array, half: int, order: int, step: float) -> Array:
    """The same by convolution on even steps, between which and the stamps cubic splines go.

    A spline that goes through the samples is exact for cubics, as the polynomial is; what it makes of noise between
    them is far quicker than a window of many samples lets through. The grid ends where the samples do, so that time
    turned round has the same one, and nothing is extrapolated.
    """
    grid, step = np.linspace(known[0], known[-1], int(np.ceil((known[-1] - known[0]) / step)) + 1, retstep=True)
    even = _stretch(CubicSpline(known, values)(grid), grid, grid, half, order, float(step))
    return np.asarray(CubicSpline(grid, even)(wanted))


def _evened(time: Array, step: float) -> tuple[Array, list[tuple[int, int, float]]]:
    """Stamps with printing taken out, and the pieces (first, last + 1, step) of even steps, between uneven ones."""
    steps = np.diff(time)
    edges = np.r_[0, np.flatnonzero(np.abs(steps - step) > 0.5 * step) + 1, len(time)]
    out, pieces = time.copy(), []
    for first, last in pairwise(edges):
        even = regular_time(time[first:last]) if last - first > 4 else None
        if even is not None:
            out[first:last] = even
            pieces.append((int(first), int(last), float((even[-1] - even[0]) / (len(even) - 1))))
    # Evening the pieces by the digits of their stamps does not reorder them; where it would, stamps stay as they are.
    return (out, pieces) if np.all(np.diff(out) > 0.0) else (time, [])


def _convolved(values: Array, half: int, order: int) -> Array:
    weights = kernel(half, order)
    if half < _LONG:
        return np.asarray(correlate1d(values.T, weights, axis=1, mode="nearest").T)
    return np.asarray(oaconvolve(values, weights[::-1, None], mode="same", axes=0))


def _weights(known: Array, wanted: Array, start: Integers, window: int, half: int, order: int) -> Array:
    """Weights ``(window, B)`` of samples from ``start`` ``(B,)`` on for derivatives at times ``wanted`` ``(B,)``."""
    degree = min(DEGREE, window - 1)
    if order > degree:
        return np.zeros((window, len(wanted)))
    offset = known[start + np.arange(window)[:, None]] - wanted
    reach = (half + 1.0) / half * np.max(np.abs(offset), axis=0)
    reach = np.where(reach > 0.0, reach, 1.0)
    u = offset / reach
    weight = 1.0 - u**2
    moment, product = np.empty((2 * degree + 1, len(wanted))), weight
    for power in range(2 * degree + 1):
        moment[power] = product.sum(axis=0)
        product = product * u
    normal = moment[np.add.outer(np.arange(degree + 1), np.arange(degree + 1))]  # (degree + 1, degree + 1, B)
    unit = np.broadcast_to(np.eye(degree + 1)[:, order, None], (degree + 1, len(wanted)))
    chosen = solve_definite(normal, unit)  # (degree + 1, B)
    polynomial = chosen[-1]
    for power in range(degree - 1, -1, -1):
        polynomial = polynomial * u + chosen[power]
    return np.asarray(factorial(order) * weight * polynomial / reach**order)
