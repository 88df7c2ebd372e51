"""Inclination: how far the base, or a link, has turned since the first row, as a level or an inclinometer sees it.

Of one body of one session, R(k) its rotation in the base frame at row k, R_0 that of the described robot at the first::

    w(k) = log(R(k) R_0' exp(o)),   about_x = w_x,   about_y = w_y

The constant o ``(3,)``, rad, one for each body and session, is the unknown error of the first row. R(k) is the product
of exponentials of :mod:`clampid.stages.pose_kernel` without positions. All effects of the poses that turn base, joints
or links act here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clampid.chain.chain import Chain
from clampid.slots import Layout
from clampid.stages.loads import standing_loads
from clampid.stages.poses import evaluate, frozen_flanks
from clampid.stages.row_constants import PER_ROW, SeriesConstants
from clampid.stages.rows import Array, Integers, Rows
from clampid.stages.stage_kind import StageKind, StageWords, Wanted, derivative_of, moved_of
from clampid.stages.temperatures import temperatures
from experiments.campaign import Campaign
from experiments.temperatures import filled
from kinematics.description import RobotDescription
from kinematics.screws import cayley, cayley_left_jacobian, exp_so3, hat3, log_so3

__all__ = ["STAGE", "InclinationConstants"]

DEFAULT_STD = 1e-5  # rad: a good electronic level
PARTS = 10  # of a body's rows, held out one after the other
BLOCK_ROWS = 8  # neighbouring rows that share their noise and are flipped together
AXES = 3  # of the unknown constant o
_STANDING = (
    "direction", "joint_motion", "motor_motion", "rest_direction", "reversal_way", "sag_torque", "turned_back",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class InclinationConstants(SeriesConstants):
    """Of inclinations; ``run`` is one body of one session.

    Attributes
    ----------
    body
        ``(N,)``: how many joints are before the body; 0: the base.
    first
        ``(N, 3, 3)``: R_0, the body's rotation at its first row as described.
    """

    body: Integers = field(metadata=PER_ROW)
    first: Array = field(metadata=PER_ROW)


def inclination_rows(campaigns: Sequence[Campaign], layout: Layout) -> Rows:
    """The rows of the table ``inclination`` of one or several sessions."""
    import pandas as pd

    robot, n = campaigns[0].robot, campaigns[0].robot.n
    own = [(s, c) for s, c in enumerate(campaigns) if STAGE.name in c.tables]
    frames = [filled(c.placed(STAGE.name)) for _, c in own]
    sizes = [len(frame) for frame in frames]
    joined, count = pd.concat(frames, ignore_index=True), sum(sizes)
    session = np.repeat([s for s, _ in own], sizes)
    body = np.array([_body(at) for at in joined["at"].astype(str)])
    _, start, run = np.unique(np.c_[session, body], axis=0, return_index=True, return_inverse=True)
    q, time = joined[[f"q{i + 1}_rad" for i in range(n)]].to_numpy(float), joined["time_s"].to_numpy(float)
    parts, signals = [standing_loads(c, q[session == s]) for s, c in own], {}
    for name in parts[0]:
        signals[name] = np.concatenate([part[name] for part in parts])
    none = np.zeros((count, n))
    signals |= {
        "q": q,
        "motor": q @ np.linalg.inv(np.asarray(robot.transmission)),
        **dict.fromkeys(_STANDING, none),
        "elapsed": _elapsed(time, session),
        "session_is": np.eye(len(layout.sessions))[session],
        **{
            name: np.zeros((count, len(of)))
            for name, of in (("target_is", layout.targets), ("anchor_is", layout.anchors))
        },
        **{name: np.zeros((count, 3)) for name in ("anchor_way", "position")},
        **temperatures(joined, n),
    }
    number = _within(run)
    length = np.bincount(run)[run]
    _, fold = np.unique(np.c_[run, number * PARTS // length], axis=0, return_inverse=True)
    _, unit = np.unique(np.c_[run, number // BLOCK_ROWS], axis=0, return_inverse=True)
    std = np.array([c.stated.inclinometer_std or DEFAULT_STD for c in campaigns])[session]
    return Rows(
        stage=STAGE.name,
        robot=robot,
        layout=layout,
        signals=signals,
        measured=joined[["about_x_rad", "about_y_rad"]].to_numpy(float),
        sigma=np.tile(std[:, None], (1, 2)),
        used=np.ones((count, 2), dtype=bool),
        unit=unit.astype(np.int64),
        fold=fold.astype(np.int64),
        table=np.full(count, STAGE.name),
        row=np.concatenate([np.arange(1, size + 1) for size in sizes]),
        session=session,
        constants=InclinationConstants(
            time=time,
            run=run.astype(np.int64),
            offset_keys=np.array([(k, axis) for k in range(len(start)) for axis in range(AXES)]),
            known_noise=np.full(2, max(c.stated.inclinometer_std or np.inf for _, c in own)),
            known_from="instrument",
            body=body,
            first=_rotations(robot, q[start], np.zeros((len(start), 7 * n + 6)), body[start])[0][run],
        ),
    )


def _body(at: str) -> int:
    """How many joints are before a body."""
    return 0 if at == "base" else int(at.removeprefix("link"))


def _elapsed(time: Array, session: Integers) -> Array:
    return np.asarray(time - np.array([time[session == s].min() for s in range(int(session.max()) + 1)])[session])


def _within(run: Integers) -> Integers:
    """The number of each row ``(N,)`` within its run, from 0."""
    out = np.zeros(len(run), dtype=np.int64)
    for r in np.unique(run):
        out[run == r] = np.arange(int(np.sum(run == r)))
    return out


def _rotations(robot: RobotDescription, q: Array, deviations: Array, body: Integers) -> tuple[Array, Array]:
    """Rotations ``(N, 3, 3)`` of the rows' bodies, and what a deviation at each station turns them by ``(N, 3, S)``.

    ``deviations`` ``(N, S)`` at joint angles (n), base (6) and links (6 n), see ``STAGE.outputs``; turns are rotation
    vectors in base axes.
    """
    n, linkage = robot.n, np.asarray(robot.linkage)
    angles = (q + deviations[:, :n]) @ linkage.T
    twist = deviations[:, n:].reshape(len(q), n + 1, 6)[:, :, :3]
    R, turn = cayley(twist[:, 0]), np.zeros((len(q), 3, deviations.shape[1]))
    turn[:, :, n : n + 3] = cayley_left_jacobian(twist[:, 0])
    for i in range(n):
        moves = body > i
        axis = robot.screws[i, :3]
        turn[:, :, :n] += moves[:, None, None] * (R @ axis)[:, :, None] * linkage[i]
        after = R @ exp_so3(axis * angles[:, i, None])
        at = n + 6 * (i + 1)
        turn[:, :, at : at + 3] = moves[:, None, None] * (after @ cayley_left_jacobian(twist[:, i + 1]))
        R = np.where(moves[:, None, None], after @ cayley(twist[:, i + 1]), R)
    return R, turn


def _left_inverse(w: Array) -> Array:
    """D log(exp(e) exp(w)) / d e ``(N, 3, 3)`` at e = 0: the inverse of the left Jacobian of rotation vectors."""
    angle = np.linalg.norm(w, axis=1)
    half = np.maximum(0.5 * angle, 1e-6)
    share = np.where(angle > 1e-4, (1.0 - half / np.tan(half)) / np.maximum(angle, 1e-6) ** 2, 1.0 / 12.0)
    W = np.array([hat3(one) for one in w]).reshape(-1, 3, 3)
    return np.asarray(np.eye(3) - 0.5 * W + share[:, None, None] * (W @ W))


def _constants(rows: Rows) -> InclinationConstants:
    if not isinstance(rows.constants, InclinationConstants):
        raise TypeError(f"expected rows of inclinations, found {type(rows.constants).__name__}")
    return rows.constants


def _predicted(rows: Rows, chain: Chain, theta: Array, offsets: Array) -> tuple[Array, Array, Array, Any]:
    """Turns w ``(N, 3)``, what a small turn of the body does to them ``(N, 3, 3)``, stations' turns, and deviations."""
    constants, deviations = _constants(rows), evaluate(rows, chain, theta)
    R, turn = _rotations(rows.robot, rows.signals["q"], deviations.values, constants.body)
    o = rows.offset_table(offsets)[:, :AXES] if len(offsets) else np.zeros((len(rows), AXES))
    w = log_so3(R @ np.swapaxes(constants.first, 1, 2) @ exp_so3(o))
    return w, _left_inverse(w), turn, deviations


