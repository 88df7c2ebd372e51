"""Whitened Jacobian columns of candidates, stored as the blocks in which they are not zero.

Columns of pose candidates are often products: a place's derivatives times functions of the row. Where noise is
independent from row to row, they are stored as such. Where readings wander, a whitened number depends on the rows
before it as well, so products are formed first and whitened then.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby, pairwise

import numpy as np
from scipy import sparse

from clampid.fitting.noise import Whitened
from clampid.fitting.solve import Estimate
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
    "tables_of",
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
        if isinstance(other, Products):
            return np.asarray(other.cross(self).T)
        if isinstance(other, Filtered):
            return self.cross(other.table)
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
    without_level
        Of readings that wander: turns columns ``(M, k)``, in place, into their whitened ones. None where each entry is
        independent of all others.
    """

    values: Array
    entry: Integers
    rows: int
    channels: tuple[tuple[int, int], ...] = ()
    without_level: Callable[[Array], Array] | None = None

    @staticmethod
    def of(estimate: Estimate, unit: Array) -> Levers:
        """Levers of poses, from the change of the measurement ``(N, m, n)``, SI, by a unit at each place."""
        rows, noise = estimate.problem.rows, estimate.noise
        plain = replace(noise, level=None).whiten(rows, np.zeros(unit.shape[:2]), unit)
        without_level = noise.without_level(rows, plain.entry, plain.channel)
        return Levers(plain.jacobian, plain.entry, len(rows), channel_starts(plain), without_level)

    def by_row(self, weights: Array) -> Array:
        """Sums ``(N,)`` of weights ``(M,)`` over the entries of each row."""
        return np.asarray(np.bincount(self.entry, weights, minlength=self.rows), dtype=float)

    def times(self, place: int, other: Array) -> Array:
        """A place's derivatives times ``other`` ``(M, r)``, summed over the entries of each row: ``(N, r)``."""
        count = len(self.entry)
        lever = sparse.csr_matrix((self.values[:, place], (self.entry, np.arange(count))), shape=(self.rows, count))
        return np.asarray(lever @ other[:count])

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
        return self if self.levers.without_level is None else Filtered(self)

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


@dataclass(frozen=True, eq=False)
class Filtered:
    """Whitened columns ``(M, k)`` of readings that wander: products that are filtered each time they are used.

    The tables of all that may be missing would take gigabytes.
    """

    products: Products

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.products.width

    @property
    def channels(self) -> frozenset[int]:
        """First entries of the channels in which they may not be zero."""
        return self.products.channels

    @property
    def table(self) -> Columns:
        """The columns, filtered."""
        return tables_of([self])[0]

    def gram(self) -> Array:
        """``(k, k)``: D'D."""
        return self.table.gram()

    def times(self, other: Array) -> Array:
        """``(k, …)``: D' other, for other ``(M, …)``."""
        return self.table.times(other)

    def cross(self, other: AnyColumns) -> Array:
        """``(k, k')``: D' D'."""
        return self.table.cross(other)

    def dense(self, entries: int) -> Array:
        """``(entries, k)``."""
        return self.table.dense(entries)


AnyColumns = Columns | Products | Filtered


def tables_of(members: Sequence[Filtered]) -> list[Columns]:
    """The tables of several, each of those of one place filtered together."""
    out = list[Columns]()
    for levers, run in groupby((m.products for m in members), key=lambda p: p.levers):
        own = list(run)
        whole = np.hstack([p.dense(len(levers.entry)) for p in own])
        whole = whole if levers.without_level is None else levers.without_level(whole)
        each = np.split(whole, np.cumsum([p.width for p in own], dtype=int)[:-1], axis=1)
        out += [Columns(tuple((a, block[a:b]) for a, b in levers.channels), block.shape[1]) for block in each]
    return out


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
