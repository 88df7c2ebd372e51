r"""The length of the window for derivatives, chosen from the spectra of motion and noise.

With G(ω) the filter's response divided by (iω)^ν, motion of spectrum S and white noise N (both of the log itself), the
mean squared error of the ν-th derivative is Σ_ω ω^{2ν} [(1 - G)² S + G² N]: the blur of the window, and the noise that
passes it. N is what the log's spectrum P ends in at the top of its band, and S = P - N below the first frequency at
which P falls to 2N, that is S to N; beyond, nothing is taken for motion (Wiener's rule: there even the best filter's
gain is below one half). The window chosen is the one with the smallest sum over joints of that error, as a share of
the joint's Σ ω^{2ν} S: one filter for all joints, since it has to commute with equations that couple them.

A log without visible noise (its spectrum still falls at the top of the band) gets the shortest window. Source of the
principle: Wiener, Extrapolation, Interpolation, and Smoothing of Stationary Time Series (1949).
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from experiments.signals.clock import typical_step
from experiments.signals.polynomial import kernel, smallest_half
from experiments.signals.typing_ import Array, Integers

__all__ = ["choose_window"]

# Shorter than this, a stretch has no spectrum worth the name.
_SHORTEST_STRETCH = 64
_LONGEST_BLOCK = 4096
# The top eighth of the band holds noise, if anything does; below 2N there is more noise than motion.
_TOP = 8
# Windows on a grid this fine miss the best error by less than a per cent, near its flat minimum.
_RATIO = 1.15
_BANDS = 60


def choose_window(values: Array, time: Array, run: Integers, order: int = 1) -> float:
    """Choose the window [s] for a derivative of a log's columns.

    Parameters
    ----------
    values
        Columns ``(N, c)``, such as positions.
    time
        Stamps ``(N,)`` [s].
    run
        Numbers of the runs ``(N,)``.
    order
        Which derivative will be taken: 0, 1 or 2.

    Returns
    -------
    float
        Length of the window [s], from first to last sample; four steps at least. Logs whose runs have fewer than 64
        rows get that.
    """
    step = typical_step(time, run)
    shortest = 2.0 * smallest_half() * step
    spectra = _spectrum(values, time, run, step)
    if spectra is None:
        return shortest
    omega, density = spectra  # (f,) [rad per sample], (f, c)
    noise = density[-max(len(omega) // _TOP, 1) :].mean(axis=0)
    edges = np.unique(np.round(np.geomspace(1, len(omega), _BANDS)).astype(int)) - 1
    edges = np.r_[edges[:-1], len(omega)]
    width = np.diff(edges)
    centre = np.add.reduceat(omega, edges[:-1]) / width
    band = np.add.reduceat(density, edges[:-1], axis=0) / width[:, None]
    quiet = np.cumsum(band < 2.0 * noise, axis=0) > 0  # from the first band on in which noise prevails
    motion = np.where(quiet, 0.0, np.maximum(band - noise, 0.0))
    weight = (width * centre ** (2 * order))[:, None]
    total = np.sum(weight * motion, axis=0)
    moved = (total > 0.0) & (noise > 0.0)
    if not moved.any():
        return shortest
    longest = max(_block(values, run) // 4, smallest_half())
    halves = np.unique(np.round(np.geomspace(smallest_half(), longest, _count(longest))).astype(int))
    errors = []
    for half in halves:
        gain = _gain(int(half), order, centre)[:, None]
        error = np.sum(weight * ((1.0 - gain) ** 2 * motion + gain**2 * noise), axis=0)
        errors.append(np.sum(error[moved] / total[moved]))
    return float(2 * halves[int(np.argmin(errors))] * step)


def _count(longest: int) -> int:
    return max(int(np.ceil(np.log(longest / smallest_half()) / np.log(_RATIO))) + 1, 1)


def _gain(half: int, order: int, omega: Array) -> Array:
    """Response of the filter over that of the ideal derivative, at angular frequencies ``(f,)`` per sample."""
    offset = np.arange(1, half + 1)
    right = kernel(half, order)[half:]
    angle = omega[:, None] * offset
    if order % 2:
        return np.asarray(2.0 * np.sin(angle) @ right[1:] / omega)
    return np.asarray((right[0] + 2.0 * np.cos(angle) @ right[1:]) * (-1.0 if order == 2 else 1.0) / omega**order)


def _block(values: Array, run: Integers) -> int:
    """Length of the blocks that spectra are averaged over: at least eight in the longest run, a power of two."""
    longest = int(np.max(np.diff(np.r_[0, np.flatnonzero(run[1:] != run[:-1]) + 1, len(values)])))
    return int(min(_LONGEST_BLOCK, 2 ** int(np.log2(max(longest / 4, 1)))))


def _spectrum(values: Array, time: Array, run: Integers, step: float) -> tuple[Array, Array] | None:
    """Spectrum of the log, averaged over blocks of its runs: frequencies ``(f,)`` and densities ``(f, c)``.

    Taken of second differences and divided by their response: positions fall so steeply towards high frequencies that
    the sides of any window would hide their noise. Logs of uneven steps are interpolated by cubic splines first.
    """
    length = _block(values, run)
    if length < _SHORTEST_STRETCH // 4:
        return None
    breaks = np.flatnonzero((run[1:] != run[:-1]) | (np.diff(time) < 0.0)) + 1
    taper = np.hanning(length + 2)[1:-1]
    total, count = np.zeros((length // 2 + 1, values.shape[1])), 0
    for stamps, piece in zip(np.split(time, breaks), np.split(values, breaks), strict=True):
        bent = np.diff(_even(stamps, piece, step), 2, axis=0)
        starts = np.arange(0, len(bent) - length + 1, length // 2)
        for start in starts:
            total += np.abs(np.fft.rfft(taper[:, None] * bent[start : start + length], axis=0)) ** 2
        count += len(starts)
    if count < 4:
        return None
    omega = 2.0 * np.pi * np.arange(length // 2 + 1) / length
    keep = slice(2, length // 2)  # the lowest two are the taper's own width
    response = (2.0 * np.sin(omega[keep] / 2.0)) ** 4
    return omega[keep], total[keep] / (count * np.sum(taper**2)) / response[:, None]


def _even(time: Array, values: Array, step: float) -> Array:
    """Columns ``(L, c)`` at even steps; as they are where the stamps are even, gaps aside."""
    steps = np.diff(time)
    uneven = np.abs(steps - step) > 0.01 * step
    # A few gaps do not touch most blocks; a clock that is uneven throughout would look like noise of the positions.
    if uneven.mean() < 0.01 if len(steps) else True:
        return values
    fresh = np.r_[True, steps > 0.0]
    grid = np.arange(time[0], time[-1], step)
    return np.asarray(CubicSpline(time[fresh], values[fresh])(grid))
