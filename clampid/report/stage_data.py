"""What the report needs of a stage: its rows in the campaign, what the model leaves of them, which were held out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from clampid.effect import Stage
from clampid.fitting.accuracy import Floor, noise_floor, predicted
from clampid.identification.identify import stage_rows
from clampid.identification.model_on_campaign import ModelOnCampaign
from clampid.models.model import StageModel
from clampid.stages.fit_problem import FitProblem
from clampid.stages.pose_rows import align
from clampid.stages.rows import Array, Bools, Rows
from clampid.stages.stage_kind import StageKind, kind_of, kinds

__all__ = ["Piece", "StageData", "in_order", "stage_data", "stage_title"]


@dataclass(frozen=True)
class Piece:
    """One table's rows with what a model leaves of them.

    Attributes
    ----------
    residual
        ``(N, m)``, measured less predicted, SI.
    good
        ``(N, m)``: numbers that count: neither at rest nor rejected.
    held_out
        ``(N,)``: rows that no fit saw.
    rejected
        ``(N, m)``: numbers of rows that the fit rejected as outliers.
    """

    rows: Rows
    problem: FitProblem
    residual: Array
    good: Bools
    held_out: Bools
    rejected: Bools


@dataclass(frozen=True)
class StageData:
    """A stage of a model on a campaign: its pieces and the noise that is left at best."""

    stage: Stage
    model: StageModel
    pieces: tuple[Piece, ...]
    floor: Floor
    frames: Mapping[str, pd.DataFrame]

    @property
    def kind(self) -> StageKind:
        """The stage as a value."""
        return kind_of(self.stage)

    @property
    def first(self) -> Piece:
        """The piece that was fitted on."""
        return self.pieces[0]

    @property
    def channels(self) -> int:
        """Coordinates of a point (3), or motors."""
        return 3 if self.kind.points else self.first.residual.shape[1]

    def stacked(self, name: str) -> Array:
        """A signal of all rows."""
        return np.concatenate([p.rows.signals[name] for p in self.pieces])

    @property
    def residual(self) -> Array:
        """Residuals of all rows ``(N, channels)``."""
        return np.concatenate([p.residual[:, : self.channels] for p in self.pieces])

    @property
    def good(self) -> Bools:
        """Which numbers of all rows count ``(N, channels)``."""
        return np.concatenate([p.good[:, : self.channels] for p in self.pieces])

    @property
    def rejected(self) -> Bools:
        """Which numbers of all rows were rejected as outliers ``(N, channels)``."""
        return np.concatenate([p.rejected[:, : self.channels] for p in self.pieces])

    @property
    def held_out(self) -> Bools:
        """Which of all rows were held out ``(N,)``."""
        return np.concatenate([p.held_out for p in self.pieces])

    def column(self, name: str) -> pd.Series | None:
        """A column of the campaign for all rows, or None where a table lacks it."""
        parts = []
        for piece in self.pieces:
            for table in dict.fromkeys(piece.rows.table.tolist()):
                if name not in self.frames[table].columns:
                    return None
                parts.append(self.frames[table][name])
        return pd.concat(parts, ignore_index=True)


def stage_title(stage: str) -> str:
    """A stage's name for people."""
    return kind_of(stage).words.title


def in_order(stages: Iterable[str]) -> tuple[Stage, ...]:
    """Stages in the order in which the report tells of them: points first, what the robot is calibrated for."""
    found = set(stages)
    return tuple(kind.name for kind in sorted(kinds(), key=lambda kind: not kind.points) if kind.name in found)


def stage_data(opened: ModelOnCampaign) -> dict[Stage, StageData]:
    """Every stage that both the model and the campaign have.

    A campaign that the model never saw says nothing of where its instrument stands: there the base is aligned with the
    poses first.
    """
    out: dict[Stage, StageData] = {}
    tables = opened.campaign.tables
    for stage in in_order(opened.stages):
        if not any(t in tables for t in kind_of(stage).tables):
            continue
        if kind_of(stage).points and "poses" not in tables:
            continue  # figures are of points
        if kind_of(stage).effects_of:
            continue  # nor are there any of what shows another stage's effects only
        rows = opened.rows(stage)
        verification = None
        if kind_of(stage).points:
            base = opened.base or _aligned(opened, rows)
            rows = stage_rows([opened.campaign], opened.layout, stage, base).points
            verification = opened.verification(base)
        pieces = [_piece(opened, stage, rows, False)]
        if verification is not None:
            pieces.append(_piece(opened, stage, verification, True))
        first = pieces[0]
        floor = noise_floor(rows.without(~first.good[:, 0]) if kind_of(stage).points else rows, first.residual)
        out[stage] = StageData(stage, opened.stages[stage], tuple(pieces), floor, tables)
    return out


def _aligned(opened: ModelOnCampaign, rows: Rows) -> dict[int, Array]:
    """Where the instrument sees the base, from the points that the model predicts."""
    model = opened.stages["poses"]
    rows = rows.points
    residual = predicted(opened.fit_problem("poses", rows), model.theta)
    motion = align(rows.measured[:, :3] - residual[:, :3], rows.measured[:, :3])
    return {0: motion @ rows.pose.base_reference[0]}


def _piece(opened: ModelOnCampaign, stage: Stage, rows: Rows, verification: bool) -> Piece:
    model = opened.stages[stage]
    found = opened.fit_problem(stage, rows)
    rejected = {(table, row) for _, table, row in model.outliers} if opened.session is not None else set()
    bad = np.array([key in rejected for key in zip(rows.table.tolist(), rows.row.tolist(), strict=True)], dtype=bool)
    held_out = rows.in_folds(opened.held_out(stage))
    if opened.session is None or verification:
        held_out = np.ones(len(rows), dtype=bool)
    wrong = bad[:, None]
    return Piece(rows, found, predicted(found, model.theta), rows.used & ~wrong, held_out, rows.used & wrong)
