"""
The places of an arm's bodies and the loads on each joint, for many postures at once.

Every pose effect of this world bends the chain at one of four places: before a joint (a tilt of its bearing), in the
joint (its angle), at the end of a link (a shift and a turn), or at the base (a shift and a turn).
"""

from dataclasses import dataclass, fields

import numpy as np

from experiments.second_world.arms import Arm, Body
from experiments.second_world.arrays import Array, exp_so3, rpy_rotation

__all__ = ["Bend", "Frames", "Loads", "forward", "loads_of", "points_in_base"]


@dataclass(frozen=True)
class Bend:
    """The deviation of the chain at each place; bends add up."""

    angle_rad: Array  # (N, n) added to the joint's angle
    tilt_rad: Array  # (N, n, 3) rotation vector of the joint's frame, in that frame, before the joint turns
    shift_m: Array  # (N, n, 3) at the far end of the body behind the joint, in the joint's turned frame
    turn_rad: Array  # (N, n, 3) the same place, rotation vector
    base_shift_m: Array  # (N, 3) in the base frame
    base_turn_rad: Array  # (N, 3) rotation vector about the base frame's origin

    @staticmethod
    def none(rows: int, n: int) -> "Bend":
        """Make the bend of a perfect chain."""
        z = np.zeros
        return Bend(z((rows, n)), z((rows, n, 3)), z((rows, n, 3)), z((rows, n, 3)), z((rows, 3)), z((rows, 3)))

    def __add__(self, other: "Bend") -> "Bend":
        return Bend(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))


@dataclass(frozen=True)
class Frames:
    """Orientations and origins in the base frame."""

    before: Array  # (N, n, 3, 3) of each joint before it turns
    turned: Array  # (N, n, 3, 3) of each joint after it turned
    origin_m: Array  # (N, n, 3)
    flange: Array  # (N, 3, 3)
    flange_m: Array  # (N, 3)
    axes: Array  # (N, n, 3) unit vectors


@dataclass(frozen=True)
class Loads:
    """Weight of all that is carried by each joint, in the base frame; moments are about the joint's origin."""

    force_N: Array  # (N, n, 3)
    moment_Nm: Array  # (N, n, 3)
    torque_Nm: Array  # (N, n) that the drive must exert: minus the moment along the axis


def forward(arm: Arm, q: Array, bend: Bend) -> Frames:
    """
    Place all joint frames and the flange.

    Parameters
    ----------
    arm
        The arm.
    q
        Joint angles (N, n), rad.
    bend
        The deviations of the chain.

    Returns
    -------
    Frames
        In the frame of the base plate.
    """
    R = exp_so3(bend.base_turn_rad)
    o = bend.base_shift_m.copy()
    before, turned, origins, axes = [], [], [], []
    for i, joint in enumerate(arm.joints):
        o = o + (R @ joint.xyz_m)
        R = R @ rpy_rotation(joint.rpy_rad) @ exp_so3(bend.tilt_rad[:, i])
        before.append(R)
        axes.append(R @ joint.axis)
        R = R @ exp_so3((q[:, i] + bend.angle_rad[:, i])[:, None] * joint.axis)
        turned.append(R)
        origins.append(o)
        o = o + np.einsum("nij,nj->ni", R, bend.shift_m[:, i])
        R = R @ exp_so3(bend.turn_rad[:, i])
        # The turn sits at the end of the link: swing the way there back, so that only what follows turns.
        end = arm.joints[i + 1].xyz_m if i + 1 < arm.n else arm.flange_xyz_m
        o = o + turned[-1] @ end - R @ end
    return Frames(
        np.stack(before, 1),
        np.stack(turned, 1),
        np.stack(origins, 1),
        R @ rpy_rotation(arm.flange_rpy_rad),
        o + R @ arm.flange_xyz_m,
        np.stack(axes, 1),
    )


def points_in_base(frames: Frames, targets_m: Array) -> Array:
    """Points (N, K, 3) in the base frame of targets (K, 3) in the flange frame, m."""
    return np.asarray(frames.flange_m[:, None] + np.einsum("nij,kj->nki", frames.flange, targets_m))


def loads_of(arm: Arm, tool: Body, gravity_m_s2: Array, frames: Frames) -> Loads:
    """
    The load on each joint by weight.

    Parameters
    ----------
    arm, tool
        The arm, and the tool in the flange frame.
    gravity_m_s2
        Gravity (3,) in the base frame.
    frames
        Where everything is.

    Returns
    -------
    Loads
        Static: no acceleration.
    """
    n = arm.n
    com = np.stack([b.com_m for b in arm.bodies])
    centres = frames.origin_m + np.einsum("nkij,kj->nki", frames.turned, com)  # (N, n, 3)
    centres = np.concatenate([centres, (frames.flange_m + frames.flange @ tool.com_m)[:, None]], axis=1)
    weights = np.array([*(b.mass_kg for b in arm.bodies), tool.mass_kg])[:, None] * gravity_m_s2  # (n + 1, 3)
    force = np.stack([np.broadcast_to(weights[i:].sum(0), (len(centres), 3)) for i in range(n)], axis=1)
    moment = np.stack(
        [np.cross(centres[:, i:] - frames.origin_m[:, i : i + 1], weights[i:]).sum(1) for i in range(n)], axis=1
    )
    return Loads(force, moment, -np.einsum("nki,nki->nk", moment, frames.axes))
