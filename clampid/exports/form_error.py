"""Error of an export (DH table, URDF, machine data) against the whole model that it was made from.

A form holds the static geometry at one temperature. The rest is measured against the whole model: springs under the
declared tool, play, errors of angles, expansion at other temperatures, a base that settles in the course of a shift.
Workspace: postures drawn over the joints' ranges, each joint approached from a side drawn for it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from clampid.effect import Effect
from clampid.models.model import Model, ModelError, StageModel
from clampid.models.own_effects import effects_of
from clampid.role_slots import slot_of
from clampid.roles import FRAMES
from clampid.slots import find_parameter
from clampid.stages import poses
from clampid.stages.fit_problem import FitProblem, fit_problem
from clampid.stages.pose_rows import pose_rows
from clampid.stages.rows import Array
from clampid.stages.stage_kind import known_of, only_of
from experiments.campaign import Campaign, Instrument, Tool, target_points
from experiments.columns import is_further
from experiments.measures.metrics import norm_metrics
from experiments.temperatures import REFERENCE_TEMPERATURE
from kinematics.gravity import STANDARD_GRAVITY
from kinematics.robot import RobotDescription
from kinematics.screws import log_so3

__all__ = [
    "CHECKED",
    "FormError",
    "LeftOut",
    "Measured",
    "WholeModel",
    "form_error",
    "left_out",
    "measured_error",
    "postures",
    "whole_model",
]

POSTURES = 200
CHECKED = 2000  # postures, drawn apart from those that a form was fitted to or read back at
SHIFT_SECONDS = 8 * 3600.0
"""s, over which the postures are spread: what settles or warms up is not at its beginning only."""

Flange = Callable[[Array], Array]
"""Poses ``(N, 4, 4)`` of the flange in the instrument's frame at joint values of the chain ``(N, n)``, rad or m."""


@dataclass(frozen=True)
class FormError:
    """How far a form is from what it stands for, over postures: the flange's position [m] and orientation [rad]."""

    position_rms: float
    position_max: float
    orientation_rms: float
    orientation_max: float

    def __str__(self) -> str:
        return (
            f"position rms {1e3 * self.position_rms:.4f} mm, max {1e3 * self.position_max:.4f} mm; "
            f"orientation rms {1e3 * self.orientation_rms:.4f} mrad, max {1e3 * self.orientation_max:.4f} mrad"
        )


@dataclass(frozen=True)
class LeftOut:
    """What a form leaves of a whole model.

    Attributes
    ----------
    error
        Of the flange, form against model.
    effects
        Effects of the model that the form does not hold → what each is worth over the same postures, m: the rms shift
        of the flange when it is switched off.
    temperature
        Lowest and highest of the links, degC: those of the session, where the model says what they do.
    tool
        The load, kg.
    """

    error: FormError
    effects: Mapping[str, float]
    temperature: tuple[float, float]
    tool: float

    @property
    def conditions(self) -> str:
        """Under which the error was found, in words; ASCII, as controllers' files are."""
        low, high = self.temperature
        warm = f"{low:g}" if low == high else f"{low:g} to {high:g}"
        return (
            f"left of the whole model over {CHECKED} postures in the joints' ranges, either side of play, {warm} degC, "
            f"tool {self.tool:g} kg"
        )

    def __str__(self) -> str:
        return f"{self.conditions}: {self.error}"

    @property
    def worth(self) -> str:
        """The effects with what each is worth, largest first, in words."""
        ordered = sorted(self.effects.items(), key=lambda item: -item[1])
        return ", ".join(f"{name} (rms {1e3 * rms:.4f} mm)" for name, rms in ordered) or "nothing of this model"

    def to_json(self) -> dict[str, Any]:
        """For programs; SI but for the temperatures."""
        e = self.error
        return {
            "left_by_table_m": {"rms": e.position_rms, "max": e.position_max},
            "left_by_table_rad": {"rms": e.orientation_rms, "max": e.orientation_max},
            "not_in_table": [{"effect": name, "rms_m": rms} for name, rms in self.effects.items()],
            "postures": CHECKED,
            "temperatures_C": list(self.temperature),
            "tool_mass_kg": self.tool,
        }


@dataclass(frozen=True)
class Measured:
    """How far a form alone is from the measured points of a campaign: mean and largest, m, over a table's rows."""

    table: str
    rows: int
    mean: float
    largest: float

    def __str__(self) -> str:
        mean, largest = 1e3 * self.mean, 1e3 * self.largest
        return f"of {self.rows} measured points ({self.table}): mean {mean:.4f} mm, max {largest:.4f} mm."

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {"table": self.table, "rows": self.rows, "mean_m": self.mean, "max_m": self.largest}


