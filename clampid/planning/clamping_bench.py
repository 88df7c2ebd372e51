"""Information of planned sweeps of a clamped arm on springs, clearances and friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy import linalg

from clampid.catalogue import catalogue
from clampid.planning.bench import imagined
from clampid.planning.expected import prior_precision
from clampid.planning.logs import TorqueNoise
from clampid.planning.press import Press
from clampid.slots import parse_term, slots_of_terms
from clampid.stages.clamped_rows import GAP_SOFTNESS, clamped_rows
from clampid.stages.fit_problem import FitProblem, fit_problem
from clampid.stages.layout import layout_of
from clampid.stages.rows import Array, Rows
from clampid.stages.stage_kind import acts_with, stages_with
from experiments.plans.errors import PlanError
from experiments.plans.model import Cell, Sweep
from experiments.plans.press import holding_torque

__all__ = ["PAUSE_S", "ClampingBench", "cost_of", "duration_of"]

PAUSE_S = 20.0  # between sweeps
SWEEPS_AT_ONCE = 6  # in one evaluation: each sweep adds unknown constants, and so columns, to all rows


class ClampingBench:
    """Computes the information of sweeps on a set of parameters.

    Parameters
    ----------
    cell
        Robot, gravity and tool.
    noise
        Noise of the torques.
    press
        How hard to press, with the described springs.
    wanted
        Effects to identify, ``effect`` or ``effect@joint3``.

    Attributes
    ----------
    size, scale
        Reasonable sizes of the parameters ``(P,)``, SI, and their products ``(P, P)``.
    prior
        Precision of the prior ``(P, P)``, in units of reasonable sizes.

    Raises
    ------
    PlanError
        An effect does not act in clamped sweeps, or springs are not among them.
    EffectError
        An effect is unknown.
    """

    def __init__(self, cell: Cell, noise: TorqueNoise, press: Press, wanted: Sequence[str]) -> None:
        self.cell, self.noise, self.press = cell, noise, press
        effects = catalogue()
        n = cell.robot.n
        still = Sweep(1, 0, np.zeros(n), 1e-3 * np.array([1.0, 2.0, 1.0, 0.0]), 1.0, np.zeros(4), np.zeros(4))
        blank = imagined(cell, clamped=self._table([still]))
        self.layout = layout_of([blank])
        terms = [parse_term(name, effects, self.layout) for name in wanted]
        for term in terms:
            if not acts_with(effects[term.effect], "solved"):
                acts = ", ".join(stages_with(effects[term.effect]))
                raise PlanError(f"effect {term.effect} does not act in clamped; it does in: {acts}")
        if not any("compliance" in effects[term.effect].roles for term in terms):
            raise PlanError("effects: expected joint_compliance among them: without springs a clamped drive is rigid")
        self.slots = slots_of_terms(terms, effects, self.layout, "clamped")
        self.problem: FitProblem = fit_problem(clamped_rows([blank], self.layout), effects, self.slots)
        self.size = self.problem.sizes()[: len(self.slots)]
        self.scale = np.outer(self.size, self.size)
        self.prior = prior_precision(self.problem) * self.scale

    def _table(self, sweeps: Sequence[Sweep]) -> pd.DataFrame:
        """Sweeps as a table of a campaign, with the torques of the described springs."""
        robot, n = self.cell.robot, self.cell.robot.n
        T = np.asarray(robot.transmission)
        parts = []
        for number, sweep in enumerate(sweeps, 1):
            dq = np.zeros((len(sweep.offset), n))
            dq[:, sweep.joint] = sweep.offset
            motor = (sweep.posture + dq) @ np.linalg.inv(T)
            tau = self._load(sweep.posture) @ T.T + (dq @ np.linalg.inv(T)) * self.press.stiffness
            data = {"sweep": number, "joint": sweep.joint + 1, "time_s": sweep.dwell * np.arange(1.0, len(dq) + 1)}
            data |= {f"motor{i + 1}_rad": motor[:, i] for i in range(n)}
            data |= {f"tau{i + 1}_Nm": tau[:, i] for i in range(n)}
            parts.append(pd.DataFrame(data))
        return pd.concat(parts, ignore_index=True)

    def _load(self, posture: Array) -> Array:
        """Joint torques ``(n,)``, Nm, that hold the arm and its tool."""
        cell = self.cell
        return holding_torque(cell.robot, posture, cell.gravity, cell.tool_mass, cell.tool_com)

    def evaluate(self, sweeps: Sequence[Sweep]) -> list[Array]:
        """Information ``(P, P)``, SI, of each sweep, with its unknown clamped posture eliminated."""
        out: list[Array] = []
        for start in range(0, len(sweeps), SWEEPS_AT_ONCE):
            out += self._evaluate(sweeps[start : start + SWEEPS_AT_ONCE])
        return out

    def _evaluate(self, sweeps: Sequence[Sweep]) -> list[Array]:
        """The information of a few sweeps, computed together."""
        rows = clamped_rows([imagined(self.cell, clamped=self._table(sweeps))], self.layout)
        ratio = np.abs(np.diag(np.asarray(self.cell.robot.transmission)))
        soft = np.tile(GAP_SOFTNESS * self.noise.sigma / ratio, (len(rows), 1))
        rows = replace(rows, signals={**rows.signals, "rest_direction": soft})
        _, jacobian = self.problem.with_rows(rows).residual(self._theta(rows, sweeps))
        count, run = len(self.slots), rows.series.run
        out = []
        for number in range(len(sweeps)):
            own = np.flatnonzero(rows.series.offset_keys[:, 0] == number) + count
            columns = np.r_[np.arange(count), own]
            information = np.zeros((len(columns), len(columns)))
            for channel in range(jacobian.shape[1]):
                at = np.flatnonzero((run == number) & rows.used[:, channel])
                if len(at):
                    white = self.noise.white(rows.constants.time[at], jacobian[at, channel][:, columns])
                    white = white / self.noise.sigma[channel]
                    information += white.T @ white
            A, B, C = information[:count, :count], information[:count, count:], information[count:, count:]
            out.append(A - B @ linalg.pinvh(C, rtol=1e-12) @ B.T)
        return out

    def _theta(self, rows: Rows, sweeps: Sequence[Sweep]) -> Array:
        """Parameters ``(P + K,)``: springs as described, usual values, and the clamped posture of each sweep."""
        theta = np.zeros(len(self.slots) + rows.offsets)
        start = self.problem.start()
        for k, slot in enumerate(self.slots):
            theta[k] = start[k]
            if self.problem.parameters[k].role == "compliance":
                theta[k] = 1.0 / self.press.stiffness[slot.number]
            elif self.problem.parameters[k].role == "clearance":
                theta[k] = self.size[k]
        T = np.asarray(self.cell.robot.transmission)
        C = T.T @ (T / self.press.stiffness[:, None])
        for k, (sweep, joint) in enumerate(rows.series.offset_keys):
            posture, reference = sweeps[sweep].posture, rows.sweep.reference[sweep]
            theta[len(self.slots) + k] = (posture - reference - C @ self._load(posture))[joint]
        return theta


def cost_of(sweep: Sweep) -> float:
    """Duration of a sweep with the pause after it, s."""
    return len(sweep.offset) * sweep.dwell + PAUSE_S


def duration_of(sweeps: Sequence[Sweep], press: Press) -> float:
    """Duration of all sweeps with the clampings, s."""
    return max(s.clamping for s in sweeps) * press.clamping_time + sum(map(cost_of, sweeps))
