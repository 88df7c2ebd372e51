"""Rows of the pose experiment from the tables poses and distances, or verification."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from clampid.slots import Layout
from clampid.stages.further_columns import further_signals
from clampid.stages.loads import standing_loads
from clampid.stages.reversals import since_reversal
from clampid.stages.row_constants import PoseConstants, joined
from clampid.stages.rows import Array, Bools, Rows
from clampid.stages.statements import stated_base_pose, statements_of
from clampid.stages.temperatures import link_recorded, temperatures
from experiments.campaign import Campaign, Instrument
from experiments.columns import POSES, is_further
from experiments.measures.lateration import locate
from experiments.temperatures import filled
from kinematics.poe import forward
from kinematics.screws import nearest_rotation

__all__ = [
    "Anchors",
    "align",
    "anchor_names",
    "anchors_of",
    "join_rows",
    "pose_rows",
    "quaternion_to_rotation",
    "target_names",
]

DEFAULT_POSITION_STD = 1e-4  # m, of points and of distances, where the instrument's maker says nothing
DEFAULT_ORIENTATION_STD = 3e-4  # rad
REST_FRICTION = 1e-3  # of rated torque: the dry friction that any bearing has, which decides an unloaded joint's flank


Anchors = Mapping[int, Mapping[str, Array]]
"""Session → anchor → its place ``(3,)``, m, instrument frame."""


def target_names(campaigns: Sequence[Campaign]) -> tuple[str, ...]:
    """The targets of all sessions, each session's own: ``session/target`` where there are several sessions."""
    return _names(campaigns, POSES, "target")


def anchor_names(campaigns: Sequence[Campaign]) -> tuple[str, ...]:
    """The anchors of all sessions' distances, named like their targets."""
    return _names(campaigns, ("distances",), "anchor")


def _names(campaigns: Sequence[Campaign], tables: Sequence[str], column: str) -> tuple[str, ...]:
    names: list[str] = []
    for s, campaign in enumerate(campaigns):
        seen: dict[str, None] = {}
        for table in tables:
            if table in campaign.tables:
                seen |= dict.fromkeys(str(t) for t in campaign.tables[table][column].unique())
        names += [_label(s, t, len(campaigns)) for t in seen if t != "flange"]
    return tuple(names)


def _label(session: int, name: str, sessions: int) -> str:
    return name if sessions == 1 else f"session{session + 1}:{name}"


def _is_own(labels: Sequence[str], names: Sequence[str], session: int, sessions: int) -> Array:
    """``(N, labels)``: 1 at the label of each row's name, in that session."""
    own = {label: k for k, label in enumerate(labels)}
    out = np.zeros((len(names), len(labels)))
    for i, name in enumerate(names):
        label = _label(session, str(name), sessions)
        if label in own:
            out[i, own[label]] = 1.0
    return out


def pose_rows(
    campaigns: Sequence[Campaign],
    layout: Layout,
    table: str,
    base: Mapping[int, Array] | None = None,
    anchors: Anchors | None = None,
) -> Rows:
    """Rows of one table of one or several sessions; with those of ``poses`` go those of ``distances``.

    Parameters
    ----------
    base
        Session → ``(4, 4)``, the robot's base in the instrument's frame. Without it: as the campaign states; else by
        aligning the nominal robot with the measured points; for distances only, the base frame itself.
    anchors
        Session → anchor → ``(3,)``, where the instrument sees that. Without it they are located from the distances to
        the nominal robot's targets.
    """
    parts: list[Rows] = []
    references: list[Array | None] = [None] * len(campaigns)
    for s, campaign in enumerate(campaigns):
        reference = None
        for name in (table, "distances") if table == "poses" else (table,):
            if name in campaign.tables:
                reference = base[s] if base is not None else reference
                seen = None if anchors is None else anchors[s]
                parts.append(_one(campaign, s, len(campaigns), layout, name, reference, seen))
                reference = parts[-1].pose.base_reference[0]
                references[s] = reference if name != "distances" else references[s]
    rows = parts[0] if len(parts) == 1 else join_rows(parts)
    stated = statements_of(campaigns, layout, references)
    return replace(rows, constants=replace(rows.constants, stated=stated)) if stated else rows


