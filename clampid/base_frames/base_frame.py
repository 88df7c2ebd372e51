"""Where the base is, from circles traced by joints 1 and 2, less what the arm's weight bends.

While joint 2 turns, the weight on joint 3 turns from one side to the other, and its drive gives way: the point leaves
its circle, and the axis through the circle's centre is beside the true one. So each point is put back by what a model
says that springs, clearances and links give way there, before the circles are fitted; the model's own errors are
counted. How far the base would be off otherwise is reported.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from clampid.base_frames.circles import Circle, CircleFit, circles_of, fit_circles
from clampid.base_frames.yielding import gives_way, what_yields
from clampid.models.model import Model, ModelError
from clampid.models.own_effects import effects_of
from clampid.stages.layout import layout_of
from clampid.stages.pose_rows import pose_rows
from clampid.stages.rows import Array, Integers, Rows
from experiments.campaign import Campaign, CampaignError
from kinematics.screws import inverse, log_se3

__all__ = ["BaseFrame", "base_from_circles"]

BENDING_PASSES = 2  # the second bends the arm as seen from the base that the first has found


@dataclass(frozen=True)
class BaseFrame:
    """A base frame with what is known of it.

    Attributes
    ----------
    base
        ``(4, 4)``: the base in the instrument's frame.
    covariance
        ``(8, 8)``: of the base's small motion in its own axes, (w, v), rad and m, and of ``between``.
    between
        ``(2,)``: how far the angle (rad) and the distance (m) of axes 1 and 2 are from the described ones.
    bias
        ``(6,)``: where the base would stand if nothing were put back, seen from ``base`` in its axes, (w, v).
    deflection
        m, the largest way that a point was put back.
    circles
        What was used.
    outliers
        Rows of the table, from 1, that lie on no circle.
    rms
        m, of the points' distances from their circles.
    freedom
        Degrees of freedom, for intervals by Student's t.
    springs
        Where they are from, in words.
    """

    base: Array
    covariance: Array
    between: Array
    bias: Array
    deflection: float
    circles: tuple[Circle, ...]
    outliers: tuple[int, ...]
    rms: float
    freedom: int
    springs: str

    @property
    def std(self) -> Array:
        """Standard errors ``(8,)`` of the base's motion in its own axes, (w, v), and of ``between``."""
        return np.sqrt(np.diag(self.covariance))

    def interval(self, level: float = 0.95) -> Array:
        """Half widths ``(8,)`` of intervals, as `std`."""
        return np.asarray(self.std * stats.t.isf((1 - level) / 2, self.freedom))

    def to_json(self) -> dict[str, Any]:
        """For programs; SI."""
        return {
            "base": self.base.tolist(),
            "std_w_v": self.std[:6].tolist(),
            "interval95_w_v": self.interval()[:6].tolist(),
            "axes_1_2": {
                "angle_off_rad": float(self.between[0]), "std_angle_rad": float(self.std[6]),
                "distance_off_m": float(self.between[1]), "std_distance_m": float(self.std[7]),
            },
            "uncorrected_w_v": self.bias.tolist(),
            "largest_deflection_m": self.deflection,
            "springs": self.springs,
            "rms_m": self.rms,
            "circles": [
                {"joint": c.joint + 1, "target": c.target, "points": len(c.rows), "span_rad": c.span}
                for c in self.circles
            ],
            "outliers": list(self.outliers),
        }  # fmt: skip


def base_from_circles(
    campaign: Campaign, model: Model | None = None, *, rigid: bool = False, user_effects: Path | None = None
) -> BaseFrame:
    """The base frame from the circles in a campaign's table ``poses``.

    Parameters
    ----------
    model
        Whose springs, clearances and loads put the points back: those of its stage ``poses``, else springs of
        ``clamped`` and loads of ``free_air``. Without one, the springs and masses of the robot's description, taken as
        exact.
    rigid
        Put nothing back.

    Raises
    ------
    CampaignError
        The campaign has no such circles, or no table ``poses``.
    ModelError
        Nothing is known of springs or weights, or the model is of another robot.
    """
    if "poses" not in campaign.tables:
        raise CampaignError(f"{campaign.name}: expected a table poses with circles of joints 1 and 2, found none")
    if model is not None and model.robot != campaign.robot.name:
        raise ModelError(f"the model is of the robot {model.robot}, the campaign of {campaign.robot.name}")
    effects = effects_of(model, user_effects)
    layout = layout_of([campaign])
    yielding = what_yields(campaign.robot, model, rigid=rigid)
    rows = pose_rows([campaign], layout, "poses").points
    circles = circles_of(rows)
    measured = rows.measured[:, :3]
    plain = fit_circles(rows, circles, measured, rows.pose.base_reference[0])
    found, way, by = plain, np.zeros_like(measured), np.zeros((len(rows), 3, 0))
    for _ in range(0 if rigid else BENDING_PASSES):
        rows = pose_rows([campaign], layout, "poses", {0: found.base}).points
        way, by = gives_way(rows, effects, yielding)
        found = fit_circles(rows, circles, measured - way, found.base)
    on = np.unique(np.concatenate([c.rows for c in circles]))
    return BaseFrame(
        base=found.base,
        covariance=_covariance(found, rows, by, yielding.covariance),
        between=found.between,
        bias=log_se3(inverse(found.base) @ plain.base),
        deflection=float(np.linalg.norm(way[on], axis=1).max()),
        circles=circles,
        outliers=tuple(int(rows.row[k]) for k in on if not found.used[k]),
        rms=float(np.sqrt(2 * np.mean(found.misfit**2))),
        freedom=_freedom(found, rows),
        springs=yielding.said,
    )


def _covariance(found: CircleFit, rows: Rows, by: Array, spread: Array) -> Array:
    """Covariance ``(8, 8)``: what the circles leave, shared by the points of a visit, and the model's own errors.

    The rows' part is a sandwich over visits (Liang and Zeger, Biometrika 73, 1986). ``by`` ``(N, 3, P)``: how the
    points give way by the model's parameters; ``spread``: these parameters' covariance.
    """
    J = found.jacobian
    scale = np.linalg.norm(J, axis=0)
    bread = np.linalg.pinv((J / scale).T @ (J / scale), hermitian=True)
    unit = _visits(found, rows)
    pulls = np.zeros((int(unit.max()) + 1, J.shape[1]))
    np.add.at(pulls, unit, J / scale * found.misfit[:, None])
    m, visits = len(J), len(pulls)
    small = visits / (visits - 1) * (m - 1) / max(m - _unknowns(found), 1)
    sandwich = small * bread @ pulls.T @ pulls @ bread / np.outer(scale, scale)
    G = found.follows(-by)
    return np.asarray(sandwich + G @ spread @ G.T)


def _unknowns(found: CircleFit) -> int:
    """Base, angle and distance of the axes, and each circle's radius and height."""
    return int(found.jacobian.shape[1]) + 2 * len(found.problem.kept)


def _visits(found: CircleFit, rows: Rows) -> Integers:
    """Number of the visit of each misfit ``(m,)``, from 0."""
    _, unit = np.unique(rows.unit[found.point], return_inverse=True)
    return unit.astype(np.int64)


def _freedom(found: CircleFit, rows: Rows) -> int:
    """Visits, less their share of what was fitted: two misfits tell of two unknowns."""
    return max(int(_visits(found, rows).max()) + 1 - _unknowns(found) // 2, 1)
