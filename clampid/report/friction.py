"""Friction against speed, on the motor's side and on the arm's, with the model's curve and its interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clampid.charts import Axis, Band, Chart, Line, Mark, Panel, Points, thin
from clampid.report.stage_data import StageData
from clampid.report.style import Figure
from clampid.report.variables import groups_of
from clampid.role_slots import has_role
from clampid.roles import FRICTIONS
from clampid.slots import find_parameter
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array, Bools, Integers, Rows

__all__ = ["friction_figures"]

MOST_POINTS = 900
POINTS_OF_A_CURVE = 40  # points of a curve on each side of standstill
TWO_SIDED_95 = 1.96
SIGNIFICANT = 2.0  # standard errors from zero, beyond which a friction is significant
MIN_BLOCKS = 4  # blocks of a log that a mean's interval is taken from
OUTER = 0.995  # of the points are inside the axes


@dataclass(frozen=True)
class _Cloud:
    """Friction of one motor or joint, row by row: torque, Nm, and speed, rad/s.

    ``unit`` ``(N,)`` are the blocks of the log whose rows share their noise.
    """

    speed: Array
    left: Array
    unit: Integers


@dataclass(frozen=True)
class _Curve:
    """The model's friction against speed with its standard error ``(2 POINTS_OF_A_CURVE,)``; rising speed."""

    speed: Array
    friction: Array
    std: Array


def friction_figures(data: StageData) -> list[Figure]:
    """Friction at the motors, and where the transmission separates it from theirs, at the joints."""
    names = [f"motor {k + 1}" for k in range(data.channels)]
    effects = data.first.problem.effects
    # What reaches a motor through the wrist's coupling depends on other speeds than its own, too.
    at_arm = [name for name, effect in effects.items() if "arm_friction" in effect.roles]
    at_motor = [name for name, effect in effects.items() if effect.roles & set(FRICTIONS)]
    reach = " Points are the model's friction plus the residual; their means have 95 % intervals."
    arm = {
        slot.number: bool(known) and abs(value) > SIGNIFICANT * std
        for slot, known, value, std in zip(
            data.model.slots, data.model.identified, data.model.theta, data.model.std, strict=True
        )
        if has_role(slot, "arm_friction", effects=effects)
    }
    caption = f"Friction that a motor feels when it turns alone, against its speed.{reach} A mean off the line is "
    caption += "friction that the model lacks."
    if arm:
        caption += " In the wrist this is the sum of the motor's side and the arm's."
    plot = _drawn(data, (*at_motor, *at_arm), range(data.channels), names, "motor")
    proven, unproven = (
        sorted(j for j, known in arm.items() if known),
        sorted(j for j, known in arm.items() if not known),
    )
    if unproven:
        places = ", ".join(f"joint {j + 1}" for j in unproven)
        caption += f" These data do not separate the two at {places}."
    found = [Figure("friction", plot, caption)]
    if proven:
        caption = f"Arm-side friction of coupled joints, at the joint, where it differs significantly from zero.{reach}"
        plot = _drawn(data, at_arm, proven, [f"joint {j + 1}" for j in proven], "joint")
        found.append(Figure("friction-arm", plot, caption))
    return found


def _drawn(data: StageData, effects: Sequence[str], places: Sequence[int], names: list[str], side: str) -> Chart:
    panels = []
    for k, place in enumerate(places):
        cloud = _cloud(data, effects, place, side)
        up = "" if k % 3 else f"friction at the {side}, Nm"
        if not len(cloud.speed):
            panels.append(Panel((), Axis(), Axis(up), names[k]))
            continue
        curve = _curve(data, effects, place, side, cloud)
        reach = 1.15 * max(float(np.quantile(np.abs(cloud.left), OUTER)), float(np.abs(curve.friction).max()))
        marks = (_points(cloud), *_band(curve), _marks(cloud))
        panels.append(Panel(marks, Axis(), Axis(up, -reach, reach), names[k]))
    height = 520 if len(places) > 3 else 340
    return Chart(tuple(panels), height, below=f"speed of the {side}, rad/s")


def _without(problem: FitProblem, theta: Array, effects: Sequence[str]) -> Array:
    """The parameters with some effects' amplitudes at zero."""
    out = theta.copy()
    for k, slot in enumerate(problem.slots):
        if slot.effect in effects and not find_parameter(slot, problem.effects).shape:
            out[k] = 0.0
    return out


def _at_side(values: Array, rows: Rows, side: str) -> Array:
    """Torques of the motors ``(N, n, …)``, or the same torques at the joints."""
    if side == "motor":
        return values
    return np.asarray(np.einsum("jm,nm...->nj...", np.linalg.inv(rows.robot.transmission), values))


