"""The identified dynamics for others: base parameters, and on demand an arm of bodies that can have them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clampid.fitting.accuracy import predicted
from clampid.fitting.base_names import base_json
from clampid.identification.model_on_campaign import on_campaign
from clampid.models.consistent import ConsistentArm, consistent_arm, off_by
from clampid.models.described import robot_of
from clampid.models.model import Model, ModelError, StageModel
from clampid.role_slots import any_of_role
from clampid.stages.fit_problem import fit_problem
from clampid.stages.rows import Array
from clampid.stages.stage_kind import known_of, only_of
from experiments.campaign import Campaign
from kinematics.robot import RobotDescription

__all__ = ["dynamics", "torque_errors"]

FRAME = "base frame at the zero pose; inertias about each link's centre of mass; the declared tool is not included"


def dynamics(
    model: Model,
    *,
    consistent: bool = False,
    campaign: Campaign | None = None,
    robot: RobotDescription | None = None,
    user_effects: Path | None = None,
) -> dict[str, Any]:
    """Base parameters, masses and inertias identified from torques, ready for JSON.

    Parameters
    ----------
    consistent
        Also the nearest arm of bodies that can exist (:func:`clampid.models.consistent.consistent_arm`), link by link.
    campaign
        On whose torque logs the fitted parameters and those of the consistent arm are compared.
    robot
        The nominal robot, if the model's name for it is not that of a bundled one.

    Returns
    -------
    dict
        ``robot``; ``base_parameters`` as in the model file; with ``consistent`` also ``links`` (``mass_kg``, ``com_m``,
        ``inertia_kg_m2``), ``rotor_inertia_kg_m2`` at the joints (or null), ``frame``, ``inertia_identified``, and
        ``fit``: chi-square, the number of base parameters, and with a campaign ``rms_Nm`` and ``consistent_rms_Nm``
        per motor.

    Raises
    ------
    ModelError
        The model has no base parameters; the campaign is not of its robot, or has no torque logs.
    """
    stage = known_of(model.stages, "moving")
    if stage is None or not stage.base:
        raise ModelError("expected a model with gravity identified from free-air or wrist logs, found none to export")
    nominal = robot_of(model, robot)
    out: dict[str, Any] = {"robot": model.robot, "base_parameters": [base_json(p) for p in stage.base]}
    if not consistent:
        return out
    arm = consistent_arm(model, nominal)
    off = off_by(stage.base, arm).tolist()
    for entry, value, apart in zip(out["base_parameters"], arm.base.tolist(), off, strict=True):
        entry["consistent"] = value
        entry["off_by_std"] = apart
    out["links"] = [
        {
            "link": i + 1,
            "mass_kg": link.mass,
            "com_m": link.com.tolist(),
            "inertia_kg_m2": [] if link.inertia is None else link.inertia.tolist(),
        }
        for i, link in enumerate(arm.links)
    ]
    out["rotor_inertia_kg_m2"] = None if arm.rotors is None else arm.rotors.tolist()
    out["frame"] = FRAME
    out["inertia_identified"] = any_of_role(stage.slots, "inertia_tensor")
    out["fit"] = {"chi_square": arm.chi_square, "base_parameters": len(stage.base), "weight": arm.weight}
    if campaign is not None:
        before, after = torque_errors(model, arm, campaign, nominal, user_effects)
        out["fit"] |= {"rms_Nm": before.tolist(), "consistent_rms_Nm": after.tolist()}
    return out


def torque_errors(
    model: Model,
    arm: ConsistentArm,
    campaign: Campaign,
    robot: RobotDescription,
    user_effects: Path | None = None,
) -> tuple[Array, Array]:
    """Rms errors of each motor's torque ``(n,)``, Nm, with the fitted parameters, and with those of the arm.

    Over the rows that the fit would use, but for those it rejected.

    Raises
    ------
    ModelError
        The campaign is not of the model's robot, or has no torque logs.
    """
    opened = on_campaign(model, campaign, user_effects)
    if known_of(opened.stages, "moving") is None:
        raise ModelError(f"{campaign.name}: expected torque logs (free_air, wrist) to compare on, found none")
    stage: StageModel = only_of(opened.stages, "moving")
    rows = opened.rows("free_air")
    rejected = {(table, row) for _, table, row in stage.outliers}
    bad = [key in rejected for key in zip(rows.table.tolist(), rows.row.tolist(), strict=True)]
    rows = rows.without(np.array(bad, dtype=bool))
    trial = fit_problem(rows, opened.effects, stage.slots)
    errors = []
    for theta in (stage.theta, arm.slot_values(stage, robot)):
        residual = np.where(rows.used, predicted(trial, theta), 0.0)
        errors.append(np.sqrt((residual**2).sum(axis=0) / np.maximum(rows.used.sum(axis=0), 1)))
    return errors[0], errors[1]
