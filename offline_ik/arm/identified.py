"""The identified arm: a model's robot with its effects, as one function from joint values to the flange.

The chain of effects and :func:`clampid.stages.pose_kernel.pose_function` are the very casadi functions that the pose
stage is fitted with; here they are put together with the parameters as constants and the loads as functions of the
posture, so that they can be compiled into one kernel. Tests hold it against the pose stage's own prediction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from clampid.catalogue import catalogue
from clampid.chain.row_symbols import RowSymbols, offer_torque, parameter_columns
from clampid.effect import Effect
from clampid.models.described import robot_of
from clampid.models.model import Model, ModelError, StageModel
from clampid.models.own_effects import effects_of
from clampid.models.ranges import Ranges
from clampid.role_slots import slot_of
from clampid.slots import Layout, Slot
from clampid.stages.pose_kernel import link_points, pose_function
from clampid.stages.pose_rows import REST_FRICTION
from clampid.stages.poses import constants_of
from clampid.stages.reversals import UNKNOWN_WAY
from clampid.stages.stage_kind import kind_of, known_of
from experiments.columns import is_further
from kinematics.gravity import STANDARD_GRAVITY
from kinematics.robot import RobotDescription
from kinematics.screws import cayley
from offline_ik.arm.loads_sx import Loads

__all__ = ["Conditions", "IdentifiedArm", "arm_of", "nominal_arm"]

Array = npt.NDArray[np.float64]

UNPRESSED = 1e-9  # of the rated torque: rounding of what is zero, on a joint across which no weight acts
_AXES = ("rx", "ry", "rz", "x", "y", "z")


@dataclass(frozen=True)
class Conditions:
    """What the arm's position depends on, other than the posture.

    Attributes
    ----------
    direction
        ``(n,)``: in which direction each joint comes to rest, +1, -1, 0 unknown.
    link_temperature, motor_temperature
        ``(n,)``: now, less 20 °C, K.
    elapsed
        Time since the campaign's first row, s.
    """

    direction: Array
    link_temperature: Array
    motor_temperature: Array
    elapsed: float = 0.0

    @classmethod
    def still(cls, n: int) -> Conditions:
        """20 °C, no direction known."""
        return cls(np.zeros(n), np.zeros(n), np.zeros(n))

    @property
    def vector(self) -> Array:
        """``(3n + 1,)``."""
        return np.concatenate([self.direction, self.link_temperature, self.motor_temperature, [self.elapsed]])


@dataclass(frozen=True, eq=False)
class IdentifiedArm:
    """A robot as a model's stage ``poses`` describes it, in one session.

    Attributes
    ----------
    gravity
        ``(3,)``, base frame, m/s².
    tool
        ``(4,)``: (m, m c) of what the flange carries, as declared; flange frame, kg and kg m.
    session
        Whose base and flange, from 0.
    reference
        ``(4, 4)``: the session's guess of the base in the instrument's frame, without the fitted motion.
    lean
        ``(n, 3)``, rad: what decides on flanks beside friction, see :mod:`clampid.fitting.open_flanks`; None: nothing.
    ranges
        What the model was identified on; None: not known.
    """

    robot: RobotDescription
    layout: Layout
    effects: Mapping[str, Effect]
    slots: tuple[Slot, ...]
    theta: Array
    covariance: Array
    gravity: Array
    tool: Array
    session: int = 0
    reference: Array | None = None
    lean: Array | None = None
    ranges: Ranges | None = None

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n

    def with_theta(self, theta: Array) -> IdentifiedArm:
        """The same arm with other values of its parameters."""
        return replace(self, theta=theta)

    def without(self, effect: str) -> IdentifiedArm:
        """The same arm with one effect's parameters at zero: what that effect is worth."""
        gone = np.array([slot.effect == effect for slot in self.slots], dtype=bool)
        return replace(self, theta=np.where(gone, 0.0, self.theta))

    @cached_property
    def base(self) -> Array:
        """``(4, 4)``: the calibrated base in the instrument's frame; static, at no load."""
        values = dict(zip(self.slots, self.theta.tolist(), strict=True))
        place = self.layout.sessions[self.session]
        twist = np.array([values.get(slot_of("base_frame", place, a), 0.0) for a in _AXES])
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = cayley(twist[:3]), twist[3:]
        return np.asarray((np.eye(4) if self.reference is None else self.reference) @ motion)

    def expression(self, q: Any, conditions: Any, mount: Array, theta: Any = None) -> tuple[Any, Any, Any, Any]:
        """Where a frame on the flange is, in the calibrated base's frame.

        Parameters
        ----------
        q, conditions
            Expressions ``(n,)`` and ``(3n + 1,)``, see :attr:`Conditions.vector`.
        mount
            ``(4, 4)``: the frame in the flange's.
        theta
            ``(P,)``, an expression; the arm's own values without it.

        Returns
        -------
        position, rotation
            ``(3,)`` m and ``(3, 3)``.
        jacobian
            ``(6, n)``: d (position, rotation vector) / d q of the arm with its deviations fixed; the loads' change with
            the posture, a thousandth of it, is left out.
        pressing
            ``(n,)``, Nm: its sign is the flank on which each joint stands; None if no effect reads flanks.
        """
        n = self.n
        position, R, S, _, pressing = self.stations(q, conditions, mount, theta)
        return position, R, S[:, :n], pressing

    def stations(self, q: Any, conditions: Any, mount: Array, theta: Any = None) -> tuple[Any, Any, Any, Any, Any]:
        """As :meth:`expression`, with d pose / d station entries ``(6, S)``, the entries ``(S,)``, and what presses."""
        n = self.n
        values, pressing = self._deviations(q, conditions, ca.SX(ca.DM(self.theta)) if theta is None else theta)
        values[7 * n + 6 :] = 0  # no tracked target, no error of an instrument: the detector itself
        static = np.linalg.inv(self.base) @ (np.eye(4) if self.reference is None else self.reference)
        nominal = (self.robot.linkage, self.robot.screws, link_points(self.robot), self.robot.flange)
        poses = pose_function(*(np.asarray(a, dtype=float) for a in nominal))
        frame = ca.DM(np.r_[static[:3, :3].ravel(), static[:3, 3]])
        row = ca.vertcat(q, frame, ca.DM(mount[:3, 3]), values)
        position, rotation, sensitivity = poses(ca.SX(0, 1), row)
        R = ca.reshape(rotation, 3, 3).T @ ca.DM(mount[:3, :3])
        return position, R, ca.reshape(sensitivity, 7 * n + 12, 6).T, values, pressing

    def _deviations(self, q: Any, conditions: Any, theta: Any) -> tuple[Any, Any]:
        """The stations' entries in the order of the pose stage, and what presses on the flanks."""
        active = [self.effects[name] for name in dict.fromkeys(slot.effect for slot in self.slots)]
        index = {slot: k for k, slot in enumerate(self.slots)}
        parameters = {e.name: parameter_columns(e, self.layout, index, theta) for e in active}
        row = RowSymbols(self.layout, constants_of(self.robot), parameters, active)
        stage = kind_of("poses")
        offer_torque(row, stage, active)
        values = ca.vertcat(*(ca.vec(row.total(station, active).T) for station in stage.outputs))
        outputs = [values]
        reads_flank, reads_load = "flank" in row.flats, "torque" in row.offered
        if reads_flank:
            outputs.append(row.offered["torque"] + row.recorded("rest_direction"))
        free = list(ca.symvar(ca.veccat(theta)))
        function = ca.Function("deviations", [ca.vertcat(*free), *row.flats.values()], [ca.densify(v) for v in outputs])
        loads = Loads(self.robot, self.gravity, self.tool, q)
        fixed = {
            "flank": ca.SX.zeros(self.n),
            "sag_torque": ca.SX.zeros(self.n),
        }  # of these what presses is independent
        moving = {name for e in active if not e.of_readings for name in e.needs}
        fixed |= {name: ca.SX.zeros(1) for name in row.flats if is_further(name) and name not in moving}
        signals = fixed | {name: self._signal(name, q, conditions, loads) for name in row.flats if name not in fixed}

        def evaluated() -> Any:
            return function.call([ca.vertcat(*free), *(signals[name] for name in row.flats)])

        pressing = None
        if reads_flank:
            pressing = self._pressing(evaluated()[1], q)
            signals["flank"] = ca.sign(pressing)
        if reads_load:
            signals["sag_torque"] = loads.stiffness @ evaluated()[0][: self.n]
        return evaluated()[0], pressing

    def _pressing(self, level: Any, q: Any) -> Any:
        """Torques on the flanks ``(n,)``, Nm, with the base's tilt; ``level``: without it."""
        pressing = ca.SX(level)
        lean = np.zeros((self.n, 3)) if self.lean is None else self.lean
        for i in np.flatnonzero(lean.any(axis=1)).tolist():
            turned = Loads(self.robot, np.cross(lean[i], self.gravity), self.tool, q)
            pressing[i] += turned.signal("gravity_torque")[i]
        return pressing * (ca.fabs(pressing) > ca.DM(UNPRESSED * self.robot.rated_torques))

    def _signal(self, name: str, q: Any, conditions: Any, loads: Loads) -> Any:  # noqa: PLR0911 (a table)
        n = self.n
        direction = conditions[:n]
        match name:
            case "q":
                return q
            case "motor":
                return ca.DM(np.linalg.inv(np.asarray(self.robot.transmission)).T) @ q
            case "direction" | "joint_motion" | "motor_motion":
                return direction
            case "rest_direction":
                return ca.DM(REST_FRICTION * self.robot.rated_torques) * direction
            case "reversal_way" | "turned_back":  # an approach is as long as its lost motion needs
                return ca.DM.ones(n) * (UNKNOWN_WAY if name == "reversal_way" else 0.0)
            case "link_temperature" | "motor_temperature":
                first = n if name == "link_temperature" else 2 * n
                return conditions[first : first + n]
            case "elapsed":
                return conditions[3 * n]
            case "session_is":
                return ca.DM(self._session_is)
            case "target_is" | "anchor_is":
                return ca.DM.zeros(len(self.layout.targets if name == "target_is" else self.layout.anchors))
            case "position" | "anchor_way":
                return ca.DM.zeros(3)
            case _:
                try:
                    return loads.signal(name)
                except KeyError:
                    raise ModelError(
                        f"the model reads the signal {name!r} in its poses, which a command cannot know"
                    ) from None

    @property
    def _session_is(self) -> Array:
        return np.asarray(np.eye(len(self.layout.sessions))[self.session])


