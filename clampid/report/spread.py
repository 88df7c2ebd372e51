"""Intervals of the held-out error, before and after effects were added, from draws of whole poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from clampid.display import error_text, ranged_text
from clampid.effect import Stage
from clampid.fitting.accuracy import size_of
from clampid.fitting.fit import without_outlying
from clampid.report.stage_data import StageData, stage_title
from clampid.report.style import Table, as_table
from clampid.stages.rows import Array, Bools, Integers
from clampid.stages.stage_kind import kind_of

__all__ = ["HeldOut", "Spread", "held_out", "spread_of", "spread_sentences", "spread_table", "spreads"]

BOOTSTRAP_DRAWS = 2000
MIN_UNITS = 10  # whole poses, runs or sweeps, below which a draw of them says little
_CAPTION = (
    "Root mean square errors on held-out rows that both models use, with 95 % intervals from a bootstrap: {draws} "
    "draws of whole poses (logs: runs, sweeps) with replacement, the same for both. The models are not fitted again: "
    "the intervals include the choice of held-out poses, not that of fitted ones."
)


@dataclass(frozen=True)
class HeldOut:
    """Squared errors on rows that no fit saw ``(N,)``, which count, and of which pose, run or sweep they are."""

    squares: Array
    counts: Bools
    fold: Integers


@dataclass(frozen=True)
class Spread:
    """The error before and now, m or in units of noise, and by how much it fell; each with its 95 % interval.

    ``before`` and ``fall`` are None without a start model.
    """

    folds: int
    now: tuple[float, float, float]
    before: tuple[float, float, float] | None = None
    fall: tuple[float, float, float] | None = None


def held_out(data: StageData, floor: StageData | None = None) -> HeldOut | None:
    """What a stage's held-out rows say: a verification table, else the rows kept out; None where there are none.

    Parameters
    ----------
    floor
        Whose noise torques are counted in, so that two models can be compared; its own by default.
    """
    first, piece = data.first, data.pieces[-1]
    rows = piece.rows
    if len(data.pieces) > 1:  # single rows of a verification table that are wrong do not count, as in the ledger
        rows = without_outlying(rows, piece.residual, first.rows.without(~first.good[:, 0]), first.residual)
    size, used = size_of(rows, piece.residual, (floor or data).floor)
    counts = used & (piece.held_out if used.ndim == 1 else piece.held_out[:, None])
    if not counts.any():
        return None
    if size.ndim == 1:
        size, counts = size[:, None], counts[:, None]
    fold = np.repeat(rows.fold, size.shape[1])
    return HeldOut(size.ravel() ** 2, counts.ravel(), fold)


def spread_of(now: HeldOut, before: HeldOut | None, seed: int) -> Spread | None:
    """The errors with their intervals; None where too few whole poses, runs or sweeps were held out.

    With a start model, all three are of the rows that count both times.
    """
    counts = now.counts if before is None else now.counts & before.counts
    folds, index = np.unique(now.fold[counts], return_inverse=True)
    if len(folds) < MIN_UNITS:
        return None
    drawn = np.random.default_rng(seed).multinomial(len(folds), np.full(len(folds), 1.0 / len(folds)), BOOTSTRAP_DRAWS)
    drawn = np.vstack([np.ones(len(folds), dtype=drawn.dtype), drawn])  # first the rows as they are
    many = drawn @ np.bincount(index)

    def rms(squares: Array) -> Array:
        return np.asarray(np.sqrt(drawn @ np.bincount(index, squares[counts]) / many))

    after = rms(now.squares)
    if before is None:
        return Spread(len(folds), _interval(after))
    start = rms(before.squares)
    return Spread(len(folds), _interval(after), _interval(start), _interval(start - after))


def _interval(values: Array) -> tuple[float, float, float]:
    low, high = np.quantile(values[1:], (0.025, 0.975))
    return float(values[0]), float(low), float(high)


def spreads(stages: Mapping[Stage, StageData], before: Mapping[Stage, StageData], seed: int) -> dict[Stage, Spread]:
    """What can be said, stage by stage."""
    out = {}
    for stage, data in stages.items():
        old = before.get(stage)
        now = held_out(data)
        first = None if old is None else held_out(old, data)
        found = None if now is None else spread_of(now, first, seed)
        if found is not None:
            out[stage] = found
    return out


def spread_table(found: Mapping[Stage, Spread]) -> Table | None:
    """The errors with their intervals as a table; None where there are none."""
    rows = [
        (
            stage_title(stage),
            *(_text(part, stage) for part in (s.before, s.now, s.fall)),
            f"{s.folds} {kind_of(stage).words.folds}",
        )
        for stage, s in found.items()
    ]
    heads = ("Stage", "Before#", "Now#", "Fall#", "Of")
    return as_table(heads, rows, _CAPTION.format(draws=BOOTSTRAP_DRAWS)) if rows else None


def spread_sentences(found: Mapping[Stage, Spread]) -> list[str]:
    """For each stage with an error before: by how much it fell, and whether that differs from zero."""
    out = []
    for stage, s in found.items():
        if s.fall is None or s.fall == (0.0, 0.0, 0.0):
            continue
        significance = "" if s.fall[1] > 0.0 or s.fall[2] < 0.0 else "; this is not significant"
        out.append(
            f"{stage_title(stage)}: on the {s.folds} held-out {kind_of(stage).words.folds} the error fell by "
            f"{error_text(s.fall[0], kind_of(stage).error_unit)} (95 % interval {_ends(s.fall, stage)}){significance}."
        )
    return out


def _text(part: tuple[float, float, float] | None, stage: str) -> str:
    if part is None:
        return "–"
    return f"{error_text(part[0], kind_of(stage).error_unit)} ({_ends(part, stage)})"


def _ends(part: tuple[float, float, float], stage: str) -> str:
    unit = kind_of(stage).error_unit
    return ranged_text(part[1:], unit.replace("sigma", "σ"))
