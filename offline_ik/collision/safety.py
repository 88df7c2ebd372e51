"""Whether a move is safe before it is made: limits, speeds, the arm with itself, and the arm with what stands around.

The arm's links are capsules between its joints (radii from the cell, or guessed from its reach), the detector is a box,
obstacles are the cell's shapes. A move in joint space is checked along its whole length: at the middle of an interval
the distance of every pair of shapes must exceed what they can come nearer within half of it, or else the interval is
halved. What such a step can move is bounded by the lengths of the links, so that nothing between the samples is missed.
Distances are `coal`'s. The geometry is the nominal arm's, whose millimetres the clearance covers. Source of the bound:
Schwarzer, Saha, Latombe (2005), Adaptive dynamic collision checking for single and multiple articulated robots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import coal  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from offline_ik.collision.shapes import Shape, carries, distance_of
from offline_ik.collision.world import World, world_of
from offline_ik.errors import CellError

if TYPE_CHECKING:
    from offline_ik.inverse.detector import Detector

__all__ = ["Clearance", "LongCheckError", "PathReport", "check_path", "check_sample", "clearances_along", "move_time"]

Array = npt.NDArray[np.float64]

FINEST = 1e-4  # of a move: what is nearer than the clearance plus this much of the move is refused
TOGETHER = 32  # intervals that are looked at in one step


@dataclass(frozen=True)
class PathReport:
    """What a check of a move found.

    Attributes
    ----------
    reasons
        Why it is refused; empty: it is safe.
    clearance
        The least distance seen, m, and ``between`` which shapes, ``at`` what share of the move (in legs).
    base_distance
        The least distance of the forearm and wrist (axes 4 and 5) from the robot's own base, m.
    duration
        At the cell's share of the greatest speeds, s.
    """

    reasons: tuple[str, ...]
    clearance: float
    between: tuple[str, str]
    at: float
    base_distance: float
    duration: float

    @property
    def safe(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.reasons

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "safe": self.safe,
            "reasons": list(self.reasons),
            "least_distance_m": self.clearance if np.isfinite(self.clearance) else None,
            "between": list(self.between),
            "at": self.at,
            "forearm_to_base_m": self.base_distance if np.isfinite(self.base_distance) else None,
            "duration_s": self.duration,
        }


@dataclass(frozen=True)
class Clearance:
    """The least distance of two bodies along a way, m, and at which share of it."""

    between: tuple[str, str]
    distance: float
    at: float

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {"between": list(self.between), "least_distance_m": self.distance, "at": self.at}


class LongCheckError(Exception):
    """A check would look at more places than it may."""


def check_path(detector: Detector, postures: Sequence[Array] | Array, most: float = np.inf) -> PathReport:
    """Check a move through postures ``(m, n)``, straight in joint space between them.

    Parameters
    ----------
    postures
        rad; a single one is checked as a place.
    most
        Places on the way that may be looked at.

    Raises
    ------
    LongCheckError
        They do not decide.
    """
    path = np.atleast_2d(np.asarray(postures, dtype=float))
    reasons: dict[str, None] = {}
    wild = ~np.isfinite(path).all(axis=0)
    beyond = ((path < detector.lower) | (path > detector.upper)).any(axis=0)
    for i in np.flatnonzero(wild | beyond).tolist():
        name, (low, high) = detector.robot.joints[i].name, np.degrees([detector.lower[i], detector.upper[i]])
        limits = "is not a finite angle" if wild[i] else f"leaves its limits of {low:.1f} to {high:.1f} deg"
        reasons[f"{name} {limits}"] = None
    if reasons:
        return PathReport(tuple(reasons), np.inf, ("", ""), 0.0, np.inf, move_time(detector, path))
    world = world_of(detector)
    worst = _Worst(world, detector.cell.clearance, most)
    for leg in range(max(len(path) - 1, 1)):
        start, end = path[leg], path[min(leg + 1, len(path) - 1)]
        worst.leg(start, end, leg)
        if worst.hit is not None:
            break
    if worst.hit is not None:
        a, b = worst.hit
        gap = 1e3 * worst.clearance
        near = f"come within {gap:.0f} mm" if gap >= 0.0 else f"overlap by {-gap:.0f} mm"
        reasons[f"{a} and {b} would {near} after {100.0 * worst.at:.0f} % of the move"] = None
    return PathReport(
        tuple(reasons), worst.clearance, worst.between, worst.at, worst.base, move_time(detector, path)
    )  # fmt: skip


def clearances_along(detector: Detector, postures: Array) -> list[Clearance]:
    """The least distance of every pair of bodies that may not touch, over postures ``(m, n)``; the nearest pair first.

    Between the postures nothing is looked at: this is for people to read. :func:`check_path` decides.
    """
    world = world_of(detector)
    if not world.pairs:
        return []
    distances = world.distances(np.atleast_2d(postures))  # (m, pairs)
    least, last = distances.argmin(axis=0), max(len(distances) - 1, 1)
    found = [
        Clearance((a.name, b.name), float(distances[k, i]), float(k) / last)
        for i, ((a, b), k) in enumerate(zip(world.pairs, least.tolist(), strict=True))
    ]
    return sorted(found, key=lambda c: c.distance)


class _Worst:
    """The least distances met while intervals are halved."""

    def __init__(self, world: World, allowed: float, most: float) -> None:
        self.world, self.allowed, self._left = world, allowed, most
        self.clearance, self.between, self.at, self.base = np.inf, ("", ""), 0.0, np.inf
        self.hit: tuple[str, str] | None = None
        self._forearm = np.array([a.kind == "base" and b.link in (4, 5) for a, b in world.pairs], dtype=bool)

    def leg(self, start: Array, end: Array, number: int) -> None:
        """Check one straight move between postures ``(n,)``, the leg of that number."""
        if not self.world.pairs:
            return
        whole = self.world.motion(end - start)
        todo = [(0.0, 1.0, np.full(len(whole), -np.inf))]
        while todo:
            # From the end, so that a way that grazes something is refused before all of it is looked at this finely.
            intervals, todo = todo[-TOGETHER:], todo[:-TOGETHER]
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
            finest = near & (width < FINEST)[:, None]
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


def move_time(detector: Detector, path: Array, speed: float | None = None) -> float:
    """How long a move takes at the given share of the joints' greatest speeds (the cell's by default), s."""
    share = detector.cell.speed if speed is None else speed
    path = np.atleast_2d(path)
    legs = np.abs(path[1:] - path[:-1])
    return float((legs / (share * detector.fastest)).max(axis=1).sum()) if len(legs) else 0.0


def check_sample(detector: Detector) -> None:
    """Refuse a sample that lies in an obstacle, in the robot's own base, or in what carries that.

    An upright robot stands on something: the column of its base goes on without end below it, unless an obstacle of the
    cell reaches its foot and so says what is there.

    Raises
    ------
    CellError
        It does.
    """
    convention = detector.cell.convention
    at = np.eye(4)
    at[:3, 3] = convention.sample
    place = detector.to_base(at)[:3, 3]
    told = f"the sample at {np.round(place, 4).tolist()} m (base frame) lies inside"
    point = coal.Sphere(1e-6)
    here = coal.Transform3s(np.eye(3), place.copy())
    inside = {o.name for o in detector.cell.obstacles if o.holds_sample}
    for shape in world_of(detector).shapes:
        if shape.kind == "base" and _in_column(detector, shape, place):
            raise CellError(
                f"{told} the robot's base or what is below it (within {shape.radius:.3f} m of axis 1); an obstacle "
                "that reaches the foot of the base says what is there"
            )
        if shape.kind != "obstacle" or shape.name in inside:
            continue
        geometry = shape.geometry if shape.hull is None else shape.hull
        if distance_of(point, here, geometry, shape.at(np.eye(4))) <= 0:
            raise CellError(f"{told} {shape.name}; an obstacle that may hold it says holds_sample = true")


def _in_column(detector: Detector, base: Shape, place: Array) -> bool:
    """Whether a place ``(3,)`` is in the base, up to the shoulder, or below an upright one that stands on who knows."""
    gravity = np.asarray(detector.cell.gravity)
    upright = gravity[2] < -0.5 * np.linalg.norm(gravity)
    obstacles = (s for s in world_of(detector).shapes if s.kind == "obstacle")
    endless = upright and not any(carries(s, base, detector.cell.clearance) for s in obstacles)
    lowest, shoulder = -np.inf if endless else 0.0, detector.robot.joints[1].point[2]
    return bool(np.hypot(*place[:2]) <= base.radius and lowest <= place[2] <= shoulder)