def _error(rows: Rows, chain: Chain, theta: Array, offsets: Array) -> Array:
    return np.asarray(rows.measured - _predicted(rows, chain, theta, offsets)[0][:, :2])


def _residual(rows: Rows, chain: Chain, theta: Array, offsets: Array) -> tuple[Array, Array]:
    w, by_turn, turn, deviations = _predicted(rows, chain, theta, offsets)
    by_station = (by_turn @ turn)[:, :2]
    jacobian = np.zeros((len(rows), 2, len(theta) + len(offsets)))
    for k, (station, parameter) in enumerate(zip(deviations.station, deviations.parameter, strict=True)):
        jacobian[:, :, parameter] += by_station[:, :, station] * deviations.partials[:, k, None]
    if len(offsets):
        # d exp(o) = exp(o) J_r(o) do with J_r(o) the inverse of _left_inverse(-o), and from the right log has -w.
        o = rows.offset_table(offsets)[:, :AXES]
        by_constant = (_left_inverse(-w) @ np.linalg.inv(_left_inverse(-o)))[:, :2]
        for k, (run, axis) in enumerate(rows.series.offset_keys):
            mine = rows.series.run == run
            jacobian[mine, :, len(theta) + k] = by_constant[mine, :, axis]
    return np.asarray(rows.measured - w[:, :2]), jacobian


def _rows(campaigns: Sequence[Campaign], layout: Layout, wanted: Wanted) -> Rows:
    return inclination_rows(campaigns, layout)


STAGE = StageKind(
    name="inclination",
    tables=("inclination",),
    outputs=("joint_angle", "base_twist", "link_twist"),
    loads="rest",
    effects_of="poses",
    error_unit="sigma",
    offset_size=1e-3,  # rad: error of the first row
    spring_start=0.1,
    rows=_rows,
    residual=_residual,
    error=_error,
    derivative=derivative_of(_residual),
    moved=moved_of(_residual),
    frozen=frozen_flanks,
    words=StageWords(
        title="Inclination",
        rows="turns of base or links by an inclinometer",
        folds="parts of the table",
        moved="approached",
        record="the direction of approach",
        measurement="an inclinometer on the base",
        more="inclinations in more postures, with other loads and temperatures than these",
    ),
)
