"""Columns of the table of rows and effects, kept as the blocks in which they are not zero."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy import sparse

from clampid.fitting.noise import Whitened
from clampid.stages.rows import Array, Integers

__all__ = ["Columns", "Levers", "Products", "Sums", "channel_starts", "columns_from"]

FEWEST_SUMMED_FUNCTIONS = 8  # functions, below which they are not worth sums over the entries of each row


@dataclass(frozen=True)
class Sums:
    """Weighted sums over groups of entries, such as what each unit adds to a product with the residual.

    Attributes
    ----------
    matrix
        ``(groups, M)``, an entry in each column.
    pieces
        Parts of it for some of the entries: hundreds of candidates ask for the same few.
    """

    matrix: sparse.csc_matrix
    pieces: dict[tuple[int, int], sparse.csr_matrix] = field(default_factory=dict)

    @staticmethod
    def of(group: Integers, weights: Array) -> Sums:
        """Sums with weights ``(M,)`` over the entries of each group ``(M,)``, numbered from 0."""
        shape = (int(group.max(initial=-1)) + 1, len(group))
        return Sums(sparse.csc_matrix((weights, (group, np.arange(len(group)))), shape=shape))

    @property
    def groups(self) -> int:
        """How many groups there are."""
        return int(self.matrix.shape[0])

    def over(self, start: int, stop: int) -> sparse.csr_matrix:
        """``(groups, stop - start)``: of the entries from start to stop alone."""
        key = (start, stop)
        if key not in self.pieces:
            self.pieces[key] = self.matrix[:, start:stop].tocsr()
        return self.pieces[key]


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

    def cross(self, other: Columns | Products) -> Array:
        """``(k, k')``: D' D'."""
        if isinstance(other, Products):
            return np.asarray(other.cross(self).T)
        out = np.zeros((self.width, other.width))
        theirs = dict(other.pieces)
        for start, block in self.pieces:
            if start in theirs and len(theirs[start]) == len(block):
                out += block.T @ theirs[start]
        return out

    def summed(self, sums: Sums) -> Array:
        """``(groups, k)``: weighted sums of the columns over groups of entries."""
        out = np.zeros((sums.groups, self.width))
        for start, block in self.pieces:
            out += sums.over(start, start + len(block)) @ block
        return out

    def dense(self, entries: int) -> Array:
        """``(entries, k)``."""
        out = np.zeros((entries, self.width))
        for start, block in self.pieces:
            out[start : start + len(block)] = block
        return out


@dataclass(frozen=True, eq=False)
class Levers:
    """What a unit at each of some places does to each whitened entry ``(M, n)``; ``entry`` ``(M,)``: the row it is of.

    Candidates of one place share its sums over the entries of each row, of which the last are kept.
    """

    values: Array
    entry: Integers
    rows: int
    last: dict[int, tuple[object, Array]] = field(default_factory=dict, repr=False)

    def by_row(self, weights: Array) -> Array:
        """Sums ``(N,)`` of weights ``(M,)`` over the entries of each row."""
        return np.asarray(np.bincount(self.entry, weights, minlength=self.rows), dtype=float)

    def times(self, place: int, functions: Array, other: Array) -> Array:
        """``(f, r)``: a place's lever times functions ``(N, f)`` of each row, times other ``(M, r)``."""
        known = place in self.last and self.last[place][0] is other
        if not known and functions.shape[1] < FEWEST_SUMMED_FUNCTIONS:
            lines = np.take(functions.T, self.entry, axis=1) * self.values[:, place]
            return np.asarray(lines @ other[: len(self.entry)])
        return np.asarray(functions.T @ self._times(place, other))

    def _times(self, place: int, other: Array) -> Array:
        """``(N, r)``: a place's lever times other ``(M, r)``, summed over the entries of each row."""
        if place not in self.last or self.last[place][0] is not other:
            out = np.zeros((self.rows, other.shape[1]))
            for mine in np.split(np.arange(len(self.entry)), np.flatnonzero(np.diff(self.entry) <= 0) + 1):
                out[self.entry[mine]] += other[mine] * self.values[mine, place, None]  # each row once at most
            self.last.clear()  # others' places are done: of one with hundreds of columns these are 20 MB
            self.last[place] = other, out
        return self.last[place][1]

    def summed(self, place: int, sums: Sums) -> sparse.csr_matrix:
        """``(groups, N)``: a place's lever, by weighted sums over groups of entries, for each row."""
        count = len(self.entry)
        to_row = sparse.csr_matrix((self.values[:, place], (np.arange(count), self.entry)), shape=(count, self.rows))
        return sums.over(0, count) @ to_row


@dataclass(frozen=True)
class Products:
    """Whitened columns ``(M, k)`` that are products of a lever and functions of each row: every place's in turn.

    A place's columns are D = diag(lever) F, F the same for all entries of a row, so that sums over entries are taken
    once a row and not once a column: of hundreds of columns the table itself is never written down.

    Attributes
    ----------
    places
        Those of the levers.
    functions
        ``(N, f)`` of each place: its functions in each row.
    """

    levers: Levers
    places: tuple[int, ...]
    functions: tuple[Array, ...]

    @property
    def width(self) -> int:
        """Number of columns."""
        return sum(F.shape[1] for F in self.functions)

    @property
    def _placed(self) -> list[tuple[int, Array, slice]]:
        """The places, the functions of each, and where their columns stand."""
        starts = np.cumsum([0, *(F.shape[1] for F in self.functions)]).tolist()
        own = [slice(*both) for both in pairwise(starts)]
        return list(zip(self.places, self.functions, own, strict=True))

    def gram(self) -> Array:
        """``(k, k)``: D'D."""
        out, lever = np.zeros((self.width, self.width)), self.levers.values
        for number, (i, F, mine) in enumerate(self._placed):
            for j, G, theirs in self._placed[number:]:
                block = (F * self.levers.by_row(lever[:, i] * lever[:, j])[:, None]).T @ G
                out[mine, theirs], out[theirs, mine] = block, block.T
        return out

    def times(self, other: Array) -> Array:
        """``(k, …)``: D' other, for other ``(M, …)``, of which only the first M entries count."""
        if other.ndim == 1:
            row = [self.levers.by_row(self.levers.values[:, i] * other[: len(self.levers.entry)]) for i in self.places]
            return np.concatenate([F.T @ sums for F, sums in zip(self.functions, row, strict=True)])
        return np.concatenate([self.levers.times(i, F, other) for i, F, _ in self._placed])

    def cross(self, other: Columns | Products) -> Array:
        """``(k, k')``: D' D'."""
        return self.times(other.dense(len(self.levers.entry)))

    def summed(self, sums: Sums) -> Array:
        """``(groups, k)``: weighted sums of the columns over groups of entries."""
        return np.hstack([self.levers.summed(i, sums) @ F for i, F, _ in self._placed])

    def dense(self, entries: int) -> Array:
        """``(entries, k)``."""
        out, entry = np.zeros((entries, self.width)), self.levers.entry
        for i, F, mine in self._placed:
            out[: len(entry), mine] = F[entry] * self.levers.values[:, i, None]
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
