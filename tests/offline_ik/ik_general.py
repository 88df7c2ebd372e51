"""The identified arm through clampid's own chain of effects and pose stage: what the kernels are held against."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from clampid.chain.chain import build_chain
from clampid.stages.loads import bearing_signals, declared_weight, gravity_signals, weight_stiffness
from clampid.stages.pose_rows import REST_FRICTION
from clampid.stages.poses import constants_of, evaluate, predict
from clampid.stages.reversals import UNKNOWN_WAY
from clampid.stages.row_constants import PoseConstants
from clampid.stages.rows import Rows
from clampid.stages.stage_kind import kind_of
from experiments.campaign import Campaign, Instrument, Tool
from offline_ik.arm.identified import Conditions, IdentifiedArm

Array = npt.NDArray[np.float64]


def general(arm: IdentifiedArm, q: Array, conditions: Conditions, target: Array) -> tuple[Array, Array, Array]:
    """Points and orientations through clampid's own prediction.

    Parameters
    ----------
    q
        ``(N, n)``, the controller's joint values, rad.
    target
        ``(3,)``: the point, in the flange frame, m.

    Returns
    -------
    position, rotation
        ``(N, 3)`` m and ``(N, 3, 3)`` of the flange, instrument frame.
    jacobian
        ``(N, 6, P)``: d (position, rotation vector) / d theta.
    """
    chain = build_chain(kind_of("poses"), arm.slots, arm.effects, arm.layout, constants_of(arm.robot))
    rows = _rows(arm, np.atleast_2d(q), conditions, target)
    deviations = evaluate(rows, chain, arm.theta)
    measured = slice(chain.offsets["measurement"].start, None)
    deviations.values[:, measured] = 0.0
    position, rotation, sensitivity = predict(rows, deviations)
    sensitivity[:, :, measured] = 0.0
    jacobian = np.zeros((len(rows), 6, len(arm.slots)))
    for k, (station, parameter) in enumerate(zip(deviations.station, deviations.parameter, strict=True)):
        jacobian[:, :, parameter] += sensitivity[:, :, station] * deviations.partials[:, k, None]
    return position, rotation, jacobian


def campaign_of(arm: IdentifiedArm) -> Campaign:
    """A campaign without tables on that arm, with its gravity and its tool."""
    declared = Tool(float(arm.tool[0]), arm.tool[1:] / arm.tool[0] if arm.tool[0] else np.zeros(3))
    return Campaign(
        "",
        None,
        arm.robot,
        arm.gravity,
        declared,
        {},
        Instrument("command", None, None),
        MappingProxyType({}),
        "",
    )


def _rows(arm: IdentifiedArm, q: Array, conditions: Conditions, target: Array) -> Rows:
    count, campaign = len(q), campaign_of(arm)

    def each(value: Array) -> Array:
        return np.tile(value, (count, 1))

    direction = each(conditions.direction)
    signals = {
        "q": q,
        "motor": q @ np.linalg.inv(np.asarray(arm.robot.transmission)),
        "direction": direction,
        "joint_motion": direction,
        "motor_motion": direction,
        "rest_direction": REST_FRICTION * arm.robot.rated_torques * direction,
        "reversal_way": np.full((count, arm.robot.n), UNKNOWN_WAY),
        "turned_back": np.zeros((count, arm.robot.n)),
        "elapsed": np.full(count, conditions.elapsed),
        "target_is": np.zeros((count, len(arm.layout.targets))),
        "anchor_is": np.zeros((count, len(arm.layout.anchors))),
        "session_is": each(arm._session_is),
        "position": np.zeros((count, 3)),
        "anchor_way": np.zeros((count, 3)),
        "link_temperature": each(conditions.link_temperature),
        "motor_temperature": each(conditions.motor_temperature),
        "weight_stiffness": weight_stiffness(campaign.robot, declared_weight(campaign), campaign.gravity, q),
        **gravity_signals(campaign, q),
        **bearing_signals(campaign, q),
    }
    zero = np.zeros(count, dtype=np.int64)
    reference = np.eye(4) if arm.reference is None else arm.reference
    return Rows(
        "poses", arm.robot, arm.layout, signals, np.zeros((count, 3)), np.ones((count, 3)),
        np.ones((count, 3), dtype=bool), zero, zero, np.full(count, "command"), zero, zero,
        PoseConstants(
            time=np.zeros(count), target=each(target), base_reference=np.tile(reference, (count, 1, 1)),
            ranged=np.zeros(count, dtype=bool), oriented=np.zeros(count, dtype=bool),
            rotation=np.tile(np.eye(3), (count, 1, 1)), anchor=np.zeros((count, 3)),
            link_recorded=np.zeros((count, arm.robot.n), dtype=bool), tool_mass=np.zeros(count),
        ),
    )  # fmt: skip
