"""Poses and distances: the arm stands still, and points of it are measured."""

from __future__ import annotations

from collections.abc import Sequence

from clampid.chain.chain import Chain
from clampid.slots import Layout
from clampid.stages import poses
from clampid.stages.pose_rows import pose_rows
from clampid.stages.rows import POSE_CHANNELS, Array, Rows
from clampid.stages.stage_kind import StageKind, StageWords, Wanted
from experiments.campaign import Campaign

__all__ = ["STAGE"]


def _rows(campaigns: Sequence[Campaign], layout: Layout, wanted: Wanted) -> Rows:
    return pose_rows(campaigns, layout, wanted.table or STAGE.name, wanted.base, wanted.anchors)


def _residual(rows: Rows, chain: Chain, theta: Array, offsets: Array) -> tuple[Array, Array]:
    return poses.residual(rows, chain, theta)


def _error(rows: Rows, chain: Chain, theta: Array, offsets: Array) -> Array:
    return poses.residual(rows, chain, theta, len(theta))[0]


def _derivative(rows: Rows, chain: Chain, theta: Array, offsets: Array, first: int) -> Array:
    return poses.residual(rows, chain.once, theta, first)[1]


def _moved(rows: Rows, chain: Chain, theta: Array, offsets: Array, steps: Array) -> Array:
    return poses.moved(rows, chain, theta, steps)


STAGE = StageKind(
    name="poses",
    tables=("poses", "distances"),
    outputs=("joint_angle", "base_twist", "link_twist", "target_shift", "measurement"),
    loads="rest",
    error_unit="m",
    points=True,
    verification="verification",
    side="direction",
    shared_channels=POSE_CHANNELS,
    spring_start=0.1,  # some 200 kNm/rad at the joint, as the main axes of a mid-size arm have
    rows=_rows,
    residual=_residual,
    error=_error,
    derivative=_derivative,
    moved=_moved,
    frozen=poses.frozen_flanks,
    words=StageWords(
        title="Poses",
        rows="measured points",
        folds="poses",
        moved="approached",
        record="the direction of approach",
        measurement="measured poses",
        more="more poses, spread over the joints' full ranges, with other loads and temperatures than these",
    ),
)
