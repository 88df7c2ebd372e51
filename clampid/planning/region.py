"""Regions of the workspace for planned poses: boxes and parts of spheres, base frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clampid.stages.rows import Array, Bools
from experiments.plans.errors import PlanError

__all__ = ["Box", "Region", "SpherePart", "box_of", "sphere_part_of"]

GOLDEN = (1 + 5**0.5) / 2


@dataclass(frozen=True)
class Box:
    """A box with edges along the base's axes, from corner ``lower`` to corner ``upper`` ``(3,)``, m."""

    lower: Array
    upper: Array

    def contains(self, points: Array) -> Bools:
        """Whether points ``(…, 3)``, m, lie inside ``(…,)``."""
        return np.asarray(np.all((points >= self.lower) & (points <= self.upper), axis=-1))

    @property
    def words(self) -> str:
        """The box in words for people."""
        sides = (f"{axis} {a:g} to {b:g}" for axis, a, b in zip("xyz", self.lower, self.upper, strict=True))
        return f"box {', '.join(sides)} m"


@dataclass(frozen=True)
class SpherePart:
    """Part of a spherical shell within an angle of an axis, such as the sphere of a detector.

    Attributes
    ----------
    centre
        Centre of the sphere ``(3,)``, m.
    inner, outer
        Radii, m.
    axis
        Axis of the part ``(3,)``, unit vector.
    half_angle
        Largest angle to the axis, rad, 0 … pi.
    """

    centre: Array
    inner: float
    outer: float
    axis: Array
    half_angle: float

    def contains(self, points: Array) -> Bools:
        """Whether points ``(…, 3)``, m, lie inside ``(…,)``."""
        arm = points - self.centre
        r = np.linalg.norm(arm, axis=-1)
        along = arm @ self.axis >= np.cos(self.half_angle) * r
        return np.asarray((r >= self.inner) & (r <= self.outer) & along)

    def grid(self, count: int) -> Array:
        """Evenly spread points ``(count, 3)``, m, in turn at the inner, middle and outer radius.

        Source of the Fibonacci lattice on the cap: Gonzalez, Measurement of areas on a sphere using Fibonacci and
        latitude-longitude lattices, Mathematical Geosciences 42, 2010.
        """
        k = np.arange(count)
        z = 1 - (1 - np.cos(self.half_angle)) * (k + 0.5) / count
        turn, across = 2 * np.pi * k / GOLDEN, np.sqrt(1 - z**2)
        x = np.cross(np.eye(3)[int(np.argmin(np.abs(self.axis)))], self.axis)
        x /= np.linalg.norm(x)
        y = np.cross(self.axis, x)
        way = (across * np.cos(turn))[:, None] * x + (across * np.sin(turn))[:, None] * y + z[:, None] * self.axis
        radius = np.array([self.inner, (self.inner + self.outer) / 2, self.outer])[k % 3]
        return np.asarray(self.centre + radius[:, None] * way)

    @property
    def words(self) -> str:
        """The part in words for people."""
        c, a = (", ".join(f"{v:g}" for v in vector) for vector in (self.centre, self.axis))
        return (
            f"part of a sphere about ({c}) m, radius {self.inner:g} to {self.outer:g} m, up to {self.half_angle:g} rad "
            f"from ({a})"
        )


Region = Box | SpherePart


def box_of(numbers: Sequence[float]) -> Box:
    """A box from x, y, z of two opposite corners, m.

    Raises
    ------
    PlanError
        There are not six finite numbers, or an edge has no length.
    """
    if len(numbers) != 6:
        raise PlanError(f"box: expected six numbers, x, y, z of two opposite corners in m, found {len(numbers)}")
    ends = np.sort(np.reshape(np.array(numbers, dtype=float), (2, 3)), axis=0)
    if not np.all(np.isfinite(ends)) or np.any(ends[0] == ends[1]):
        raise PlanError(f"box: expected two corners that differ in x, y and z, found {list(numbers)}")
    return Box(ends[0], ends[1])


def sphere_part_of(numbers: Sequence[float]) -> SpherePart:
    """Part of a sphere from nine numbers: centre (3), m; inner and outer radius, m; axis (3); half-angle, rad.

    Five numbers, without axis and half-angle, give the whole shell.

    Raises
    ------
    PlanError
        There are not five or nine numbers, or one of them is out of range.
    """
    if len(numbers) == 5:
        numbers = (*numbers, 0.0, 0.0, 1.0, np.pi)
    if len(numbers) != 9:
        raise PlanError(
            "sphere: expected five numbers (centre x, y, z, inner and outer radius, m) or nine (and an axis x, y, z "
            f"with the angle about it, rad), found {len(numbers)}"
        )
    given = np.array(numbers, dtype=float)
    axis, (inner, outer), angle = given[5:8], given[3:5], float(given[8])
    if not np.all(np.isfinite(given)) or not 0 <= inner <= outer or outer == 0 or not axis.any():
        raise PlanError(f"sphere: expected radii 0 <= inner <= outer in m and an axis that is not 0, found {numbers}")
    if not 0 < angle <= np.pi:
        raise PlanError(f"sphere: expected an angle about its axis above 0 and up to pi rad, found {angle:g}")
    return SpherePart(given[:3], float(inner), float(outer), axis / np.linalg.norm(axis), angle)
