"""Whitened Jacobian columns of candidates, stored as the blocks in which they are not zero.

Columns of pose candidates are often products: a place's derivatives times functions of the row. Where noise is
independent from row to row, they are stored as such. Where readings wander, a whitened number depends on all others.
The filter takes the part T of few directions Q. So sums over whitened columns (1 - QTQ')D follow from those over the
products D and from their shares Q'D, and the table is never formed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import sparse

from clampid.fitting.noise import Whitened
from clampid.fitting.solve import Estimate
from clampid.fitting.wander import Filters
from clampid.stages.rows import Array, Integers

__all__ = [
    "AnyColumns",
    "Columns",
    "Filtered",
    "Levers",
    "Products",
    "Sums",
    "channel_starts",
    "columns_from",
]


@dataclass(frozen=True)
class Sums:
    """Weighted sums over groups of entries, such as the share of each unit in a product with the residual.

    Attributes
    ----------
    matrix
        ``(groups, M)``, one non-zero in each column.
    pieces
        Cache of column ranges of the matrix: hundreds of candidates need the same few.
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
        """The matrix for the entries from ``start`` to ``stop`` only: ``(groups, stop - start)``."""
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

    @property
    def channels(self) -> frozenset[int]:
        """First entries of the channels in which they are not zero."""
        return frozenset(start for start, _ in self.pieces)

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

    def cross(self, other: AnyColumns) -> Array:
        """``(k, k')``: D' D'."""
        if not isinstance(other, Columns):
            return np.asarray(other.cross(self).T)
        out = np.zeros((self.width, other.width))
        theirs = dict(other.pieces)
        for start, block in self.pieces:
            if start in theirs and len(theirs[start]) == len(block):
                out += block.T @ theirs[start]
        return out

    def dense(self, entries: int) -> Array:
        """``(entries, k)``."""
        out = np.zeros((entries, self.width))
        for start, block in self.pieces:
            out[start : start + len(block)] = block
        return out

    def combined(self, weights: Array, entries: int) -> Array:
        """``(entries, f)``: D weights, for weights ``(k, f)``."""
        out = np.zeros((entries, weights.shape[1]))
        for start, block in self.pieces:
            out[start : start + len(block)] = block @ weights
        return out


@dataclass(frozen=True, eq=False)
class Levers:
    """Derivatives of the entries by a deviation at each place.

    Attributes
    ----------
    values
        ``(M, n)``: derivative of each entry, in units of its noise, by a unit deviation at each place.
    entry
        ``(M,)``: the row that each entry belongs to.
    rows
        Number of rows N.
    channels
        First and last + 1 of each channel's entries.
    filters
        Of readings that wander: what takes their level. None where each entry is independent of all others.
    """

    values: Array
    entry: Integers
    rows: int
    channels: tuple[tuple[int, int], ...] = ()
    filters: Filters | None = None

    @staticmethod
    def of(estimate: Estimate, unit: Array) -> Levers:
        """Levers of poses, from the change of the measurement ``(N, m, n)``, SI, by a unit at each place."""
        rows, white = estimate.problem.rows, estimate.whitened
        plain = replace(estimate.noise, level=None).whiten(rows, np.zeros(unit.shape[:2]), unit)
        return Levers(plain.jacobian, plain.entry, len(rows), channel_starts(plain), white.filters)

    def by_row(self, weights: Array) -> Array:
        """Sums ``(N,)`` of weights ``(M,)`` over the entries of each row."""
        return np.asarray(np.bincount(self.entry, weights, minlength=self.rows), dtype=float)

    def times(self, place: int, other: Array, own: slice = slice(None)) -> Array:
        """A place's derivatives times ``other`` ``(m, r)``, summed over the entries of each row: ``(N, r)``.

        ``own``: which entries the m first numbers of ``other`` belong to; by default all.
        """
        values, entry = self.values[own, place], self.entry[own]
        lever = sparse.csr_matrix((values, (entry, np.arange(len(entry)))), shape=(self.rows, len(entry)))
        return np.asarray(lever @ other[: len(entry)])

    def shares(self, place: int) -> Array:
        """The same times the directions of a level that wanders ``(N, R)``."""
        parts = () if self.filters is None else self.filters.parts
        return np.hstack([np.zeros((self.rows, 0)), *(self.times(place, f.directions, own) for own, f in parts)])

    def summed(self, place: int, sums: Sums) -> sparse.csr_matrix:
        """Weighted sums over groups of entries of a place's derivatives, for each row: ``(groups, N)``."""
        count = len(self.entry)
        to_row = sparse.csr_matrix((self.values[:, place], (np.arange(count), self.entry)), shape=(count, self.rows))
        return sums.over(0, count) @ to_row


