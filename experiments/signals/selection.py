"""Exact medians of streams that are too long for memory: the bits of the result are found sixteen at a time.

A float64 read as an integer (its sign taken care of) has the order of the float, so that counting leading bits finds
the leading bits of any order statistic; what shares its first sixteen is mostly little enough to be sorted. Source:
Knuth, The Art of Computer Programming 3, section 5.2.5 (radix), as selection.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from experiments.signals.typing_ import Array

__all__ = ["medians"]

_BITS = 16
_CAPACITY = 1 << 22  # numbers that are simply kept and sorted

Keys = npt.NDArray[np.uint64]
Counts = npt.NDArray[np.int64]
Stream = Callable[[], Iterator[Sequence[Array]]]


def medians(stream: Stream, capacity: int = _CAPACITY) -> Array:
    """Medians of several quantities of a stream, as `numpy.median` gives them.

    Parameters
    ----------
    stream
        Gives, each time it is called, the same pieces one after the other: of every quantity a vector of any length.
        A short stream is gone through once, a long one mostly twice; four times where its numbers are all alike.
    capacity
        How many numbers may be kept; of a longer stream, counts, until what is left of it can be.

    Returns
    -------
    Array
        One median per quantity; NaN where there are no numbers.
    """
    pieces: list[list[Array]] = []
    counts: list[Counts] = []
    total = 0
    for piece in stream():
        pieces.append([np.array(p, dtype=np.float64) for p in piece])
        total += sum(len(p) for p in piece)
        if total > capacity:
            for waiting in pieces:
                new = [_digits(_key(values), 48) for values in waiting]
                counts = [old + more for old, more in zip(counts, new, strict=True)] if counts else new
            pieces = []
    if total <= capacity:
        columns = [np.concatenate(parts) for parts in zip(*pieces, strict=True)]
        return np.array([_median(c) for c in columns])
    return _narrowed(stream, [_Middle.both_of(count) for count in counts], capacity)


def _median(values: Array) -> float:
    """As `numpy.median`, which looks for both middle numbers and for NaN one by one, and takes eight times as long."""
    if not len(values):
        return np.nan
    middle = len(values) // 2
    ordered = np.partition(values, middle)
    if np.isnan(ordered[middle:].max()):  # NaN is the last of all
        return np.nan
    return float(ordered[middle] if len(values) % 2 else 0.5 * (ordered[:middle].max() + ordered[middle]))


@dataclass
class _Middle:
    """One of the middle two numbers of a quantity: its leading bits so far, and its rank among those that share them.

    Attributes
    ----------
    left
        How many numbers share these bits.
    shift
        How many bits are not known yet.
    """

    prefix: int
    rank: int
    left: int
    shift: int

    @staticmethod
    def both_of(count: Counts) -> tuple[_Middle, ...]:
        """Lower and upper middle, from the counts of the first digit; none where there are no numbers."""
        total = int(count.sum())
        both = (_Middle(0, (total - 1) // 2, total, 64), _Middle(0, total // 2, total, 64)) if total else ()
        for middle in both:
            middle.narrow(count)
        return both

    def narrow(self, count: Counts) -> None:
        """Append the digit that the counts of the next one lead to."""
        cumulated = np.cumsum(count)
        digit = int(np.searchsorted(cumulated, self.rank, side="right"))
        self.rank -= int(cumulated[digit] - count[digit])
        self.prefix, self.left, self.shift = (self.prefix << _BITS) | digit, int(count[digit]), self.shift - _BITS

    def settle(self, sharing: Keys) -> None:
        """Find it among all numbers that share its bits."""
        self.prefix, self.rank, self.left, self.shift = int(np.partition(sharing, self.rank)[self.rank]), 0, 1, 0


def _narrowed(stream: Stream, middles: list[tuple[_Middle, ...]], capacity: int) -> Array:
    """Medians, once the first digits are known: digit by digit, until what shares those found can be kept."""
    while wanted := [m for both in middles for m in both if m.shift]:
        few = capacity // len(wanted)
        sharing: dict[int, list[Keys]] = {id(m): [] for m in wanted if m.left <= few}
        counts = {id(m): np.zeros(1 << _BITS, dtype=np.int64) for m in wanted if m.left > few}
        for piece in stream():
            for values, both in zip(piece, middles, strict=True):
                if not any(m.shift for m in both):
                    continue
                keys = _key(values)
                for m in (m for m in both if m.shift):
                    inside = keys[keys >> np.uint64(m.shift) == np.uint64(m.prefix)]
                    if m.left <= few:
                        sharing[id(m)].append(inside)
                    else:
                        counts[id(m)] += _digits(inside, m.shift - _BITS)
        for m in wanted:
            if id(m) in sharing:
                m.settle(np.concatenate(sharing[id(m)]))
            else:
                m.narrow(counts[id(m)])
    return np.array([np.mean([_float(m.prefix) for m in both]) if both else np.nan for both in middles])


def _digits(keys: Keys, shift: int) -> Counts:
    """How often each digit of sixteen bits occurs, ``shift`` bits from the end."""
    digit = (keys >> np.uint64(shift)) & np.uint64((1 << _BITS) - 1)
    return np.bincount(digit.astype(np.int64), minlength=1 << _BITS)


def _key(values: Array) -> Keys:
    bits = np.ascontiguousarray(values, dtype=np.float64).view(np.int64)
    ordered = bits ^ ((bits >> 63) & np.int64(0x7FFF_FFFF_FFFF_FFFF))
    return np.asarray(ordered.view(np.uint64) ^ np.uint64(1 << 63))


def _float(key: int) -> float:
    bits = np.array([key ^ (1 << 63)], dtype=np.uint64).view(np.int64)
    return float((bits ^ ((bits >> 63) & np.int64(0x7FFF_FFFF_FFFF_FFFF))).view(np.float64)[0])
