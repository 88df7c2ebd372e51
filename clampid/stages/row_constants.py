"""Constants of rows beside their signals, such as reference frames, the run of each row, and its start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from clampid.stages.statements import Statement

__all__ = ["LogConstants", "PoseConstants", "RowConstants", "SeriesConstants", "SweepConstants", "joined"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]
C = TypeVar("C", bound="RowConstants")
PER_ROW = {"per_row": True}  # metadata of a field that has one entry per row


@dataclass(frozen=True, kw_only=True)
class RowConstants:
    """Of any rows.

    Attributes
    ----------
    time
        ``(N,)``, s, on the clock of the table.
    noise_axes
        ``(N, 3, 3)``, columns: unit vectors along which errors of positions are independent; None: x, y, z.
    stated
        What the campaigns state of base and targets.
    """

    time: Array = field(metadata=PER_ROW)
    noise_axes: Array | None = field(default=None, metadata=PER_ROW)
    stated: tuple[Statement, ...] = ()

    def take(self, chosen: npt.NDArray[Any]) -> Self:
        """Those of the chosen rows (indices or mask)."""
        values = {name: getattr(self, name) for name in per_row(self)}
        return replace(self, **{name: value[chosen] for name, value in values.items() if value is not None})


@dataclass(frozen=True, kw_only=True)
class SeriesConstants(RowConstants):
    """Of rows that follow each other in runs or sweeps.

    Attributes
    ----------
    run
        ``(N,)``: the run or sweep, from 0.
    offset_keys
        ``(K, 2)``, (run or sweep, joint from 0): an unknown constant of that joint in that run, which no other run
        shares; in sweeps (sweep, n + motor): the friction that a motor keeps while at rest.
    known_noise
        ``(m,)``, SI: noise of each column as known without the model under test, inf where unknown; None: unknown in
        all columns.
    known_from
        Source of that: ``repeated_runs`` of one motion, ``regression`` on rigid-body dynamics, or the statement of the
        ``instrument``'s maker. Of several it is the first.
    """

    run: Integers = field(metadata=PER_ROW)
    offset_keys: Integers = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    known_noise: Array | None = None
    known_from: Literal["repeated_runs", "regression", "instrument"] = "regression"

    def take(self, chosen: npt.NDArray[Any]) -> Self:
        """Those of the chosen rows, and the unknown constants of runs that are left."""
        out = super().take(chosen)
        return replace(out, offset_keys=out.offset_keys[np.isin(out.offset_keys[:, 0], out.run)])


@dataclass(frozen=True, kw_only=True)
class LogConstants(SeriesConstants):
    """Of torque logs.

    Attributes
    ----------
    together
        How many neighbouring rows share their noise, because a filter has smoothed them.
    log_row
        ``(N,)``: the row in all logs joined, from 0.
    gravity_vector
        ``(S, 3)``, m/s², of each session, base frame.
    weight
        ``(S, 4n)``, kg and kg m: (m, m c) of each session's links as described, the tool with them.
    """

    together: int
    log_row: Integers = field(metadata=PER_ROW)
    gravity_vector: Array
    weight: Array


@dataclass(frozen=True, kw_only=True)
class SweepConstants(SeriesConstants):
    """Of sweeps against a clamped flange.

    Attributes
    ----------
    driven
        ``(N,)``: the joint that goes back and forth, from 0.
    wound
        ``(N, n)``, rad: joint angles from the motors, less the sweep's mean posture.
    reference
        ``(sweeps, n)``, rad: these postures.
    inverse_jacobian
        ``(N, n, 6)``: joint speeds by the flange's motion (w, v), base frame.
    start_torque
        ``(N, n)``, Nm: measured torques at the joints.
    rated
        ``(n,)``, Nm: rated torques of the joints.
    loop_compliance
        ``(n,)``, rad/Nm: of the motors' springs, by the slopes of the loops.
    loop_friction
        ``(n,)``, Nm: friction of each motor, by the heights of its loops.
    stood
        ``(sweeps, n)``: whether a motor stood still in the whole sweep.
    kept_sign
        ``(sweeps, n)``: side, +1 or -1, of the friction that a motor keeps from the sweep before; 0: not known.
    """

    driven: Integers = field(metadata=PER_ROW)
    wound: Array = field(metadata=PER_ROW)
    reference: Array
    inverse_jacobian: Array = field(metadata=PER_ROW)
    start_torque: Array = field(metadata=PER_ROW)
    rated: Array
    loop_compliance: Array
    loop_friction: Array
    stood: Bools
    kept_sign: Array


@dataclass(frozen=True, kw_only=True)
class PoseConstants(RowConstants):
    """Of measured points and distances.

    Attributes
    ----------
    target
        ``(N, 3)``, m: the nominal point, flange frame.
    base_reference
        ``(N, 4, 4)``: where the instrument sees the base, before what is fitted.
    ranged
        ``(N,)``: whether the row is a distance.
    oriented
        ``(N,)``: whether a rotation was measured.
    rotation
        ``(N, 3, 3)``: that rotation, flange to instrument frame; else the identity.
    anchor
        ``(N, 3)``, m: where a distance was measured from, instrument frame; else zero.
    link_recorded
        ``(N, n)``: whether the temperature of a link was recorded.
    tool_mass
        ``(N,)``, kg, as declared.
    log_friction
        ``(n,)``, Nm: dry friction at each joint in torque logs, of motor and arm side together; infinite where no log
        identifies it, or where the load is smaller. None: not looked up.
    flank_friction
        The same whatever the load: a friction that may select the flanks of a clearance that is not in the model.
    """

    target: Array = field(metadata=PER_ROW)
    base_reference: Array = field(metadata=PER_ROW)
    ranged: Bools = field(metadata=PER_ROW)
    oriented: Bools = field(metadata=PER_ROW)
    rotation: Array = field(metadata=PER_ROW)
    anchor: Array = field(metadata=PER_ROW)
    link_recorded: Bools = field(metadata=PER_ROW)
    tool_mass: Array = field(metadata=PER_ROW)
    log_friction: Array | None = None
    flank_friction: Array | None = None


def per_row(constants: RowConstants) -> tuple[str, ...]:
    """The names of the fields that have one entry per row."""
    return tuple(f.name for f in fields(constants) if f.metadata.get("per_row"))


def joined(parts: Sequence[C]) -> C:
    """Those of several blocks of rows one after the other; what is not per row is that of the first block.

    A field that some blocks lack must be None in all of them.
    """
    columns = {name: [getattr(p, name) for p in parts] for name in per_row(parts[0])}
    found: dict[str, Any] = {name: np.concatenate(v) for name, v in columns.items() if v[0] is not None}
    return replace(parts[0], **found)
