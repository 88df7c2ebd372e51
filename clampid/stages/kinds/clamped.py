"""Clamped sweeps: motor torques while springs wind up against a clamped flange."""

from __future__ import annotations

from collections.abc import Sequence

from clampid.slots import Layout
from clampid.stages import clamped
from clampid.stages.clamped_rows import clamped_rows
from clampid.stages.kept_prior import with_kept_friction
from clampid.stages.rows import Rows
from clampid.stages.stage_kind import StageKind, StageWords, Wanted, derivative_of, error_of, moved_of
from experiments.campaign import Campaign

__all__ = ["STAGE"]


def _rows(campaigns: Sequence[Campaign], layout: Layout, wanted: Wanted) -> Rows:
    return clamped_rows(campaigns, layout)


STAGE = StageKind(
    name="clamped",
    tables=("clamped",),
    outputs=("joint_angle", "fixture", "motor_torque", "joint_torque"),
    loads="equilibrium",
    error_unit="sigma",
    offset_size=1e-3,  # rad: of the posture at which the flange was clamped
    rows=_rows,
    residual=clamped.residual,
    error=error_of(clamped.residual),
    derivative=derivative_of(clamped.residual),
    moved=moved_of(clamped.residual),
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