def ranges(robot: RobotDescription) -> tuple[Array, Array]:
    """Lowest and highest joint values ``(n,)``; half a turn either way where a joint has no limits."""
    return (
        np.where(np.isfinite(robot.lower), robot.lower, -np.pi),
        np.where(np.isfinite(robot.upper), robot.upper, np.pi),
    )


def postures(robot: RobotDescription, count: int = POSTURES, seed: int = 0) -> Array:
    """Joint values ``(count, n)`` drawn over the whole ranges, rad or m: where an export is compared with the model."""
    return np.random.default_rng(seed).uniform(*ranges(robot), (count, robot.n))


def form_error(there: Array, here: Array) -> FormError:
    """How far poses ``here`` are from those ``there``, ``(N, 4, 4)`` each, m and rad."""
    position = np.linalg.norm(here[:, :3, 3] - there[:, :3, 3], axis=1)
    turn = np.linalg.norm(log_so3(np.swapaxes(there[:, :3, :3], 1, 2) @ here[:, :3, :3]), axis=1)
    (p_rms, p_max), (r_rms, r_max) = ((float(np.sqrt(np.mean(s**2))), float(s.max())) for s in (position, turn))
    return FormError(p_rms, p_max, r_rms, r_max)


def left_out(
    form: Flange,
    model: Model,
    robot: RobotDescription,
    *,
    session: int = 0,
    temperature: float = REFERENCE_TEMPERATURE,
    campaign: Campaign | None = None,
    user_effects: Path | None = None,
) -> LeftOut:
    """Hold a form against the whole model over the workspace.

    Parameters
    ----------
    form
        Gives the form's flange; see :data:`Flange`.
    session
        Whose base, flange and tool, from 0.
    temperature
        That of the form, degC; where the model says what temperatures do and the session knows its own, links have
        those.
    campaign
        Whose declared tool and gravity load the arm; without one, those that the session kept.

    Raises
    ------
    ModelError
        The model has no stage poses, or an effect that is not known here.
    """
    whole = whole_model(
        model, robot, session=session, temperature=temperature, campaign=campaign, user_effects=user_effects
    )
    theta = whole.stage.theta
    here = form(whole.q @ np.asarray(robot.linkage).T)
    there = whole.flange(theta)
    left: dict[str, float] = {}
    for name in whole.effects:
        off = np.array([s.effect == name and not find_parameter(s, whole.known).shape for s in whole.stage.slots])
        left[name] = form_error(there, whole.flange(np.where(off, 0.0, theta))).position_rms
    return LeftOut(form_error(there, here), left, whole.temperature, whole.tool)


@dataclass(frozen=True, eq=False)
class WholeModel:
    """A model with all its effects at some postures.

    Attributes
    ----------
    effects
        Those of the robot that no form holds; the instrument's do not count.
    known
        All effects by name.
    temperature
        Lowest and highest of the links, degC.
    tool
        The load, kg.
    """

    trial: FitProblem
    stage: StageModel
    effects: tuple[str, ...]
    known: Mapping[str, Effect]
    temperature: tuple[float, float]
    tool: float

    @property
    def q(self) -> Array:
        """Joint angles ``(N, n)`` as the controller reports them, rad or m."""
        return self.trial.rows.signals["q"]

    def flange(self, theta: Array) -> Array:
        """Poses ``(N, 4, 4)`` of the flange in the instrument's frame, with other values of the parameters."""
        return _flange(self.trial, theta)

    def at(self, rows: Array) -> WholeModel:
        """The same at some of the postures."""
        return replace(self, trial=self.trial.with_rows(self.trial.rows.take(rows)))


def whole_model(
    model: Model,
    robot: RobotDescription,
    *,
    session: int = 0,
    temperature: float = REFERENCE_TEMPERATURE,
    campaign: Campaign | None = None,
    user_effects: Path | None = None,
    q: Array | None = None,
) -> WholeModel:
    """The model at postures ``q`` ``(N, n)``, by default drawn over the joints' ranges; see `left_out`.

    Raises
    ------
    ModelError
        The model has no stage poses, or an effect that is not known here.
    """
    stage = known_of(model.stages, "points")
    if stage is None:
        raise ModelError("expected a model with a stage poses, found none")
    effects = effects_of(model, user_effects)
    active = [effects[name] for name in dict.fromkeys(slot.effect for slot in stage.slots)]
    warm = any(name.endswith("_temperature") for effect in active for name in effect.needs)
    own = model.sessions[session].temperature
    span = own if warm and own is not None and np.isfinite(own).all() else (temperature, temperature)
    loaded = replace(_load(model, session, robot) if campaign is None else replace(campaign, tables={}), robot=robot)
    q = postures(robot, CHECKED, seed=1) if q is None else q
    trial = _drawn(model, loaded, effects, session, span, q)
    left = tuple(e.name for e in active if not e.roles & set(FRAMES) and not e.of_readings)
    return WholeModel(trial, stage, left, effects, span, float(loaded.tool.mass))


