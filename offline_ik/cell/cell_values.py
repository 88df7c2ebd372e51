"""Valid temperatures and targets of a cell."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from kinematics.section import Section

__all__ = ["COLDEST", "HOTTEST", "spread"]

Array = npt.NDArray[np.float64]

COLDEST, HOTTEST = -273.15, 200.0  # °C: what a temperature of a robot may be
LEAST_DISTANCE_OFF_LINE = 5e-3  # m: by how much targets must lie off a line


def spread(at: Section, points: Mapping[str, Array]) -> Mapping[str, Array]:
    """Names and points ``(3,)``, m, from which a rigid motion can be determined.

    Raises
    ------
    CellError
        They are fewer than three, or lie on a line, about which nothing tells the motion.
    """
    if not points:
        return points
    if len(points) < 3:
        raise at.fault("", "at least three targets", str(len(points)))
    placed = np.array(list(points.values()))
    off = np.linalg.svd(placed - placed.mean(axis=0), compute_uv=False)[1] / math.sqrt(len(points))
    if off < LEAST_DISTANCE_OFF_LINE:
        expected = f"targets at least {1e3 * LEAST_DISTANCE_OFF_LINE:g} mm (root mean square) off a line"
        raise at.fault("", expected, f"{', '.join(points)} within {1e3 * off:.1f} mm of one")
    return points
