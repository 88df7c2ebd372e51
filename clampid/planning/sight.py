"""Line of sight: whether an instrument sees the tracked points, by its own field of view and by theirs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clampid.stages.rows import Array, Bools
from experiments.plans.errors import PlanError

__all__ = ["Sight", "sight_of"]


@dataclass(frozen=True)
class Sight:
    """An instrument and two cones, each made narrower by a tolerance.

    Attributes
    ----------
    station
        ``(3,)`` m, base frame: where the instrument stands.
    view, field
        Axis ``(3,)`` of what the instrument can see, base frame, unit length, and half-angle of that cone, rad.
    facing, acceptance
        Where the targets look, ``(3,)`` in the flange frame, unit length, and half-angle within which they answer,
        rad: 30 degrees for an open corner cube.
    tolerance
        rad: by how much the station and the targets may be turned from what is stated.
    """

    station: Array
    view: Array
    field: float
    facing: Array
    acceptance: float
    tolerance: float

    def sees(self, points: Array, rotation: Array) -> Bools:
        """Whether all of the points ``(N, t, 3)`` m, on flanges turned by ``(N, 3, 3)``, are in both cones ``(N,)``."""
        way = points - self.station
        way = way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-12)
        out = np.ones(points.shape[:2], dtype=bool)
        if self.field < np.pi:
            out &= way @ self.view >= np.cos(max(self.field - self.tolerance, 0.0))
        if self.acceptance < np.pi:
            looks = rotation @ self.facing
            out &= np.einsum("ntk,nk->nt", -way, looks) >= np.cos(max(self.acceptance - self.tolerance, 0.0))
        return np.asarray(out.all(axis=1))

    @property
    def words(self) -> str:
        """For people."""
        return f"instrument at ({', '.join(f'{v:g}' for v in self.station)}) m"


def sight_of(
    station: Sequence[float],
    view: Sequence[float] | None = None,
    facing: Sequence[float] | None = None,
    tolerance: float = 0.05,
) -> Sight:
    """Line of sight from numbers.

    Parameters
    ----------
    station
        x, y, z, m, base frame.
    view
        Axis x, y, z of the field of view, base frame, and its half-angle, rad; None: it sees all around.
    facing
        Axis x, y, z in the flange frame along which the targets look, and half-angle, rad; None: from all sides.
    tolerance
        rad, taken off both half-angles.

    Raises
    ------
    PlanError
        A number is missing or out of range.
    """
    if len(station) != 3 or not np.all(np.isfinite(station)):
        raise PlanError(f"instrument: expected x, y, z in m, base frame, found {list(station)}")
    if not 0 <= tolerance < np.pi:
        raise PlanError(f"tolerance of the line of sight: expected rad from 0, found {tolerance:g}")
    axes, angles = [], []
    for name, cone in (("field of view", view), ("facing of the targets", facing)):
        given = (0.0, 0.0, 1.0, np.pi) if cone is None else tuple(cone)
        if len(given) != 4 or not np.all(np.isfinite(given)) or not np.any(given[:3]):
            raise PlanError(f"{name}: expected an axis x, y, z that is not 0, and a half-angle in rad, found {given}")
        if not tolerance < given[3] <= np.pi:
            raise PlanError(
                f"{name}: expected a half-angle above the tolerance of {tolerance:g} rad and up to pi, found "
                f"{given[3]:g}"
            )
        axes.append(np.array(given[:3]) / np.linalg.norm(given[:3]))
        angles.append(float(given[3]))
    return Sight(np.array(station, dtype=float), axes[0], angles[0], axes[1], angles[1], tolerance)