def anchors_of(rows: Rows) -> dict[int, dict[str, Array]]:
    """Session → anchor → ``(3,)`` m, where the rows have it before its fitted shift, in the instrument's frame."""
    found: dict[int, dict[str, Array]] = {}
    for k, label in enumerate(rows.layout.anchors):
        mine = np.flatnonzero(rows.signals["anchor_is"][:, k])
        if len(mine):
            session = int(rows.session[mine[0]])
            name = label if len(rows.layout.sessions) == 1 else label.removeprefix(f"session{session + 1}:")
            found.setdefault(session, {})[name] = rows.pose.anchor[mine[0]]
    return found


@dataclass(frozen=True)
class _Read:
    """Readings of an instrument: columns of the rows' numbers ``(N, m)``, and further fields of some instruments.

    See :class:`clampid.stages.row_constants.PoseConstants`; ``axes`` as ``noise_axes`` there.
    """

    measured: Array
    sigma: Array
    used: Bools
    reference: Array
    position: Array
    anchor_way: Array
    rotation: Array
    oriented: Bools
    anchor: Array
    axes: Array | None = None


def _read_points(campaign: Campaign, frame: pd.DataFrame, points: Array, reference: Array | None) -> _Read:
    """Points and, where there are any, orientations; ``points`` ``(N, 3)`` as the nominal robot has them, m."""
    count, instrument = len(frame), campaign.instrument
    position = frame[["x_m", "y_m", "z_m"]].to_numpy(float)
    sigma, axes = _position_noise(instrument, position)
    rotated = all(c in frame.columns for c in ("qw", "qx", "qy", "qz"))
    measured, rotation = position, np.tile(np.eye(3), (count, 1, 1))
    if rotated:
        rotation = quaternion_to_rotation(frame[["qw", "qx", "qy", "qz"]].to_numpy(float))
        measured = np.c_[position, np.zeros((count, 3))]
        sigma = np.c_[sigma, np.full((count, 3), instrument.orientation_std or DEFAULT_ORIENTATION_STD)]
    reference = _seen_base(campaign, points, position) if reference is None else reference
    return _Read(
        measured=measured,
        sigma=sigma,
        used=np.ones(measured.shape, dtype=bool),
        reference=reference,
        # Not where they were measured: what a fit leaves of such a column is the noise, which then explains itself.
        position=_in_instrument(points, reference),
        anchor_way=np.zeros((count, 3)),
        rotation=rotation,
        oriented=np.full(count, rotated),
        anchor=np.zeros((count, 3)),
        axes=axes,
    )


def _in_instrument(points: Array, base: Array) -> Array:
    """Points ``(N, 3)`` of the base frame in the instrument's, m, which sees the base at ``base`` ``(4, 4)``."""
    return np.asarray(points @ base[:3, :3].T + base[:3, 3])


def _seen_base(campaign: Campaign, points: Array, position: Array) -> Array:
    """Where the instrument sees the base: as stated, else as the nominal robot's points fit best."""
    stated = campaign.stated.base
    return align(points, position) if stated is None else stated_base_pose(stated, points, position)


def _read_distances(
    campaign: Campaign,
    frame: pd.DataFrame,
    points: Array,
    reference: Array | None,
    anchors: Mapping[str, Array] | None,
) -> _Read:
    """Distances from anchors; the columns of positions have the nominal robot's points, which do not count."""
    count, instrument = len(frame), campaign.instrument
    reference = np.eye(4) if reference is None else reference
    points = _in_instrument(points, reference)
    names, distance = frame["anchor"].astype(str).to_numpy(), frame["distance_m"].to_numpy(float)
    anchor = np.zeros((count, 3))
    for name in dict.fromkeys(names):
        mine = names == name
        anchor[mine] = locate(points[mine], distance[mine]).place if anchors is None else anchors[name]
    way = points - anchor
    sigma = np.full(count, instrument.distance_std or DEFAULT_POSITION_STD)
    if instrument.distance_std is None and instrument.tracker is not None:
        sigma = instrument.tracker.range_std + instrument.tracker.range_rate * distance
    return _Read(
        measured=np.c_[points, np.zeros((count, 3)), distance],
        sigma=np.c_[np.ones((count, 6)), sigma],
        used=np.tile(np.arange(7) == 6, (count, 1)),
        reference=reference,
        position=np.zeros((count, 3)),  # the scale of an instrument that sees points is not that of distances
        anchor_way=way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12),
        rotation=np.tile(np.eye(3), (count, 1, 1)),
        oriented=np.zeros(count, dtype=bool),
        anchor=anchor,
    )