def _alone(rows: Rows, place: int, side: str, speed: Array) -> Rows:
    """The rows with one motor or joint turning at ``speed`` ``(N,)``, rad/s, and no other."""
    T = np.asarray(rows.robot.transmission)
    alone = np.outer(speed, np.eye(len(T))[place])
    joint, motor = (alone @ T, alone) if side == "motor" else (alone, alone @ np.linalg.inv(T))
    turning = {"joint_speed": joint, "motor_speed": motor}
    turning |= {"joint_motion": np.sign(joint), "motor_motion": np.sign(motor)}
    return replace(rows, signals={**rows.signals, **turning})


def _cloud(data: StageData, effects: Sequence[str], place: int, side: str) -> _Cloud:
    """Component plus residual: the model's friction of each row as if nothing else turned, plus the residual."""
    piece = data.first
    usable = np.flatnonzero(piece.good.any(axis=1))
    rows = usable[thin(len(usable), 6 * MOST_POINTS)]
    part = piece.rows.take(rows)
    trial = piece.problem.with_rows(_alone(part, place, side, part.signals[f"{side}_speed"][:, place]))
    runs = np.zeros(trial.offsets)
    theta = data.model.theta
    own = trial.residual(np.r_[_without(trial, theta, effects), runs])[0] - trial.residual(np.r_[theta, runs])[0]
    left = _at_side(own + piece.residual[rows], part, side)[:, place]
    needed = np.array([k == place for k in range(part.robot.n)])
    if side == "joint":
        needed = np.linalg.inv(part.robot.transmission)[place] != 0.0
    whole: Bools = piece.good[rows][:, needed].all(axis=1) & (part.signals[f"{side}_motion"][:, place] != 0)
    return _Cloud(part.signals[f"{side}_speed"][whole, place], left[whole], part.unit[whole])


def _curve(data: StageData, effects: Sequence[str], place: int, side: str, cloud: _Cloud) -> _Curve:
    """One motor or joint turns and no other; loads and temperatures are as at the middle of the log."""
    reach = float(np.abs(cloud.speed).max()) * np.linspace(1e-3, 1.0, POINTS_OF_A_CURVE)
    speed = np.r_[-reach[::-1], reach]
    piece = data.first
    middle = piece.rows.take(np.zeros(len(speed), dtype=np.int64))
    signals = dict(middle.signals)
    for name in ("motor_temperature", "ambient_temperature", "elapsed", "torque", "gravity_torque"):
        if name in signals:
            signals[name] = np.broadcast_to(np.median(piece.rows.signals[name], axis=0), signals[name].shape)
    trial = piece.problem.with_rows(_alone(replace(middle, signals=signals), place, side, speed))
    runs = np.zeros(trial.offsets)
    theta = data.model.theta
    full, jacobian = trial.residual(np.r_[theta, runs])
    bare = trial.residual(np.r_[_without(trial, theta, effects), runs])[0]
    own = [k for k, slot in enumerate(trial.slots) if slot.effect in effects]
    J = _at_side(jacobian[:, :, own], middle, side)[:, place]
    C = data.model.covariance[np.ix_(own, own)]
    std = np.sqrt(np.maximum(np.einsum("ik,kl,il->i", J, C, J), 0.0))
    return _Curve(speed, _at_side(bare - full, middle, side)[:, place], std)


def _means(cloud: _Cloud) -> tuple[Array, Array, Array]:
    """Mean friction over stretches of speed with the half-width of its 95 % interval: speed, mean, half-width.

    Rows of a log follow each other, so that the interval is that of the means of whole blocks.
    """
    found = []
    for sign in (-1.0, 1.0):
        side = np.flatnonzero(np.sign(cloud.speed) == sign)
        group = groups_of(cloud.speed[side]) // 2  # six stretches of twelve
        for g in np.unique(group[group >= 0]):
            rows = side[group == g]
            _, unit = np.unique(cloud.unit[rows], return_inverse=True)
            blocks = np.bincount(unit, cloud.left[rows]) / np.bincount(unit)
            if len(blocks) >= MIN_BLOCKS:
                spread = TWO_SIDED_95 * float(blocks.std(ddof=1)) / np.sqrt(len(blocks))
                found.append((float(np.mean(cloud.speed[rows])), float(blocks.mean()), spread))
    x, y, half = np.array(found).reshape(-1, 3).T
    return x, y, half


def _points(cloud: _Cloud) -> Points:
    seen = thin(len(cloud.speed), MOST_POINTS)
    return Points(cloud.speed[seen], cloud.left[seen], "model and residual", "grey", 3, 0.5)


def _marks(cloud: _Cloud) -> Points:
    x, y, half = _means(cloud)
    return Points(x, y, "its mean with 95 % interval", "ink", 5, error=half)


def _band(curve: _Curve) -> list[Mark]:
    """A curve with its interval, on either side of standstill, where friction jumps."""
    marks: list[Mark] = []
    for side in (curve.speed < 0, curve.speed > 0):
        x, y, half = curve.speed[side], curve.friction[side], TWO_SIDED_95 * curve.std[side]
        marks += [Band(x, y - half, y + half, "its 95 % interval"), Line(x, y, "model", "blue", 2.0)]
    return marks
