"""Columns of the table of rows and effects, kept as the blocks in which they are not zero."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from clampid.noise import Whitened
from clampid.stages.rows import Array, Integers

__all__ = ["Columns", "channel_starts", "columns_from"]


@dataclass(frozen=True)
class Columns:
    """Whitened columns ``(M, k)``, stored where they are not zero.

    Attributes
    ----------
    pieces
        (first entry, block ``(L, k)``), ascending, not overlapping.
    """

    pieces: tuple[tuple[int, Array], ...]
    width: int

    def gram(self) -> Array:
        """``(k, k)``: D'D."""
        out = np.zeros((self.width, self.width))
        for _, block in self.pieces:
            out += block.T @ block
        return out

    def times(self, other: Array) -> Array:
        """``(k, …)``: D' other, for other ``(M, …)``."""
        out = np.zeros((self.width, *other.shape[1:]))
        for start, block in self.pieces:
            out += block.T @ other[start : start + len(block)]
        return out

    def cross(self, other: Columns) -> Array:
        """``(k, k')``: D' D'."""
        out = np.zeros((self.width, other.width))
        theirs = dict(other.pieces)
        for start, block in self.pieces:
            if start in theirs and len(theirs[start]) == len(block):
                out += block.T @ theirs[start]
        return out

    def summed(self, by_unit: sparse.csc_matrix) -> Array:
        """``(units, k)``: ``by_unit @ D`` for a sparse ``(units, M…)``."""
        out = np.zeros((by_unit.shape[0], self.width))
        for start, block in self.pieces:
            out += by_unit[:, start : start + len(block)] @ block
        return out

    def dense(self, entries: int) -> Array:
        """``(entries, k)``."""
        out = np.zeros((entries, self.width))
        for start, block in self.pieces:
            out[start : start + len(block)] = block
        return out


def channel_starts(white: Whitened) -> tuple[tuple[int, int], ...]:
    """(first, last + 1) of each channel's entries; entries stand channel by channel."""
    if not len(white.channel):
        return ()
    edges = np.flatnonzero(np.diff(white.channel)) + 1
    return tuple(zip([0, *edges.tolist()], [*edges.tolist(), len(white.channel)], strict=True))


def columns_from(white: Whitened, chosen: Integers | list[int]) -> Columns:
    """The chosen columns of a whitened Jacobian."""
    pieces = []
    for start, stop in channel_starts(white):
        block = white.jacobian[start:stop][:, chosen]
        if np.any(block):
            pieces.append((start, np.ascontiguousarray(block)))
    return Columns(tuple(pieces), len(chosen))
