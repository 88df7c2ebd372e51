"""A detector pose as pyFAI's geometry.

pyFAI's laboratory has axis 1 up, axis 2 horizontal (against x = up × beam), axis 3 along the beam, and the sample at
the origin. A pixel at detector coordinates (d1, d2) (m, along slow and fast axis) is at R3 R2 R1 (d1 - poni1, d2 -
poni2, dist), rot1 and rot2 left-handed. Here the whole rotation is decomposed, so that a roll about the detector's
normal is right as well. The point of normal incidence is the detector's middle, since its normal is at the sample.
Source: pyFAI's documentation, "Detector's geometry"; J. Kieffer, D. Karkoulis (2013), J. Phys.: Conf. Ser. 425 202012.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from offline_ik.cell.coordinates import Convention

__all__ = ["PyfaiGeometry", "pyfai_geometry"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PyfaiGeometry:
    """pyFAI's six parameters; m and rad.

    ``poni1`` and ``poni2`` are zero at the detector frame's origin: add the detector's middle in pyFAI's detector
    coordinates to them.
    """

    dist: float
    poni1: float
    poni2: float
    rot1: float
    rot2: float
    rot3: float

    def to_json(self) -> dict[str, float]:
        """For programs."""
        return {k: float(getattr(self, k)) for k in ("dist", "poni1", "poni2", "rot1", "rot2", "rot3")}


def pyfai_geometry(convention: Convention, pose: Array) -> PyfaiGeometry:
    """The geometry of a detector pose ``(4, 4)`` in the convention's frame.

    The detector's slow axis is against its x, its fast axis along its y (as one sees at gamma = delta = 0: up, and
    against up × beam); pyFAI's third axis points from the sample to the detector, against its normal.
    """
    lab = np.column_stack([convention.lab[:, 1], -convention.lab[:, 0], convention.lab[:, 2]])
    pose = np.asarray(pose, dtype=float)
    R = pose[:3, :3]
    frame = np.column_stack([-R[:, 0], R[:, 1], -R[:, 2]])
    M = lab.T @ frame  # (d1, d2, away from the sample) in pyFAI's axes
    v = lab.T @ (pose[:3, 3] - np.asarray(convention.sample))
    at = M.T @ v  # = (-poni1, -poni2, dist) of the detector's origin
    # M = R3(rot3) R2(-rot2) R1(-rot1), each right-handed about its axis.
    a2 = -math.asin(max(-1.0, min(1.0, float(M[2, 0]))))
    a3, a1 = math.atan2(M[1, 0], M[0, 0]), math.atan2(M[2, 1], M[2, 2])
    return PyfaiGeometry(float(at[2]), float(-at[0]), float(-at[1]), -a1, -a2, a3)
