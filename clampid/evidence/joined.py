"""Products of the columns of many candidates at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

import numpy as np
from scipy import sparse

from clampid.evidence.columns import AnyColumns, Columns, Filtered, Levers, Products, Sums, tables_of
from clampid.stages.rows import Array, Integers

__all__ = ["Joined"]

MOST_JOINED_COLUMNS = 128  # columns that share a matrix product: more saves no time and needs more memory


@dataclass(frozen=True)
class Joined:
    """The columns of many candidates side by side, K in all, so that each matrix product serves many of them.

    A table of hundreds of megabytes is then read once, not once for each candidate.
    """

    members: Sequence[AnyColumns]

    @property
    def held(self) -> list[Columns | Products]:
        """The members with tables instead of what is filtered each time it is used."""
        tables = iter(tables_of([m for m in self.members if isinstance(m, Filtered)]))
        return [next(tables) if isinstance(m, Filtered) else m for m in self.members]

    def times(self, other: Array) -> Array:
        """``(K, r)``: D' other, from the first M entries of ``other`` ``(…, r)``."""
        return self._all(
            other.shape[1],
            lambda start, block: block.T @ other[start : start + len(block)],
            lambda levers, place: levers.times(place, other),
        )

    def summed(self, sums: Sums) -> Array:
        """``(K, groups)``: weighted sums of the columns over groups of entries."""
        return self._all(
            sums.groups,
            lambda start, block: (sums.over(start, start + len(block)) @ block).T,
            lambda levers, place: levers.summed(place, sums).T,
        )

    def own(self, whole: Array) -> list[Array]:
        """Each candidate's part of an array ``(K, …)``."""
        return np.split(whole, np.cumsum([m.width for m in self.members], dtype=int))[:-1]

    def batches(self, other: Array, width: int) -> Iterator[tuple[Joined, Array]]:
        """Groups of consecutive candidates with about ``width`` columns in all, held, each with its D' other."""
        for late, run in groupby(self.members, key=lambda m: isinstance(m, Filtered)):
            alike = Joined(list(run))
            which = np.cumsum([0, *(m.width for m in alike.members[:-1])]) // width
            edges = [0, *(np.flatnonzero(np.diff(which)) + 1).tolist(), len(alike.members)]
            products = None if late else alike.own(alike.times(other))
            for a, b in pairwise(edges):
                some = Joined(Joined(alike.members[a:b]).held)
                yield some, some.times(other) if products is None else np.concatenate(products[a:b])

    def _all(
        self,
        width: int,
        of_block: Callable[[int, Array], Array],
        of_place: Callable[[Levers, int], Array | sparse.csc_matrix],
    ) -> Array:
        """``(K, width)``: ``of_block`` of each stored block, or each place's functions times ``of_place``, summed."""
        blocks: dict[tuple[int, int], list[tuple[slice, Array]]] = {}
        places: dict[tuple[Levers, int], list[tuple[slice, Array]]] = {}
        first = 0
        for member in self.held:
            if isinstance(member, Products):
                for place, F, mine in member.placed:
                    lines = slice(first + mine.start, first + mine.stop)
                    places.setdefault((member.levers, place), []).append((lines, F))
            else:
                for start, block in member.pieces:
                    lines = slice(first, first + member.width)
                    blocks.setdefault((start, len(block)), []).append((lines, block))
            first += member.width
        out = np.zeros((first, width))
        for (start, _), parts in blocks.items():
            for at, block in _side_by_side(parts):
                out[at] += of_block(start, block)
        for (levers, place), parts in places.items():
            product = of_place(levers, place)
            for at, F in _side_by_side(parts):
                out[at] += F.T @ product
        return out


def _side_by_side(parts: Sequence[tuple[slice, Array]]) -> list[tuple[Integers, Array]]:
    """Blocks of one length joined to about :data:`MOST_JOINED_COLUMNS` columns, with the numbers of these columns."""
    out: list[tuple[Integers, Array]] = []
    lines: list[Integers] = []
    blocks: list[Array] = []
    for number, (own, block) in enumerate(parts, start=1):
        lines.append(np.arange(own.start, own.stop))
        blocks.append(block)
        if number == len(parts) or sum(map(len, lines)) >= MOST_JOINED_COLUMNS:
            out.append((np.concatenate(lines), np.hstack(blocks)))
            lines, blocks = [], []
    return out
