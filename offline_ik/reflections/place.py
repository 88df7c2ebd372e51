"""The detector's position on the sphere for a given posture, with its uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from offline_ik.cell.coordinates import DetectorAngles, detector_angles, detector_pose
from offline_ik.inverse.uncertainty import Uncertainty
from offline_ik.reflections.seen import Spread, spread_of

if TYPE_CHECKING:
    from offline_ik.inverse.detector import Detector

__all__ = ["Place", "place_of"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Place:
    """Where a posture puts the detector.

    Attributes
    ----------
    pose
        ``(4, 4)`` in the convention's frame, m.
    angles
        The same on the sphere.
    motor
        ``(n,)``: the motor angles of the posture, rad.
    beyond
        Names of the joints that are beyond their limits.
    spread
        How uncertain the angles are.
    """

    pose: Array
    angles: DetectorAngles
    uncertainty: Uncertainty
    motor: Array
    beyond: tuple[str, ...]
    spread: Spread

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        at = self.angles
        return {
            "gamma_rad": at.gamma,
            "delta_rad": at.delta,
            "r_m": at.r,
            "roll_rad": at.roll,
            "tilt_rad": list(at.tilt),
            "detector_position_m": self.pose[:3, 3].tolist(),
            "motor_rad": self.motor.tolist(),
            **self.uncertainty.stated(),
            **self.spread.to_json(),
            "beyond_limits": list(self.beyond),
        }


def place_of(detector: Detector, q: Sequence[float] | Array, near: Sequence[float] | Array | None = None) -> Place:
    """Where a posture puts the detector, by the identified arm.

    Parameters
    ----------
    q
        ``(n,)``, rad.
    near
        ``(n,)``, rad: where the joints came from, straight; it decides on the flanks. Unknown without.

    Raises
    ------
    TargetError
        One of them is no posture, or the detector would be at the sample itself.
    """
    there = detector.check_posture(q, "q")
    conditions = detector.still
    if near is not None:
        conditions = replace(conditions, direction=np.sign(there - detector.check_posture(near)))
    pose = detector.pose(there[None], conditions)[0]
    angles = detector_angles(detector.cell.convention, pose)
    straight = detector_pose(detector.cell.convention, angles.gamma, angles.delta, angles.r, angles.roll)
    towards = detector.towards(detector.to_base(straight), angles.roll)
    outside = (there < detector.lower) | (there > detector.upper)
    beyond = tuple(joint.name for joint, out in zip(detector.robot.joints, outside, strict=True) if out)
    uncertainty = detector.propagation.at(there, conditions, towards)
    spread = spread_of(detector, pose, pose[:3, 3], uncertainty.covariance)
    return Place(pose, angles, uncertainty, detector.motor(there), beyond, spread)
