"""Clamped sweeps: motor torques while springs wind up against a held flange."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from clampid.chain.chain import Chain
from clampid.effect import Effect
from clampid.slots import Layout
from clampid.stages import clamped
from clampid.stages.clamped_rows import clamped_rows
from clampid.stages.kept_prior import with_kept_friction
from clampid.stages.pose_rows import Anchors
from clampid.stages.rows import Array, Rows
from clampid.stages.stage_kind import StageKind, StageWords
from experiments.campaign import Campaign

__all__ = ["STAGE"]


def _rows(
    campaigns: Sequence[Campaign],
    layout: Layout,
    active: Collection[Effect],
    *,
    base: Mapping[int, Array] | None,
    anchors: Anchors | None,
    table: str,
) -> Rows:
    return clamped_rows(campaigns, layout)


def _error(rows: Rows, chain: Chain, theta: Array, offsets: Array) -> Array:
    return clamped.residual(rows, chain, theta, offsets)[0]


def _derivative(rows: Rows, chain: Chain, theta: Array, offsets: Array, first: int) -> tuple[Array, Array]:
    residual, jacobian = clamped.residual(rows, chain, theta, offsets)
    return residual, jacobian[:, :, first : len(theta)]


def _moved(rows: Rows, chain: Chain, theta: Array, offsets: Array, steps: Array) -> Array:
    return clamped.residual(rows, chain, theta, offsets)[1] @ steps


STAGE = StageKind(
    name="clamped",
    tables=("clamped",),
    outputs=("joint_angle", "fixture", "motor_torque", "joint_torque"),
    loads="equilibrium",
    error_unit="sigma",
    offset_size=1e-3,  # rad: of the posture at which the flange was clamped
    rows=_rows,
    residual=clamped.residual,
    error=_error,
    derivative=_derivative,
    moved=_moved,
    prior=with_kept_friction,
    words=StageWords(
        title="Clamped (torques)",
        rows="torques with the flange clamped",
        folds="sweeps",
        moved="moved",
        record="the direction of motion",
        measurement="sweeps against a clamped flange",
        more="more sweeps, in other postures, with other amplitudes and temperatures than these",
    ),
)
