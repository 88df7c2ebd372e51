"""At a singular pose: other postures along its valley, to find the one nearest to the present posture.

With axes 4 and 6 in line, joints 4 and 6 trade places; with the wrist's centre on axis 1, joint 1 turns the arm about
it and the wrist turns back. The nominal arm reaches such a pose all along that valley, the identified one in a few
places of it. Which of them a search ends at is a matter of rounding, so that the others are looked for.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import numpy.typing as npt

from kinematics.poe import joint_transforms
from offline_ik.inverse.mounted import MountedArm
from offline_ik.inverse.ortho import OrthoArm

__all__ = ["ALONG_A_VALLEY", "STRAIGHT", "along_valleys", "wrist_of"]

Array = npt.NDArray[np.float64]

ALONG_A_VALLEY = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)  # rad: all along a valley
STRAIGHT = 0.02  # |sin| of the wrist's angle below which joints 4 and 6 trade places: none is quite straight
FREE = 1e-7  # |sin| of the wrist's angle below which joint 4 is only rounding


def along_valleys(
    mounted: MountedArm, pose: Array, q: Array, here: Array, singular: Collection[str], turns: Array
) -> Array:
    """Where to begin to look for postures beside a singular one ``q``.

    Parameters
    ----------
    pose
        ``(4, 4)``: the detector in the base's frame, m.
    q, here
        ``(n,)``: the posture that was found, and the one at hand, rad.
    singular
        Which of ``wrist`` and ``shoulder``; see :meth:`offline_ik.inverse.postures.PostureSearch.names`.
    turns
        ``(T,)``: from joint 4 of the posture at hand, and from its joint 1, rad.

    Returns
    -------
    Array
        ``(K, n)``, rad; none where neither is singular.
    """
    ortho = mounted.ortho
    if ortho is None or not {"wrist", "shoulder"} & set(singular):
        return np.zeros((0, len(q)))
    chain, at_hand = mounted.linkage @ q, mounted.linkage @ here
    if "shoulder" not in singular:
        return np.asarray(_traded(ortho, chain, at_hand[3] + turns) @ mounted.unlinked.T)
    turned = np.repeat(chain[None], len(turns), axis=0)
    turned[:, 0] = at_hand[0] + turns
    R = (pose @ np.linalg.inv(mounted.mount))[:3, :3]
    starts = np.vstack([wrist_of(mounted, turned, R, side, at_hand[3]) for side in (1.0, -1.0)])
    straight = np.abs(np.sin(starts[:, 4] + ortho.psi)) < STRAIGHT
    traded = [_traded(ortho, start, at_hand[3] + turns) for start in starts[straight]]
    return np.asarray(np.vstack([starts, *traded]) @ mounted.unlinked.T)


def wrist_of(mounted: MountedArm, chain: Array, R: Array, side: float, q4: float) -> Array:
    """Postures of the chain ``(N, 6)`` with joints 4 to 6 such that the nominal flange has the orientation ``R``.

    Parameters
    ----------
    side
        The wrist's sign, see :data:`offline_ik.inverse.ortho.SIGNS`.
    q4
        Joint 4 where it is free, rad.
    """
    arm = mounted.ortho
    assert arm is not None
    a4, a5, a6 = arm.axes[3:]
    screws = mounted.arm.robot.screws
    forearm = joint_transforms(screws, chain)[..., 3, :3, :3]
    W = np.swapaxes(forearm, -1, -2) @ (R @ arm.home[:3, :3].T)
    d = W @ a6
    along, first, second = d @ a4, d @ np.cross(a5, a4), d @ a5
    sine = np.hypot(first, second)
    out = chain.copy()
    out[:, 3] = np.where(sine < FREE, q4, np.arctan2(side * second, side * first))
    out[:, 4] = np.arctan2(side * sine, along) - arm.psi
    out[:, 5] = 0.0
    turned = joint_transforms(screws, out)[..., 5, :3, :3]
    rest = np.swapaxes(turned, -1, -2) @ (R @ arm.home[:3, :3].T) @ a5
    out[:, 5] = np.arctan2(rest @ np.cross(a6, a5), rest @ a5)
    return out


def _traded(arm: OrthoArm, chain: Array, q4: Array) -> Array:
    """A posture ``(6,)`` with its joint 4 at each of ``q4`` ``(T,)``, joint 6 turned back by as much."""
    out = np.repeat(chain[None], len(q4), axis=0)
    opposed = np.sign(arm.axes[3] @ arm.axes[5]) * np.sign(np.cos(chain[4]))
    out[:, 3] = q4
    out[:, 5] -= (q4 - chain[3]) * opposed
    return out
