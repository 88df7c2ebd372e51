"""Uncertainty of the detector's position: the model's covariance, and unknown directions of approach.

Radial is along the line from the sample, tangential along the sphere. With the parameters' covariance S and the
derivative J of the detector's pose by them, cov = J S J'. A joint whose direction of approach is not known may stand on
either side of its gap and friction: that adds (d/2)(d/2)' with d from one side to the other. Beyond what the model was
identified on, :mod:`clampid.models.ranges` says what empirical effects add.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from clampid.role_slots import has_role
from offline_ik.arm.beyond import outside_of
from offline_ik.arm.identified import Conditions
from offline_ik.cell.cell import Cell
from offline_ik.cell.mount import mount_jacobian
from offline_ik.inverse.solver import Solver

__all__ = ["Propagation", "Uncertainty"]

Array = npt.NDArray[np.float64]

NORMAL_95 = 1.6448536269514722  # one-sided 95 % quantile of the normal distribution


class Uncertainty(NamedTuple):
    """Of one detector pose; standard deviations. A named tuple, as those of :mod:`offline_ik.inverse.answer` are.

    Attributes
    ----------
    covariance
        ``(6, 6)``: along (across, up of the detector as the circles carry it, outward), m, and about the same, rad.
    approach_m
        Share of ``std_m`` that unknown directions of approach have; the rest, ``model_std_m``, is the parameters'.
    pixel
        Size of a pixel, m.
    """

    covariance: Array
    approach_m: float
    pixel: float

    def stated(self) -> dict[str, float]:
        """The stated uncertainties, m, rad and pixels, by the names that answers use.

        ``std_m`` and ``std_rad`` are of the norm of the position's and of the rotation's error: roots of the traces.
        ``tangential`` is along the sphere (two directions together), ``radial`` along the line of sight. Within
        ``radius95_m`` the position lies with a probability of 95 %: the square of the distance is a sum of squares
        with unequal variances; Satterthwaite (1946), An approximate distribution of estimates of variance components,
        its quantile by Wilson and Hilferty (1931), The distribution of chi-square.
        """
        (a, ab, ac, *_), (_, b, bc, *_), (_, _, c, *_), *_ = self.covariance.tolist()
        a, b, c, *about = _variances(self.covariance)
        trace, squares = a + b + c, a * a + b * b + c * c + 2 * (ab * ab + ac * ac + bc * bc)
        part = 2.0 / 9.0 * squares / (trace * trace) if squares > 0 else 0.0  # 2 / (9 degrees of freedom)
        tangential = math.sqrt(a + b)
        return {
            "std_m": math.sqrt(trace),
            "std_rad": math.sqrt(sum(about)),
            "radius95_m": math.sqrt(trace * (1 - part + NORMAL_95 * math.sqrt(part)) ** 3),
            "tangential_std_m": tangential,
            "radial_std_m": math.sqrt(c),
            "tangential_std_pixels": tangential / self.pixel,
            "model_std_m": math.sqrt(max(trace - self.approach_m**2, 0.0)),  # traces add up
            "approach_std_m": self.approach_m,
        }

    @property
    def std_m(self) -> float:
        """Root of the position's trace, m."""
        return self.stated()["std_m"]

    @property
    def std_rad(self) -> float:
        """Root of the rotation's trace, rad."""
        return self.stated()["std_rad"]

    @property
    def tangential_m(self) -> float:
        """Along the sphere, m."""
        return self.stated()["tangential_std_m"]

    @property
    def radius95_m(self) -> float:
        """Within which the position lies with a probability of 95 %, m."""
        return self.stated()["radius95_m"]

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        each, stated = [math.sqrt(v) for v in _variances(self.covariance)], self.stated()
        return {
            **stated,
            "std_um": 1e6 * stated["std_m"],
            "std_urad": 1e6 * stated["std_rad"],
            "pixel_m": self.pixel,
            "axes": "across and up as the circles carry the detector, outward",
            "std_axes_m": each[:3],
            "std_axes_rad": each[3:],
        }


class Propagation:
    """The part that is the same for all poses: the parameters' covariance and the mount's derivatives.

    Parameters
    ----------
    solver, cell
        Of one detector.
    """

    def __init__(self, solver: Solver, cell: Cell) -> None:
        arm = solver.arm
        self.solver, self.cell, self.in_base = solver, cell, cell.convention.frame == "base"
        self.mount = mount_jacobian(cell, arm)
        self.outside = outside_of(arm)
        self.unmounted = solver.mount[:3, :3].T
        # In the robot's own base frame, its place in the room does not matter.
        self.fixed = np.array([not (self.in_base and has_role(s, "base_frame")) for s in arm.slots], dtype=float)
        self.covariance = arm.covariance * np.outer(self.fixed, self.fixed)

    def jacobian(self, q: Array, conditions: Conditions) -> tuple[Array, Array]:
        """``(6, P)``: d (position, rotation vector) / d parameters, and ``(n, 6)`` from one approach to the other.

        Axes of the calibrated base. With the convention's frame in the robot's base, the base's own place does not
        matter.
        """
        row = np.concatenate([q, conditions.vector])
        rotation, flat, spread = self.solver.sensitivity.one(row)
        J = flat.reshape(6, -1) * self.fixed
        flange = rotation.reshape(3, 3) @ self.unmounted
        J[:3] += flange @ self.mount[:3]
        J[3:] += flange @ self.mount[3:]
        return J, spread.reshape(-1, 6)

    def at(self, q: Array, conditions: Conditions, towards: Array) -> Uncertainty:
        """The uncertainty of the detector at ``q`` ``(n,)``.

        Parameters
        ----------
        towards
            ``(3, 3)``: columns across, up and the radial direction, in the base's axes.
        """
        J, spread = self.jacobian(q, conditions)
        unknown = 0.5 * (conditions.direction == 0)
        J = (towards.T @ J.reshape(2, 3, -1)).reshape(6, -1)
        half = unknown[:, None] * (spread.reshape(-1, 2, 3) @ towards).reshape(-1, 6)
        model = J @ self.covariance @ J.T
        if self.outside is not None:
            doubted = self.outside.empirical.parameter
            model = model + self.outside.widening(J[:, doubted], q, conditions.link_temperature)
        return self.combined(model, half)

    def combined(self, model: Array, half: Array | None) -> Uncertainty:
        """From the share of the parameters ``(6, 6)``, and half the spread ``(n, 6)`` of approaches that are not known.

        None for the latter where all are known.
        """
        if half is None:
            return Uncertainty(model, 0.0, self.cell.pixel)
        approach = half.T @ half
        return Uncertainty(model + approach, math.sqrt(sum(_variances(approach)[:3])), self.cell.pixel)


def _variances(covariance: Array) -> list[float]:
    """The diagonal; entries that rounding made negative are zero."""
    return [v if v > 0.0 else 0.0 for v in covariance.diagonal().tolist()]