@dataclass(frozen=True)
class Products:
    """Whitened columns ``(M, k)`` that are products of a place's levers and functions of the row, place after place.

    A place's columns are D = diag(lever) F. F is the same for all entries of a row, so sums over entries are formed
    once for each row and not once for each column, and the dense table is never formed.

    Attributes
    ----------
    places
        Column numbers in ``levers.values``.
    functions
        For each place its functions in each row ``(N, f)``.
    """

    levers: Levers
    places: tuple[int, ...]
    functions: tuple[Array, ...]

    @property
    def channels(self) -> frozenset[int]:
        """First entries of the channels in which they may not be zero."""
        return frozenset(start for start, _ in self.levers.channels)

    @property
    def whitened(self) -> Products | Filtered:
        """The columns as they are whitened: themselves where each entry is independent."""
        return self if self.levers.filters is None else Filtered(self, self.levers.filters)

    @property
    def width(self) -> int:
        """Number of columns."""
        return sum(F.shape[1] for F in self.functions)

    @property
    def placed(self) -> list[tuple[int, Array, slice]]:
        """Each place with its functions ``(N, f)`` and the range of its columns."""
        starts = np.cumsum([0, *(F.shape[1] for F in self.functions)]).tolist()
        own = [slice(*both) for both in pairwise(starts)]
        return list(zip(self.places, self.functions, own, strict=True))

    def gram(self) -> Array:
        """``(k, k)``: D'D."""
        out, lever = np.zeros((self.width, self.width)), self.levers.values
        for number, (i, F, mine) in enumerate(self.placed):
            for j, G, theirs in self.placed[number:]:
                block = (F * self.levers.by_row(lever[:, i] * lever[:, j])[:, None]).T @ G
                out[mine, theirs], out[theirs, mine] = block, block.T
        return out

    def times(self, other: Array) -> Array:
        """``(k, …)``: D' other, from the first M entries of ``other``."""
        if other.ndim == 1:
            row = [self.levers.by_row(self.levers.values[:, i] * other[: len(self.levers.entry)]) for i in self.places]
            return np.concatenate([F.T @ sums for F, sums in zip(self.functions, row, strict=True)])
        return np.concatenate([F.T @ self.levers.times(i, other) for i, F, _ in self.placed])

    def cross(self, other: AnyColumns) -> Array:
        """``(k, k')``: D' D'."""
        return self.times(other.dense(len(self.levers.entry)))

    def dense(self, entries: int) -> Array:
        """``(entries, k)``."""
        out, entry = np.zeros((entries, self.width)), self.levers.entry
        for i, F, mine in self.placed:
            out[: len(entry), mine] = F[entry] * self.levers.values[:, i, None]
        return out

    def combined(self, weights: Array, entries: int) -> Array:
        """``(entries, f)``: D weights, for weights ``(k, f)``."""
        out, entry = np.zeros((entries, weights.shape[1])), self.levers.entry
        for i, F, mine in self.placed:
            out[: len(entry)] += (F @ weights[mine])[entry] * self.levers.values[:, i, None]
        return out


@dataclass(frozen=True, eq=False)
class Filtered:
    """Whitened columns (1 - QTQ')D ``(M, k)`` of readings that wander, from the products D and their shares Q'D."""

    products: Products
    filters: Filters

    @cached_property
    def shares(self) -> Array:
        """``(k, R)``: D'Q. :class:`clampid.evidence.joined.Joined` computes those of many candidates at once."""
        return np.concatenate([F.T @ self.products.levers.shares(place) for place, F, _ in self.products.placed])

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.products.width

    @property
    def channels(self) -> frozenset[int]:
        """First entries of the channels in which they may not be zero."""
        return self.products.channels

    def gram(self) -> Array:
        """``(k, k)``: D'(1 - QTQ')²D."""
        taken = self.filters.taken
        return np.asarray(self.products.gram() - (self.shares * (2.0 - taken) * taken) @ self.shares.T)

    def times(self, other: Array) -> Array:
        """``(k, …)``: D'(1 - QTQ') other, for other ``(M, …)``."""
        return np.asarray(self.products.times(other) - (self.shares * self.filters.taken) @ self.filters.shares(other))

    def cross(self, other: AnyColumns) -> Array:
        """``(k, k')``: D'(1 - QTQ') times the other columns."""
        return self.times(other.dense(len(self.products.levers.entry)))

    def dense(self, entries: int) -> Array:
        """``(entries, k)``."""
        out = self.products.dense(entries)
        self.filters(out[: len(self.products.levers.entry)])
        return out

    def combined(self, weights: Array, entries: int) -> Array:
        """``(entries, f)``: the columns times weights ``(k, f)``."""
        out = self.products.combined(weights, entries)
        self.filters(out[: len(self.products.levers.entry)])
        return out


AnyColumns = Columns | Products | Filtered


def channel_starts(white: Whitened) -> tuple[tuple[int, int], ...]:
    """(first, last + 1) of each channel's entries; entries are ordered by channel."""
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
