"""The best DH table for a controller that knows nothing else: geometry fitted to the flange of the whole model.

Springs, angle errors and the like shift the geometry that was fitted beside them. A controller that corrects only by a
table errs less with the geometry that comes nearest to the flange of the whole model (least squares over position and,
by a lever, orientation) where the robot works: at the poses of a campaign, or over the joint angles that the model was
identified on. What these postures do not determine stays as it is exported otherwise, near its nominal value.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import linalg

from clampid.effect import WEAK_SPREAD
from clampid.exports.determined import reasonable
from clampid.exports.form_error import FormError, WholeModel, form_error, ranges, whole_model
from clampid.models.calibrated import calibrated_chain
from clampid.models.model import Model
from clampid.role_slots import numbers_of_role
from clampid.roles import FRAMES
from clampid.stages.rows import Array
from clampid.stages.stage_kind import only_of
from experiments.campaign import Campaign
from kinematics.robot import RobotDescription
from kinematics.screws import inverse, log_so3

__all__ = ["BestTable", "best_table"]

LEVER = 0.2  # m, from the flange to a tool's point: orientation counts as what it moves there
COUNT = 1000  # postures, where no campaign gives them
SENSED = 3000  # postures, at most, at which it is found how the table follows the model
MAX_NEWTON_STEPS = 4  # of Gauss and Newton; the arm is nearly linear in a millimetre
DIFFERENCE_STEP = 1e-7  # m or rad
NUDGE = 1e-3  # of a parameter's standard error or size: how far the model's parameters are moved for a derivative


Residual = Callable[[Array], Array]
"""Rows ``(6 N,)`` at parameters ``(G,)``."""


@dataclass(frozen=True, eq=False)
class BestTable:
    """The geometry nearest to a whole model.

    Attributes
    ----------
    model
        The model with that geometry, and its covariance from that of the whole model.
    static, best
        What the model's own geometry leaves of the whole model at these postures, and what this one leaves.
    where
        The postures, in words.
    """

    model: Model
    static: FormError
    best: FormError
    where: str

    def __str__(self) -> str:
        before, after = (1e3 * e.position_rms for e in (self.static, self.best))
        return (
            f"fitted to the whole model at {self.where}: leaves rms {after:.4f} mm there; the model's own geometry "
            f"alone would leave {before:.4f} mm"
        )


def best_table(
    model: Model,
    robot: RobotDescription,
    *,
    session: int,
    temperature: float,
    campaign: Campaign | None,
    user_effects: Path | None,
) -> BestTable | None:
    """Fit the geometry to the whole model; None where the model has no other effect of the robot.

    Parameters
    ----------
    model
        With what the data do not determine at its nominal value (:func:`clampid.exports.determined.fix_undetermined`).
    session, temperature, campaign, user_effects
        As of `clampid.exports.dh_export.dh_export`.

    Raises
    ------
    ModelError
        The model has no geometry, or effects that are not known.
    """
    stage = only_of(model.stages, "points")
    geometry = numbers_of_role(stage.slots, *FRAMES)
    q, where = _postures(model, robot, campaign)
    whole = whole_model(
        model, robot, session=session, temperature=temperature, campaign=campaign, user_effects=user_effects, q=q
    )
    if not whole.effects:
        return None
    there = whole.flange(stage.theta)
    size = reasonable([stage.slots[k] for k in geometry])

    q = whole.q @ np.asarray(robot.linkage).T

    def flange(values: Array) -> Array:
        theta = stage.theta.copy()
        theta[geometry] = values
        chain = calibrated_chain(model, session=session, robot=robot, theta=theta, temperature=temperature)
        return chain.flange(q)

    def rows(values: Array) -> Array:
        return _rows(there, flange(values))

    start = stage.theta[geometry]
    free = _step(rows, start, start, size, np.eye(len(size)))
    directions = _determined(_derivatives(rows, start), rows(free), size)
    values = start
    for _ in range(MAX_NEWTON_STEPS):
        values = _step(rows, values, start, size, directions)
    theta, covariance = stage.theta.copy(), stage.covariance.copy()
    theta[geometry] = values
    J = _derivatives(rows, values) @ (size[:, None] * directions)
    follows = _follows(whole, stage.theta, stage.std, J)
    moved = size[:, None] * (directions @ follows)
    covariance[np.ix_(geometry, geometry)] = moved @ stage.covariance @ moved.T
    fitted = model.with_stage(replace(stage, theta=theta, covariance=covariance))
    return BestTable(fitted, form_error(there, flange(start)), form_error(there, flange(values)), where)


def _postures(model: Model, robot: RobotDescription, campaign: Campaign | None) -> tuple[Array, str]:
    """Joint angles ``(N, n)`` as the controller reports them, and what they are."""
    if campaign is not None and "poses" in campaign.tables:
        q = campaign.tables["poses"][[f"q{i + 1}_rad" for i in range(robot.n)]].to_numpy(float)
        return q, f"the {len(q)} poses of {campaign.name}"
    low, high = ranges(robot)
    known = only_of(model.stages, "points").ranges
    if known is not None:
        low, high = (np.where(np.isfinite(e), e, o) for e, o in ((known.lower[0], low), (known.upper[0], high)))
    q = np.random.default_rng(2).uniform(low, high, (COUNT, robot.n))
    over = "in the joints' ranges" if known is None else "within the joint angles of its poses"
    return q, f"{COUNT} postures {over}"


def _rows(there: Array, here: Array) -> Array:
    """Position and ``LEVER`` times rotation from one to the other, ``(6 N,)`` m."""
    away = inverse(there) @ here
    return np.hstack([away[:, :3, 3], LEVER * log_so3(away[:, :3, :3])]).ravel()


def _step(rows: Residual, values: Array, start: Array, size: Array, directions: Array) -> Array:
    """One step of Gauss and Newton within ``directions`` ``(G, k)``, with the weak prior of a fit about ``start``.

    What is left is no noise, but it says how well these postures determine a parameter, as in a fit to measurements.
    """
    left = rows(values)
    ridge = np.sqrt(_variance(left)) / WEAK_SPREAD
    A = np.vstack([_derivatives(rows, values) @ (size[:, None] * directions), ridge * np.eye(directions.shape[1])])
    b = np.concatenate([left, ridge * (directions.T @ ((values - start) / size))])
    return np.asarray(values - size * (directions @ np.linalg.lstsq(A, b, rcond=None)[0]))


def _derivatives(rows: Residual, values: Array) -> Array:
    """``(6 N, G)``, by central differences."""
    return np.stack(
        [(rows(values + e) - rows(values - e)) / (2 * DIFFERENCE_STEP) for e in DIFFERENCE_STEP * np.eye(len(values))],
        axis=1,
    )


def _variance(left: Array) -> float:
    return max(float(np.mean(left**2)), 1e-18)


def _determined(J: Array, left: Array, size: Array) -> Array:
    """Directions ``(G, k)``, in units of ``size``, that the postures determine to within it."""
    scaled = J * size
    known, vectors = linalg.eigh(scaled.T @ scaled / _variance(left) + np.eye(len(size)) / WEAK_SPREAD**2)
    return np.asarray(vectors[:, known > 1.0])


def _follows(whole: WholeModel, theta: Array, std: Array, A: Array) -> Array:
    """How the fitted directions follow the model's parameters ``(k, P)``: the least squares solution's derivative.

    Of the postures of the fit: at a few of them only, what no geometry follows would seem to move the table by more.
    """
    rows = np.linspace(0, len(whole.q) - 1, min(SENSED, len(whole.q))).round().astype(int)
    part = whole.at(rows)
    there = part.flange(theta)
    picked = A.reshape(len(whole.q), 6, -1)[rows].reshape(6 * len(rows), -1)
    solution = np.linalg.pinv(picked)
    step = np.where(std > 0.0, NUDGE * std, 0.0)
    out = np.zeros((len(solution), len(theta)))
    for k in np.flatnonzero(step):
        moved = theta.copy()
        moved[k] += step[k]
        out[:, k] = solution @ (_rows(there, part.flange(moved)) / step[k])
    return out
