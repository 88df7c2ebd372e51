"""Information of planned poses on the parameters, and the positions of their tracked points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from clampid.catalogue import catalogue
from clampid.identification.fitted_stage import active_slots
from clampid.identification.identify import resolve_terms
from clampid.planning.bench import imagined
from clampid.planning.expected import prior_precision
from clampid.stages.fit_problem import fit_problem
from clampid.stages.layout import layout_of
from clampid.stages.pose_rows import pose_rows
from clampid.stages.rows import Array, Rows
from experiments.plans.errors import PlanError
from experiments.plans.model import Cell
from kinematics.poe import forward

__all__ = ["PoseBench"]


class PoseBench:
    """Computes the information of visits on a set of parameters.

    Parameters
    ----------
    cell
        Robot, targets, instrument, gravity and tool.
    effects
        Effects to identify, ``effect`` or ``effect@joint3``; None: the standard set of the stage.
    station
        Position of the instrument ``(3,)``, m, base frame.

    Attributes
    ----------
    size
        Reasonable sizes of the parameters ``(P,)``, SI.
    prior
        Precision of the prior ``(P, P)``, in units of reasonable sizes.

    Raises
    ------
    PlanError
        The cell has no targets to track.
    EffectError
        An effect is unknown or does not act in poses.
    """

    def __init__(self, cell: Cell, effects: Sequence[str] | None, station: Array) -> None:
        if not cell.targets:
            raise PlanError("targets: expected at least one tracked point, found none")
        self.cell, self._base = cell, {0: _shift(-station)}
        n = cell.robot.n
        few = np.zeros((2, n))
        blank = imagined(cell, poses=self._table(few, np.array([np.ones(n), -np.ones(n)])))
        self.layout = layout_of([blank])
        known = catalogue()
        wanted = None if effects is None else {"poses": list(effects)}
        terms = resolve_terms(wanted, [blank], known, self.layout)["poses"]
        self.effects = tuple(term.label for term in terms)
        rows = pose_rows([blank], self.layout, "poses", self._base)
        self.problem = fit_problem(rows, known, active_slots(rows, known, terms))
        self.size: Array = self.problem.sizes()
        self.prior: Array = prior_precision(self.problem) * np.outer(self.size, self.size)

    def points(self, q: Array) -> tuple[Array, Array]:
        """Tracked points ``(N, t, 3)``, m, and flange rotations ``(N, 3, 3)``, base frame, at ``q`` ``(N, n)``, rad."""
        robot = self.cell.robot
        pose = forward(robot.screws, robot.flange, q @ np.asarray(robot.linkage).T)
        target = np.array(list(self.cell.targets.values()))
        return np.einsum("nij,tj->nti", pose[:, :3, :3], target) + pose[:, None, :3, 3], pose[:, :3, :3]

    def rows(self, q: Array, direction: Array) -> Rows:
        """Rows of all targets of visits at ``q`` ``(N, n)``, rad, with approach signs ``direction`` ``(N, n)``."""
        return pose_rows([imagined(self.cell, poses=self._table(q, direction))], self.layout, "poses", self._base)

    def factors(self, q: Array, direction: Array) -> Array:
        """Factor F ``(N, P, 3 t)`` of each visit's information F Fᵀ: transposed whitened Jacobian, scaled by size."""
        rows = self.rows(q, direction)
        _, jacobian = self.problem.with_rows(rows).residual(self.problem.start())
        white = jacobian[:, :3] / rows.sigma[:, :3, None] * self.size
        return np.asarray(np.swapaxes(white.reshape(len(q), -1, len(self.size)), 1, 2))

    def _table(self, q: Array, direction: Array) -> pd.DataFrame:
        """Visits as a table ``poses`` of a campaign, with points of the nominal robot."""
        names = list(self.cell.targets)
        N, t = len(q), len(names)
        each = np.repeat(np.arange(N), t)
        points, _ = self.points(q)
        data = {"pose": each + 1, "visit": np.ones(N * t, dtype=int), "time_s": np.arange(N * t, dtype=float)}
        data |= {f"q{i + 1}_rad": q[each, i] for i in range(q.shape[1])}
        data |= {f"dir{i + 1}": direction[each, i].astype(int) for i in range(q.shape[1])}
        data["target"] = np.array(names * N)
        seen = points.reshape(-1, 3) + self._base[0][:3, 3]
        return pd.DataFrame(data | {f"{axis}_m": seen[:, k] for k, axis in enumerate("xyz")})


def _shift(vector: Array) -> Array:
    """Translation ``(4, 4)`` by a vector ``(3,)``."""
    out = np.eye(4)
    out[:3, 3] = vector
    return out