def _one(
    campaign: Campaign,
    session: int,
    sessions: int,
    layout: Layout,
    table: str,
    reference: Array | None,
    anchors: Mapping[str, Array] | None,
) -> Rows:
    robot, n = campaign.robot, campaign.robot.n
    recorded, own = campaign.placed(table), [t for t in POSES if t in campaign.tables]
    frame = filled(recorded, (campaign.placed(t) for t in own if t != table))
    count = len(frame)
    q = frame[[f"q{i + 1}_rad" for i in range(n)]].to_numpy(float)
    direction = frame[[f"dir{i + 1}" for i in range(n)]].to_numpy(float)
    reversal_way, turned_back = since_reversal(campaign, table)
    names = frame["target"].astype(str).to_numpy()
    target = np.array([campaign.targets.get(name, np.zeros(3)) for name in names])
    session_is = np.zeros((count, len(layout.sessions)))
    session_is[:, session] = 1.0
    nominal = forward(robot.screws, robot.flange, q @ np.asarray(robot.linkage).T)
    points = np.einsum("nij,nj->ni", nominal[:, :3, :3], target) + nominal[:, :3, 3]
    ranged = table == "distances"
    if ranged:
        read = _read_distances(campaign, frame, points, reference, anchors)
    else:
        read = _read_points(campaign, frame, points, reference)
    anchor_names = frame["anchor"].astype(str).tolist() if ranged else [""] * count
    time = frame["time_s"].to_numpy(float)
    start = min(float(campaign.tables[t]["time_s"].min()) for t in own)
    _, fold = np.unique(frame["pose"].to_numpy(), return_inverse=True)
    _, unit = np.unique(np.c_[frame["pose"].to_numpy(), frame["visit"].to_numpy()], axis=0, return_inverse=True)
    signals = {
        "q": q,
        "motor": q @ np.linalg.inv(np.asarray(robot.transmission)),
        "direction": direction,
        "reversal_way": reversal_way,
        "turned_back": turned_back,
        "joint_motion": direction,
        "motor_motion": direction,
        "rest_direction": REST_FRICTION * robot.rated_torques * direction,
        "elapsed": time - start,
        "target_is": _is_own(layout.targets, names.tolist(), session, sessions),
        "anchor_is": _is_own(layout.anchors, anchor_names, session, sessions),
        "session_is": session_is,
        "anchor_way": read.anchor_way,
        "position": read.position,
        **standing_loads(campaign, q),
        "sag_torque": np.zeros((count, n)),
        **temperatures(frame, n),
        **further_signals(frame, {t: campaign.tables[t] for t in own}, n),
    }
    return Rows(
        stage="poses",
        robot=robot,
        layout=layout,
        signals=signals,
        measured=read.measured,
        sigma=read.sigma,
        used=read.used,
        unit=unit.astype(np.int64),
        fold=fold.astype(np.int64),
        table=np.full(count, table),
        row=np.arange(1, count + 1),
        session=np.full(count, session),
        constants=PoseConstants(
            target=target,
            ranged=np.full(count, ranged),
            base_reference=np.tile(read.reference, (count, 1, 1)),
            time=time,
            link_recorded=link_recorded(recorded, n),
            tool_mass=np.full(count, float(campaign.tool.mass)),
            rotation=read.rotation,
            oriented=read.oriented,
            anchor=read.anchor,
            noise_axes=read.axes,
        ),
    )


