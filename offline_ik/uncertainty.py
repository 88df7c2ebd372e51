"""How far off the detector may be: the model's covariance, and what an unknown approach leaves open.

Radial is along the line from the sample, tangential along the sphere. With the parameters' covariance S and the
derivative J of the detector's pose by them, cov = J S J'. A joint whose direction of approach is not known may stand on
either side of its gap and friction: that adds (d/2)(d/2)' with d from one side to the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from offline_ik.arm import Conditions
from offline_ik.cell import Cell
from offline_ik.mount import mount_jacobian
from offline_ik.solver import Solver

__all__ = ["Propagation", "Uncertainty"]

Array = npt.NDArray[np.float64]

NORMAL_95 = 1.6448536269514722  # one-sided 95 % quantile of the normal distribution


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Of one detector pose; standard deviations.

    Attributes
    ----------
    covariance
        ``(6, 6)``: along (across, up of the detector as the circles carry it, outward), m, and about the same, rad.
    std_m, std_rad
        Of the norm of the position's and of the rotation's error: roots of the traces.
    tangential_m, radial_m
        Along the sphere (two directions together), and along the line of sight.
    model_m, approach_m
        Shares of ``std_m``: the parameters', and that of unknown directions of approach.
    pixel
        Size of a pixel, m.
    """

    covariance: Array
    model_m: float
    approach_m: float
    pixel: float
    _variance: list[float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_variance", _variances(self.covariance))

    @property
    def std_m(self) -> float:
        """Root of the position's trace, m."""
        a, b, c = self._variance[:3]
        return math.sqrt(a + b + c)

    @property
    def std_rad(self) -> float:
        """Root of the rotation's trace, rad."""
        a, b, c = self._variance[3:]
        return math.sqrt(a + b + c)

    @property
    def tangential_m(self) -> float:
        """Along the sphere, m."""
        return math.sqrt(self._variance[0] + self._variance[1])

    @property
    def radial_m(self) -> float:
        """Along the line of sight, m."""
        return math.sqrt(self._variance[2])

    @property
    def radius95_m(self) -> float:
        """Within which the position lies with a probability of 95 %, m.

        The square of the distance is a sum of squares with unequal variances: Satterthwaite (1946), An approximate
        distribution of estimates of variance components, its quantile by Wilson and Hilferty (1931), The distribution
        of chi-square.
        """
        (a, ab, ac), (_, b, bc), (_, _, c) = self.covariance[:3, :3].tolist()
        trace, squares = sum(self._variance[:3]), a * a + b * b + c * c + 2 * (ab * ab + ac * ac + bc * bc)
        if not squares > 0:
            return 0.0
        part = 2.0 / 9.0 * squares / (trace * trace)  # 2 / (9 degrees of freedom)
        return math.sqrt(trace * (1 - part + NORMAL_95 * math.sqrt(part)) ** 3)

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        each = [math.sqrt(v) for v in self._variance]
        return {
            "std_m": self.std_m,
            "std_rad": self.std_rad,
            "tangential_std_m": self.tangential_m,
            "radial_std_m": self.radial_m,
            "radius95_m": self.radius95_m,
            "std_um": 1e6 * self.std_m,
            "std_urad": 1e6 * self.std_rad,
            "tangential_std_pixels": self.tangential_m / self.pixel,
            "pixel_m": self.pixel,
            "axes": "across and up as the circles carry the detector, outward",
            "std_axes_m": each[:3],
            "std_axes_rad": each[3:],
            "model_std_m": self.model_m,
            "approach_std_m": self.approach_m,
        }


class Propagation:
    """What is the same for all poses: the parameters' covariance and what the mount depends on.

    Parameters
    ----------
    solver, cell
        Of one detector.
    """

    def __init__(self, solver: Solver, cell: Cell) -> None:
        arm = solver.arm
        self.solver, self.cell, self.in_base = solver, cell, cell.convention.frame == "base"
        self.mount = mount_jacobian(cell, arm)
        self.unmounted = solver.mount[:3, :3].T
        # In the robot's own base frame, its place in the room does not matter.
        self.fixed = np.array([not (self.in_base and s.parameter.startswith("base_")) for s in arm.slots], dtype=float)
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
        return self.combined(J, unknown[:, None] * (spread.reshape(-1, 2, 3) @ towards).reshape(-1, 6), self.covariance)

    def combined(self, J: Array, half: Array | None, covariance: Array) -> Uncertainty:
        """From the derivative ``(6, C)`` by parameters of a covariance ``(C, C)``, and half the spread ``(n, 6)``.

        The spread is that of unknown approaches; None where all are known.
        """
        model = J @ covariance @ J.T
        model_m, approach_m, both = math.sqrt(sum(_variances(model)[:3])), 0.0, model
        if half is not None and half.any():
            approach = half.T @ half
            approach_m, both = math.sqrt(sum(_variances(approach)[:3])), model + approach
        return Uncertainty(both, model_m, approach_m, self.cell.pixel)


def _variances(covariance: Array) -> list[float]:
    """The diagonal, what rounding has made negative as zero."""
    return [v if v > 0.0 else 0.0 for v in covariance.diagonal().tolist()]
