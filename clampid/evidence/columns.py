"""Columns of the table of rows and effects, kept as the blocks in which they are not zero."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from clampid.fitting.noise import Whitened
from clampid.stages.rows import Array, Integers

__all__ = ["Columns", "Products", "Sums", "channel_starts", "columns_from"]


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


@dataclass(frozen=True)
class Products:
    """Whitened columns ``(M, n f)`` that are products of a lever and functions of each row: every place's in turn.

    A place's columns are D = diag(lever) F, F the same for all entries of a row, so that sums over entries are taken
    once a row and not once a column: of hundreds of columns the table itself is never written down.

    Attributes
    ----------
    lever
        ``(M, n)``: what a unit at each place does to each whitened entry.
    entry
        ``(M,)``: the row that each entry came from.
    functions
        ``(n, N, f)``: the functions of each place in each row.
    """

    lever: Array
    entry: Integers
    functions: Array

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(self.functions.shape[0] * self.functions.shape[2])

    def _by_row(self, weights: Array) -> Array:
        """Sums ``(N,)`` of weights ``(M,)`` over the entries of each row."""
        return np.asarray(np.bincount(self.entry, weights, minlength=self.functions.shape[1]), dtype=float)

    def gram(self) -> Array:
        """``(k, k)``: D'D."""
        n, _, f = self.functions.shape
        out = np.zeros((n, f, n, f))
        for i in range(n):
            for j in range(i, n):
                weight = self._by_row(self.lever[:, i] * self.lever[:, j])
                block = (self.functions[i] * weight[:, None]).T @ self.functions[j]
                out[i, :, j], out[j, :, i] = block, block.T
        return out.reshape(self.width, self.width)

    def times(self, other: Array) -> Array:
        """``(k, …)``: D' other, for other ``(M, …)``, of which only the first M entries count."""
        flat = other[: len(self.entry)].reshape(len(self.entry), -1)
        selector = sparse.csr_matrix(
            (np.ones(len(self.entry)), (self.entry, np.arange(len(self.entry)))),
            shape=(self.functions.shape[1], len(self.entry)),
        )
        parts = [
            F.T @ (selector @ (flat * lever[:, None])) for F, lever in zip(self.functions, self.lever.T, strict=True)
        ]
        return np.concatenate(parts).reshape(self.width, *other.shape[1:])

    def cross(self, other: Columns | Products) -> Array:
        """``(k, k')``: D' D'."""
        return self.times(other.dense(len(self.entry)))

    def summed(self, sums: Sums) -> Array:
        """``(groups, k)``: weighted sums of the columns over groups of entries."""
        count, used = self.functions.shape[1], sums.over(0, len(self.entry))
        parts = []
        for F, lever in zip(self.functions, self.lever.T, strict=True):
            to_row = sparse.csr_matrix(
                (lever, (np.arange(len(self.entry)), self.entry)), shape=(len(self.entry), count)
            )
            parts.append((used @ to_row) @ F)
        return np.hstack(parts)

    def dense(self, entries: int) -> Array:
        """``(entries, k)``."""
        out = np.zeros((entries, self.width))
        parts = [F[self.entry] * lever[:, None] for F, lever in zip(self.functions, self.lever.T, strict=True)]
        out[: len(self.entry)] = np.hstack(parts)
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
