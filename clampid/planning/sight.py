"""Line of sight: an instrument's field of view, and the acceptance angle of its targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clampid.stages.rows import Array, Bools
from experiments.plans.errors import PlanError

__all__ = ["Sight", "sight_of"]


@dataclass(frozen=True)
class Sight:
    """Position and field of view of an instrument, and acceptance cone of its targets.

    Attributes
    ----------
    station
        Position of the instrument ``(3,)``, m, base frame.
    view, field
        Axis of the field of view ``(3,)``, unit vector, base frame, and half-angle of its cone, rad.
    facing, acceptance
        Direction in which the targets face ``(3,)``, unit vector, flange frame, and half-angle of their acceptance
        cone, rad: 30 degrees for an open corner cube.
    tolerance
        Possible error of the stated directions, rad; it is subtracted from both half-angles.
    """

    station: Array
    view: Array
    field: float
    facing: Array
    acceptance: float
    tolerance: float

    def sees(self, points: Array, rotation: Array) -> Bools:
        """Whether the instrument sees all points of a pose ``(N,)``; obstacles are not considered.

        Parameters
        ----------
        points
            ``(N, t, 3)``, m, base frame.
        rotation
            Rotation of the flange ``(N, 3, 3)``, base frame.
        """
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
        """The instrument in words for people."""
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
        Position x, y, z of the instrument, m, base frame.
    view
        Axis x, y, z of the field of view, base frame, and its half-angle, rad; None: all directions.
    facing
        Direction x, y, z in which the targets face, flange frame, and their half-angle, rad; None: all directions.
    tolerance
        Possible error of the stated directions, rad.

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
