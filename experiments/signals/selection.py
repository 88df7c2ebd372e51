"""Exact medians of streams that are too long to be held: the bits of the answer are found sixteen at a time.

A float64 read as an integer (its sign taken care of) has the order of the float, so that counting leading bits finds
the leading bits of any order statistic; four passes find all. Source: Knuth, The Art of Computer Programming 3, section
5.2.5 (radix), as selection.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from experiments.signals.typing_ import Array

__all__ = ["medians"]

_BITS = 16
_HELD = 1 << 22  # numbers that are simply held and sorted

Stream = Callable[[], Iterator[Sequence[Array]]]


def medians(stream: Stream, held: int = _HELD) -> Array:
    """Medians of several quantities of a stream, as `numpy.median` gives them.

    Parameters
    ----------
    stream
        Gives, each time it is called, the same pieces one after the other: of every quantity a vector of any length.
    held
        How many numbers may be held; of a longer stream, counts only.

    Returns
    -------
    Array
        One median per quantity; NaN where there are no numbers.
    """
    pieces: list[list[Array]] = []
    total = 0
    for piece in stream():
        pieces.append([np.array(p, dtype=np.float64) for p in piece])
        total += sum(len(p) for p in piece)
        if total > held:
            return _counted(stream)
    columns = [np.concatenate(parts) for parts in zip(*pieces, strict=True)]
    return np.array([np.median(c) if len(c) else np.nan for c in columns])


def _counted(stream: Stream) -> Array:
    prefixes: list[list[int]] = []
    ranks: list[list[int]] = []
    for shift in (48, 32, 16, 0):
        counts: list[list[Array]] = []
        for piece in stream():
            keys = [_key(p) for p in piece]
            if not counts:
                prefixes = prefixes or [[0] for _ in keys]
                counts = [[np.zeros(1 << _BITS, dtype=np.int64) for _ in p] for p in prefixes]
            for k, key in enumerate(keys):
                for i, prefix in enumerate(prefixes[k]):
                    inside = key if shift == 48 else key[(key >> np.uint64(shift + _BITS)) == np.uint64(prefix)]
                    digit = (inside >> np.uint64(shift)) & np.uint64((1 << _BITS) - 1)
                    counts[k][i] += np.bincount(digit.astype(np.int64), minlength=1 << _BITS)
        if shift == 48:  # both of the middle two
            totals = [int(c[0].sum()) for c in counts]
            ranks = [[max(t - 1, 0) // 2, t // 2] for t in totals]
            counts, prefixes = [[c[0], c[0]] for c in counts], [[0, 0] for _ in counts]
        for k, both in enumerate(counts):
            for i, count in enumerate(both):
                cumulated = np.cumsum(count)
                digit_found = min(int(np.searchsorted(cumulated, ranks[k][i], side="right")), len(count) - 1)
                ranks[k][i] -= int(cumulated[digit_found] - count[digit_found])
                prefixes[k][i] = (prefixes[k][i] << _BITS) | digit_found
    middle = [0.5 * (_float(a) + _float(b)) for a, b in prefixes]
    return np.array([m if t else np.nan for m, t in zip(middle, totals, strict=True)])


def _key(values: Array) -> np.ndarray[tuple[int], np.dtype[np.uint64]]:
    bits = np.ascontiguousarray(values, dtype=np.float64).view(np.int64)
    ordered = bits ^ ((bits >> 63) & np.int64(0x7FFF_FFFF_FFFF_FFFF))
    return np.asarray(ordered.view(np.uint64) ^ np.uint64(1 << 63))


def _float(key: int) -> float:
    bits = np.array([key ^ (1 << 63)], dtype=np.uint64).view(np.int64)
    return float((bits ^ ((bits >> 63) & np.int64(0x7FFF_FFFF_FFFF_FFFF))).view(np.float64)[0])
