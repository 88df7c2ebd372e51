"""The stage free air from a log that is read window by window, and so may be longer than the machine's memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clampid.accuracy import StageErrors
from clampid.base_names import BaseParameter
from clampid.base_parameters import INERTIAL, MOST_ROWS, grouped
from clampid.effect import Effect
from clampid.fit import prior_of, start_of
from clampid.fit_log import LogFit, fit_log
from clampid.log_errors import LogPrior, log_errors
from clampid.log_sample import sampled_columns
from clampid.model import StageModel
from clampid.moments import covariance_of
from clampid.nulls import assumed_of, named_directions
from clampid.observability import observability, projected
from clampid.priors import description_priors
from clampid.slots import Layout, Slot, Term, slots_of_terms
from clampid.stages.experiment import experiment
from clampid.stages.log_design import KEPT_BYTES, LogDesign, fold_table
from clampid.stages.log_facts import WINDOW, LogFacts, LogPart, facts_of
from clampid.stages.rows import Array, Integers, Rows
from experiments.campaign import Campaign
from experiments.log_windows import LogTable

__all__ = ["FittedLog", "LogStage", "log_parts"]


@dataclass(frozen=True)
class FittedLog:
    """A fitted stage and its errors."""

    model: StageModel
    errors: StageErrors


def log_parts(campaigns: Sequence[Campaign]) -> list[LogPart]:
    """The tables free_air and wrist of campaigns, in order."""
    return [
        LogPart(campaign, s, name, LogTable.of(campaign.tables[name]))
        for s, campaign in enumerate(campaigns)
        for name in ("free_air", "wrist")
        if name in campaign.tables
    ]


class LogStage:
    """The stage free air of some tables with some effects.

    Parameters
    ----------
    parts
        The tables.
    accelerating
        Use rows in acceleration.
    window, kept_bytes
        Rows read at once, and how much may be kept between passes; they change nothing but time and memory.
    """

    def __init__(
        self,
        parts: Sequence[LogPart],
        layout: Layout,
        effects: Mapping[str, Effect],
        terms: Sequence[Term],
        accelerating: bool,
        *,
        window: int = WINDOW,
        kept_bytes: int = KEPT_BYTES,
        facts: LogFacts | None = None,
    ) -> None:
        self.parts, self.terms = list(parts), tuple(terms)
        self.facts = facts_of(parts, window) if facts is None else facts
        slots = slots_of_terms(terms, effects, layout, "free_air")
        bare = self._bare(layout, np.zeros((0, 2), dtype=np.int64))
        chain = experiment(bare, effects, slots).chain
        self.design = LogDesign(
            parts, self.facts, chain, layout.wrist, accelerating, window=window, kept_bytes=kept_bytes
        )
        self.folds = self._bare(layout, self.design.offset_keys)
        self.experiment = experiment(self.folds, effects, slots)

    @property
    def linear(self) -> bool:
        """Whether the effects are linear in their parameters; if not, the log has to be held to be fitted."""
        return self.design.linear

    def fit(self, held: Sequence[Sequence[int]], seed: int, start: Mapping[Slot, float] | None = None) -> FittedLog:
        """Fit all folds but those held out (per session their local numbers): what `clampid.identify` does with rows.

        Raises
        ------
        clampid.fit.FitError
            There are no rows to fit, or the model gives no finite prediction.
        """
        kept = ~self.folds.in_folds(held) if held else np.ones(len(self.folds), dtype=bool)
        priors = description_priors(self.folds)
        precision, mean = prior_of(self.experiment, priors)
        prior = LogPrior(precision, mean, self.experiment.sizes())
        fit = fit_log(self.design, kept, precision, mean, prior.size, start_of(self.experiment, start, priors))
        slots, count = self.experiment.slots, len(self.experiment.slots)
        here = np.flatnonzero(np.r_[np.ones(count, dtype=bool), kept[self.design.offset_keys[:, 0]]])
        inside = np.ix_(here, here)
        covariance = covariance_of(fit.moments, precision)[:count, :count]
        std, size = np.sqrt(np.maximum(np.diag(covariance), 0.0)), prior.size[here]
        information = fit.moments.normal[inside] * np.outer(size, size)
        model = StageModel(
            stage="free_air",
            terms=self.terms,
            slots=slots,
            theta=fit.moments.at[:count],
            covariance=covariance,
            identified=tuple(bool(b) for b in std < self.experiment.clear()[:count]),
            held_out=tuple(tuple(f) for f in held),
            outliers=tuple(self._place(int(row)) for row in fit.outliers),
            null_directions=named_directions(information, size, slots, precision[inside], assumed_of(self.experiment)),
            base=self._base(fit, covariance, precision[:count, :count]),
            observability=observability(projected(information, count), fit.moments.count),
        )
        out = bool(held) and any(held)
        return FittedLog(model, log_errors(self.design, fit, prior, self.folds, kept, out, seed))

    def _base(self, fit: LogFit, covariance: Array, precision: Array) -> tuple[BaseParameter, ...]:
        """The base parameters of gravity and inertia."""
        slots, effects = self.experiment.slots, self.experiment.effects
        if not any(s.effect in INERTIAL for s in slots):
            return ()
        steady = not any(effects[s.effect].family == "inertia" for s in slots)
        columns = sampled_columns(self.design, self.parts, slots, fit.noise.sigma, MOST_ROWS, steady)
        return grouped(self.experiment, fit.moments.at[: len(slots)], covariance, precision, *columns)

    def _place(self, row: int) -> tuple[int, str, int]:
        """Session, table and row from 1 of a row of the log from 0."""
        for part in self.parts:
            if row < part.table.rows:
                return part.session, part.name, row + 1
            row -= part.table.rows
        raise IndexError(row)

    def _bare(self, layout: Layout, offset_keys: Integers) -> Rows:
        """One row per fold, without signals."""
        folds = fold_table(self.parts, self.facts)
        count, robot = len(folds["run"]), self.parts[0].campaign.robot
        empty = np.zeros((count, robot.n))
        index = np.arange(count)
        return Rows(
            stage="free_air",
            robot=robot,
            layout=layout,
            signals={},
            measured=empty,
            sigma=np.ones_like(empty),
            used=np.ones_like(empty, dtype=bool),
            unit=index,
            fold=index,
            table=np.array([self.parts[p].name for p in folds["part"]]),
            row=index + 1,
            session=folds["session"],
            constants={"run": folds["run"], "time": np.zeros(count), "offset_keys": offset_keys},
            per_row=("time", "run"),
        )
