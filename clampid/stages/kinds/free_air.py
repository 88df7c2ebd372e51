"""Free air and wrist: motor torques of an arm that moves and stops."""

from __future__ import annotations

from collections.abc import Sequence

from clampid.chain.chain import Chain
from clampid.slots import Layout
from clampid.stages import torques
from clampid.stages.counting import explained
from clampid.stages.rows import Array, Rows
from clampid.stages.stage_kind import StageKind, StageWords, Wanted
from experiments.campaign import Campaign

__all__ = ["STAGE"]


def _rows(campaigns: Sequence[Campaign], layout: Layout, wanted: Wanted) -> Rows:
    return torques.torque_rows(campaigns, layout, *explained(wanted.active))


def _derivative(rows: Rows, chain: Chain, theta: Array, offsets: Array, first: int) -> Array:
    return torques.derivative(rows, chain, theta, first)


def _moved(rows: Rows, chain: Chain, theta: Array, offsets: Array, steps: Array) -> Array:
    return torques.moved(rows, chain, theta, steps)


STAGE = StageKind(
    name="free_air",
    tables=("free_air", "wrist"),
    outputs=("joint_torque", "motor_torque"),
    loads="moving",
    error_unit="sigma",
    side="joint_motion",
    offset_size=0.5,  # Nm: friction of a joint that stood still
    linear=True,
    rows=_rows,
    residual=torques.residual,
    error=torques.error,
    derivative=_derivative,
    moved=_moved,
    words=StageWords(
        title="Free air and wrist (torques)",
        rows="torques in free air",
        folds="runs",
        moved="moved",
        record="the direction of motion",
        measurement="a log of torques in free air",
        more="a longer log over the joints' full ranges, with other loads, speeds and temperatures than this one",
    ),
)
