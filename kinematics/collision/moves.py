"""
Whether a move in joint space keeps the clearance along its whole length, and how near it comes to what.

At the middle of an interval the distance of every pair of shapes must exceed what they can come nearer within half of
it, or else the interval is halved. What such a step can move is bounded by the lengths of the links, so that nothing
between the samples is missed. Source of the bound: Schwarzer, Saha, Latombe (2005), Adaptive dynamic collision checking
for single and multiple articulated robots.
"""

from __future__ import annotations

import numpy as np

from kinematics.collision.world import World
from kinematics.typing_ import Array

__all__ = ["LongCheckError", "MoveCheck", "move_clear"]

FINEST_INTERVAL = 1e-4  # of a move: what is nearer than the clearance plus this much of the move is refused
INTERVALS_AT_ONCE = 32  # that are looked at in one step


class LongCheckError(Exception):
    """A check would look at more places than it may."""


def move_clear(world: World, start: Array, end: Array) -> bool:
    """Whether a move between postures ``(n,)``, all joints in step, keeps the clearance; rad, m where joints slide."""
    check = MoveCheck(world, np.inf, nearest=False)
    check.leg(start, end, 0)
    return check.hit is None


class MoveCheck:
    """
    The least distances met while intervals are halved.

    Parameters
    ----------
    most
        Places on the way that may be looked at; beyond, LongCheckError is raised.
    nearest
        Whether to find the least distances; otherwise only whether the clearance is kept.

    Attributes
    ----------
    hit
        Names of the pair of shapes that come nearer than the clearance; None: all keep it.
    clearance, between, at
        The least distance seen, m, of which pair, and at what share of the move (in legs).
    base
        The least distance of links 4 and 5 from the robot's own base, m.
    """

    def __init__(self, world: World, most: float = np.inf, *, nearest: bool = True) -> None:
        self.world, self.allowed, self._left = world, world.described.clearance, most
        least = np.inf if nearest else -np.inf
        self.clearance, self.between, self.at, self.base = least, ("", ""), 0.0, least
        self.hit: tuple[str, str] | None = None
        self._forearm = np.array([a.kind == "base" and b.link in (4, 5) for a, b in world.pairs], dtype=bool)

    def leg(self, start: Array, end: Array, number: int) -> None:
        """Check one straight move between postures ``(n,)``, the leg of that number."""
        if not self.world.pairs:
            return
        whole = self.world.motion(start, end)
        todo = [(0.0, 1.0, np.full(len(whole), -np.inf))]
        while todo:
            # From the end, so that a way that grazes something is refused before all of it is looked at this finely.
            intervals, todo = todo[-INTERVALS_AT_ONCE:], todo[:-INTERVALS_AT_ONCE]
            self._left -= len(intervals)
            if self._left < 0:
                raise LongCheckError
            low, high = np.array([a for a, _, _ in intervals]), np.array([b for _, b, _ in intervals])
            middles, width = 0.5 * (low + high), high - low
            nearer = 0.5 * width[:, None] * whole  # than in the middle, anywhere in the interval
            least = np.array([least for _, _, least in intervals])
            distances = self._seen(start + middles[:, None] * (end - start), number + middles, nearer, least)
            if self.hit is not None:
                return
            near = distances - self.allowed <= nearer
            finest = near & (width < FINEST_INTERVAL)[:, None]
            if finest.any():
                k = int(np.flatnonzero(finest.any(axis=1))[0])
                self._refuse(np.where(finest[k], distances[k], np.inf), float(number + middles[k]))
                return
            for k in np.flatnonzero(near.any(axis=1))[::-1].tolist():
                (a, b, _), middle, least_beside = intervals[k], float(middles[k]), distances[k] - 0.5 * nearer[k]
                todo += [(middle, b, least_beside), (a, middle, least_beside)]

    def _seen(self, q: Array, at: Array, nearer: Array, least: Array) -> Array:
        """Distances ``(m, pairs)``, m: exact where they decide or are less than all before, else a lower bound.

        ``nearer``, ``least`` ``(m, pairs)``: by how much they may fall in the interval, and what is known of them, m.
        """
        placed = self.world.at(q)
        distances = np.maximum(placed.bounds(), least)
        decides = distances - self.allowed <= nearer
        for k in range(len(q)):
            for i in np.argsort(distances[k]).tolist():
                if not decides[k, i] and distances[k, i] >= (self.base if self._forearm[i] else self.clearance):
                    continue
                distances[k, i] = exact = placed.distance(k, i)
                if exact < self.clearance:
                    self.clearance, self.at, self.between = exact, float(at[k]), self._names(i)
                if self._forearm[i]:
                    self.base = min(self.base, exact)
            if (distances[k] < self.allowed).any():
                self._refuse(distances[k], float(at[k]))
                break
        return distances

    def _refuse(self, distance: Array, at: float) -> None:
        k = int(np.argmin(distance))
        self.clearance, self.at = float(distance[k]), at
        self.hit = self.between = self._names(k)

    def _names(self, pair: int) -> tuple[str, str]:
        a, b = self.world.pairs[pair]
        return a.name, b.name
