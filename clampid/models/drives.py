"""Results of the clamped stage for each drive: spring, clearance, friction, and the compliance matrix.

Springs are found as compliances c at the motors, so that everything here is linear in what was fitted, or one step from
it: k = 1/c (Nm/rad at the motor), k/T_ii² (Nm/rad at the joint, the own spring alone), and the compliance at the joints
C = Tᵀ (diag(c) + X) T, whose terms off the diagonal couple the wrist. Source: the thesis, appendix, in the consistent
form of appendix_data/DERIVATION.md. The detection limit is Currie's: Limits for qualitative detection and quantitative
determination, Anal. Chem. 40, 1968, equation 4a with both risks 5 %.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clampid.models.model import Model, ModelError, StageModel
from clampid.role_slots import any_of_role, has_role
from clampid.roles import Role
from clampid.slots import Slot
from clampid.stages.rows import Array, Bools
from clampid.stages.stage_kind import known_of
from kinematics.robot import RobotDescription

__all__ = ["DETECTION", "Drives", "clamped_drives", "drives_of", "effective_compliance"]

DETECTION = 2 * 1.6448536269514722
"""Standard errors in a detection limit: a clearance of half the limit passes it in 5 % of campaigns, and nothing does
so in 0.05 %; one of twice the limit stays below it in 0.05 %."""


@dataclass(frozen=True)
class Drives:
    """The drives of one robot with standard errors; NaN where an effect is not in the model.

    Attributes
    ----------
    stiffness, stiffness_std
        ``(n,)`` Nm/rad at the motors: the thesis' table.
    joint_stiffness, joint_stiffness_std
        ``(n,)`` Nm/rad at the joints, of each drive's own spring, k/T_ii².
    compliance, compliance_std
        ``(n, n)`` rad/Nm at the joints, all springs: deflection per torque.
    gap, gap_std, gap_limit
        ``(n,)`` rad at the joints: clearance, and the smallest that can be detected.
    friction, friction_std
        ``(n,)`` Nm at the motors, half the height of the loop.
    """

    stiffness: Array
    stiffness_std: Array
    joint_stiffness: Array
    joint_stiffness_std: Array
    compliance: Array
    compliance_std: Array
    gap: Array
    gap_std: Array
    gap_limit: Array
    friction: Array
    friction_std: Array

    @property
    def gap_identified(self) -> Bools:
        """Which clearances ``(n,)`` differ from zero: those above their detection limit."""
        return np.asarray(self.gap > self.gap_limit)

    def to_json(self) -> dict[str, Any]:
        """For programs; SI, NaN where not known."""
        found = {name: getattr(self, name).tolist() for name in self.__dataclass_fields__}
        units = {"stiffness": "Nm_rad", "joint_stiffness": "Nm_rad", "compliance": "rad_Nm", "gap": "rad"}
        units["friction"] = "Nm"

        def key(name: str) -> str:
            base = name.removesuffix("_std").removesuffix("_limit")
            return f"{name}_{units[base]}"

        return {key(name): values for name, values in found.items()} | {
            "gap_told_from_zero": self.gap_identified.tolist()
        }


def drives_of(stage: StageModel, robot: RobotDescription) -> Drives:
    """The drives as a stage with springs knows them.

    Parameters
    ----------
    stage
        ``clamped``, or ``poses`` with springs.
    robot
        Whose transmission joins motors and joints.

    Raises
    ------
    ModelError
        The stage has no springs.
    """
    n = robot.n
    if not any_of_role(stage.slots, "compliance"):
        raise ModelError(f"the stage {stage.stage} has no joint_compliance, so that nothing is known of its springs")
    c, c_std = _per_joint(stage, "compliance", n)
    gap, gap_std = _per_joint(stage, "clearance", n)
    friction, friction_std = _per_joint(stage, "dry_friction", n)
    with np.errstate(divide="ignore", invalid="ignore"):
        k = np.where(c > 0, 1.0 / c, np.nan)
    own = np.diag(np.asarray(robot.transmission)) ** 2
    matrix, by = effective_compliance(stage, robot)
    spread = np.sqrt(np.maximum(np.einsum("ap,pq,aq->a", by, stage.covariance, by), 0.0))
    return Drives(
        stiffness=k,
        stiffness_std=k**2 * c_std,
        joint_stiffness=k / own,
        joint_stiffness_std=k**2 * c_std / own,
        compliance=matrix,
        compliance_std=spread.reshape(n, n),
        gap=gap,
        gap_std=gap_std,
        gap_limit=DETECTION * gap_std,
        friction=friction,
        friction_std=friction_std,
    )


def clamped_drives(model: Model, robot: RobotDescription) -> Drives | None:
    """The drives as a model's clamped stage knows them; None where it has no such stage, or no springs in it."""
    stage = known_of(model.stages, "solved")
    if stage is None or not any_of_role(stage.slots, "compliance"):
        return None
    return drives_of(stage, robot)


def effective_compliance(stage: StageModel, robot: RobotDescription) -> tuple[Array, Array]:
    """Compliance at the joints ``(n, n)``, rad/Nm, and its derivative ``(n n, P)`` by the stage's parameters."""
    n, T = robot.n, np.asarray(robot.transmission)
    by = np.zeros((n * n, len(stage.slots)))
    for k, slot in enumerate(stage.slots):
        i = _joint(slot)
        motor = np.zeros((n, n))
        if has_role(slot, "compliance"):
            motor[i, i] = 1.0
        elif has_role(slot, "cross_compliance") and i > 0:
            motor[i, i - 1] = motor[i - 1, i] = 1.0
        by[:, k] = (T.T @ motor @ T).ravel()
    return (by @ stage.theta).reshape(n, n), by


def _per_joint(stage: StageModel, role: Role, n: int) -> tuple[Array, Array]:
    value, std = np.full((2, n), np.nan)
    for slot, v, s in zip(stage.slots, stage.theta, stage.std, strict=True):
        if has_role(slot, role):
            value[_joint(slot)], std[_joint(slot)] = v, s
    return value, std


def _joint(slot: Slot) -> int:
    """From 0; -1 for a place that is no joint."""
    number = slot.place.removeprefix("joint")
    return int(number) - 1 if number.isdigit() else -1