def arm_of(
    model: Model,
    *,
    robot: RobotDescription | None = None,
    gravity: npt.ArrayLike = STANDARD_GRAVITY,
    tool_mass: float | None = None,
    tool_com: npt.ArrayLike = (0.0, 0.0, 0.0),
    session: int = 0,
    user_effects: Path | None = None,
) -> IdentifiedArm:
    """The arm that a model describes.

    Parameters
    ----------
    robot
        The nominal robot, if the model's name for it is not that of a bundled one.
    gravity
        ``(3,)``, base frame, m/s²: a model does not keep it.
    tool_mass, tool_com
        What the flange carries, kg and ``(3,)`` m in the flange frame; the mass by default that of the session.
    session
        Whose base and flange, from 0.

    Raises
    ------
    ModelError
        The model has no poses, no such session, is of another robot, or has effects that are not known.
    """
    nominal = robot_of(model, robot)
    stage: StageModel | None = known_of(model.stages, "points")
    if stage is None:
        raise ModelError("expected a model with a stage poses, found none: joint angles need a geometry")
    if not 0 <= session < len(model.sessions):
        raise ModelError(f"session {session + 1}: the model has sessions 1 to {len(model.sessions)}")
    if nominal.n != model.layout.joints:
        raise ModelError(f"the model has {model.layout.joints} joints, the robot {nominal.name} has {nominal.n}")
    effects = effects_of(model, user_effects)
    if not np.isfinite(stage.theta).all() or not np.isfinite(stage.covariance).all():
        raise ModelError("the model has parameters that are not finite numbers")
    mass = model.sessions[session].tool_mass if tool_mass is None else tool_mass
    return IdentifiedArm(
        nominal,
        model.layout,
        effects,
        stage.slots,
        stage.theta,
        stage.covariance,
        np.asarray(gravity, dtype=float),
        mass * np.r_[1.0, np.asarray(tool_com, dtype=float)],
        session,
        model.sessions[session].base_reference,
        stage.lean,
        stage.ranges,
    )


def nominal_arm(robot: RobotDescription) -> IdentifiedArm:
    """The described robot, without effects."""
    nothing = np.zeros(0)
    return IdentifiedArm(
        robot, Layout(robot.n), catalogue(), (), nothing, np.zeros((0, 0)),
        np.asarray(STANDARD_GRAVITY), np.zeros(4),
    )  # fmt: skip