def measured_error(form: Flange, model: Model, session: int, campaign: Campaign) -> Measured:
    """How far a form alone is from a session's measured points; from held-out ones, where there are.

    Raises
    ------
    ModelError
        The campaign is not that of the session, whose base and flange the form has.
    """
    if model.sessions[session].fingerprint != campaign.fingerprint:
        raise ModelError(
            f"{campaign.name}: expected the campaign that session {session + 1} of the model was fitted on, because "
            "its base and flange are in the file"
        )
    table = "verification" if "verification" in campaign.tables else "poses"
    if table not in campaign.tables:
        raise ModelError(f"{campaign.name}: expected a campaign with a table poses or verification, found none")
    frame, robot = campaign.tables[table], campaign.robot
    prefix = f"session{session + 1}:" if len(model.sessions) > 1 else ""
    values = only_of(model.stages, "points").values()
    shift = np.array(
        [[values.get(slot_of("target_point", f"{prefix}{name}", a), 0.0) for a in "xyz"] for name in frame["target"]]
    )
    q = frame[[f"q{i + 1}_rad" for i in range(robot.n)]].to_numpy(float)
    pose = form(q @ np.asarray(robot.linkage).T)
    point = np.einsum("nij,nj->ni", pose[:, :3, :3], target_points(campaign, table) + shift) + pose[:, :3, 3]
    error = norm_metrics(np.linalg.norm(frame[["x_m", "y_m", "z_m"]].to_numpy(float) - point, axis=1))
    return Measured(table, len(frame), float(error["P_mean"] or 0.0), float(error["P_max"] or 0.0))


def _load(model: Model, session: int, robot: RobotDescription) -> Campaign:
    """A campaign without tables, of what a session kept: its tool and gravity."""
    kept = model.sessions[session]
    com, gravity = kept.tool_com or (0.0, 0.0, 0.0), kept.gravity or STANDARD_GRAVITY
    tool, instrument = Tool(kept.tool_mass, np.asarray(com)), Instrument("none", None, None)
    return Campaign("drawn", None, robot, np.asarray(gravity), tool, {}, instrument, {}, "")


def _drawn(
    model: Model, load: Campaign, effects: Mapping[str, Effect], session: int, warmth: tuple[float, float], q: Array
) -> FitProblem:
    """The model's poses as an experiment at postures ``q``: all links at one temperature, between ``warmth``, degC."""
    n, rng = load.robot.n, np.random.default_rng(2)
    warm = rng.uniform(*warmth, len(q))
    data: dict[str, Any] = {"pose": np.arange(len(q)) + 1, "visit": 1, "target": "flange"}
    data["time_s"] = np.linspace(0.0, SHIFT_SECONDS, len(q))
    data |= {f"{axis}_m": 0.0 for axis in "xyz"}
    data |= {f"q{i + 1}_rad": q[:, i] for i in range(n)}
    data |= {f"dir{i + 1}": sides for i, sides in enumerate(rng.choice([-1, 1], (n, len(q))))}
    data |= {f"temp_{part}{i + 1}_C": warm for part in ("link", "motor") for i in range(n)}
    stage = only_of(model.stages, "points")
    reading = [effects[name] for name in {s.effect for s in stage.slots} if effects[name].of_readings]
    data |= {name: 0.0 for e in reading for name in e.needs if is_further(name)}  # an instrument's errors are left out
    campaigns = [load] * len(model.sessions)
    campaigns[session] = replace(load, tables={"poses": pd.DataFrame(data)})
    base = {k: s.base_reference for k, s in enumerate(model.sessions) if s.base_reference is not None}
    return fit_problem(pose_rows(campaigns, model.layout, "poses", base), effects, stage.slots, stage.lean)


def _flange(trial: FitProblem, theta: Array) -> Array:
    """Poses ``(N, 4, 4)`` of the flange in the instrument's frame, whose own errors are left out."""
    found = poses.evaluate(trial.rows, trial.chain, theta)
    values = np.array(found.values)
    values[:, trial.chain.offsets["measurement"]] = 0.0
    position, rotation, _ = poses.predict(trial.rows, replace(found, values=values))
    out = np.tile(np.eye(4), (len(position), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = rotation, position
    return out
