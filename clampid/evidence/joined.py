"""Products of the columns of many candidates at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import sparse

from clampid.evidence.columns import AnyColumns, Columns, Filtered, Levers, Sums
from clampid.fitting.wander import Filters
from clampid.stages.rows import Array, Integers

__all__ = ["Joined"]

MOST_JOINED_COLUMNS = 128  # columns that share a matrix product: more saves no time and needs more memory


@dataclass(frozen=True)
class Joined:
    """The columns of many candidates side by side, K in all, so that each matrix product serves many of them.

    A table of hundreds of megabytes is then read once, not once for each candidate.
    """

    members: Sequence[AnyColumns]

    def times(self, other: Array) -> Array:
        """``(K, r)``: D' other, from the first M entries of ``other`` ``(…, r)``."""
        products = self._all(
            other.shape[1],
            lambda start, block: block.T @ other[start : start + len(block)],
            lambda levers, place: levers.times(place, other),
        )
        return self._less_level(products, lambda filters: filters.shares(other))

    def summed(self, sums: Sums) -> Array:
        """``(K, groups)``: weighted sums of the columns over groups of entries."""
        products = self._all(
            sums.groups,
            lambda start, block: (sums.over(start, start + len(block)) @ block).T,
            lambda levers, place: levers.summed(place, sums).T,
        )
        return self._less_level(products, lambda filters: filters.summed(sums.matrix).T)

    def own(self, whole: Array) -> list[Array]:
        """Each candidate's part of an array ``(K, …)``."""
        return np.split(whole, np.cumsum([m.width for m in self.members], dtype=int))[:-1]

    def batches(self, other: Array, width: int) -> Iterator[tuple[Joined, Array]]:
        """Groups of consecutive candidates with about ``width`` columns in all, each with its D' other."""
        if not self.members:
            return
        which = np.cumsum([0, *(m.width for m in self.members[:-1])]) // width
        edges = [0, *(np.flatnonzero(np.diff(which)) + 1).tolist(), len(self.members)]
        products = self.own(self.times(other))
        for a, b in pairwise(edges):
            yield Joined(self.members[a:b]), np.concatenate(products[a:b])

    def _less_level(self, products: Array, shares: Callable[[Filters], Array]) -> Array:
        """Sums ``(K, …)`` over products, less what a level takes of them.

        ``shares`` gives the same sums of the level's directions ``(R, …)``.
        """
        filtered = [m for m in self.members if isinstance(m, Filtered)]
        if not filtered:
            return products
        unknown = [m for m in filtered if "shares" not in m.__dict__]
        for member, found in zip(unknown, _shares_of(unknown), strict=True):
            member.__dict__["shares"] = found.copy()  # a view would keep those of all candidates
        filters = filtered[0].filters  # those of the fit
        lines = np.concatenate([np.full(m.width, isinstance(m, Filtered)) for m in self.members])
        taken = np.concatenate([m.shares for m in filtered]) * filters.taken
        products[lines] -= taken @ shares(filters)
        return products

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
        for member in self.members:
            if isinstance(member, Columns):
                for start, block in member.pieces:
                    lines = slice(first, first + member.width)
                    blocks.setdefault((start, len(block)), []).append((lines, block))
            else:
                own = member.products if isinstance(member, Filtered) else member
                for place, F, mine in own.placed:
                    lines = slice(first + mine.start, first + mine.stop)
                    places.setdefault((own.levers, place), []).append((lines, F))
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


def _shares_of(members: Sequence[Filtered]) -> list[Array]:
    """Of each of some candidates the products of its columns with the directions of the level ``(k, R)``."""
    joined = Joined([m.products for m in members])
    count = len(members[0].filters.taken) if members else 0
    return joined.own(joined._all(count, lambda start, block: block, lambda levers, place: levers.shares(place)))


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