def _position_noise(instrument: Instrument, position: Array) -> tuple[Array, Array | None]:
    """Standard deviations ``(N, 3)``, m, of positions ``(N, 3)``, instrument frame, and their axes if not x, y, z.

    A tracker's are along the beam, a + b r, and across it, r times that of its angles.
    """
    tracker = instrument.tracker
    if tracker is None:
        return np.full(position.shape, instrument.position_std or DEFAULT_POSITION_STD), None
    r = np.linalg.norm(position, axis=1, keepdims=True)
    beam = position / np.maximum(r, 1e-9)
    # Any two axes across the beam do: both angles have the same error.
    across = np.cross(beam, np.eye(3)[np.argmin(np.abs(beam), axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    sigma = np.hstack([tracker.range_std + tracker.range_rate * r, *[tracker.angle_std * r] * 2])
    return np.maximum(sigma, 1e-9), np.stack([beam, across, np.cross(beam, across)], axis=-1)


def _with_axes(parts: Sequence[Rows]) -> Sequence[Rows]:
    """The parts, axes of noise in all of them if one has any: x, y, z where none are given."""
    if all(p.constants.noise_axes is None for p in parts):
        return parts
    plain = [p for p in parts if p.constants.noise_axes is None]
    straight = {id(p): np.tile(np.eye(3), (len(p), 1, 1)) for p in plain}
    return [
        replace(p, constants=replace(p.constants, noise_axes=straight[id(p)])) if id(p) in straight else p
        for p in parts
    ]


def join_rows(parts: Sequence[Rows]) -> Rows:
    """Several blocks of pose rows as one, each with its own poses and visits."""
    parts = _with_axes(parts)
    width = max(p.measured.shape[1] for p in parts)

    def widen(a: Array, fill: float) -> Array:
        return np.c_[a, np.full((len(a), width - a.shape[1]), fill)] if a.shape[1] < width else a

    names = dict.fromkeys(name for p in parts for name in p.signals)  # not every session has every sensor
    have = {k: [p.signals[k] for p in parts if k in p.signals] for k in names}
    absent = {k: float(np.mean(np.concatenate(v))) if is_further(k) else 0.0 for k, v in have.items()}
    first, shift_unit, shift_fold = parts[0], 0, 0
    units, folds = [], []
    for p in parts:
        units.append(p.unit + shift_unit)
        folds.append(p.fold + shift_fold)
        shift_unit, shift_fold = int(units[-1].max()) + 1, int(folds[-1].max()) + 1
    return Rows(
        stage="poses",
        robot=first.robot,
        layout=first.layout,
        signals={k: np.concatenate([p.signals.get(k, np.full(len(p), absent[k])) for p in parts]) for k in names},
        measured=np.concatenate([widen(p.measured, 0.0) for p in parts]),
        sigma=np.concatenate([widen(p.sigma, 1.0) for p in parts]),
        used=np.concatenate([widen(p.used.astype(float), 0.0) for p in parts]) > 0.5,
        unit=np.concatenate(units),
        fold=np.concatenate(folds),
        table=np.concatenate([p.table for p in parts]),
        row=np.concatenate([p.row for p in parts]),
        session=np.concatenate([p.session for p in parts]),
        constants=joined([p.constants for p in parts]),
    )


def align(points: Array, measured: Array) -> Array:
    """The rigid motion ``(4, 4)`` that takes ``points`` ``(N, 3)`` nearest to ``measured`` (Kabsch's solution)."""
    a, b = np.median(points, axis=0), np.median(measured, axis=0)
    keep = np.ones(len(points), dtype=bool)
    out = np.eye(4)
    for _ in range(3):  # once more without what is far off: a wrong row must not turn the frame
        a, b = points[keep].mean(axis=0), measured[keep].mean(axis=0)
        R = nearest_rotation(points[keep] - a, measured[keep] - b)
        out[:3, :3], out[:3, 3] = R, b - R @ a
        far = np.linalg.norm(points @ R.T + out[:3, 3] - measured, axis=1)
        keep = far <= 6 * np.median(far) + 1e-12
    return out


def quaternion_to_rotation(q: Array) -> Array:
    """Rotation matrices ``(N, 3, 3)`` from unit quaternions ``(N, 4)``, scalar first."""
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return np.moveaxis(R, 2, 0)
