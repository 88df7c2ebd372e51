"""Layout of a set of sessions: which joints, links, targets and sessions the parameters belong to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clampid.slots import Layout
from clampid.stages.pose_rows import anchor_names, target_names
from experiments.campaign import Campaign
from kinematics.description import RobotDescription

__all__ = ["coupled_joints", "layout_of"]


def coupled_joints(robot: RobotDescription) -> tuple[int, ...]:
    """Joints (from 0) whose transmission is coupled with another's: there arm side and motor side can be separated."""
    off = np.asarray(robot.transmission) - np.diag(np.diag(robot.transmission))
    coupled = (off != 0).any(axis=0) | (off != 0).any(axis=1)
    return tuple(int(i) for i in np.flatnonzero(coupled))


def layout_of(campaigns: Sequence[Campaign]) -> Layout:
    """The layout of one or several sessions of one robot."""
    robot = campaigns[0].robot
    return Layout(
        joints=robot.n,
        targets=target_names(campaigns),
        anchors=anchor_names(campaigns),
        sessions=tuple(f"session{s + 1}" for s in range(len(campaigns))),
        wrist=coupled_joints(robot),
    )
