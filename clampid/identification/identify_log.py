"""The fit of the stage free air to logs that are read in windows, and may be larger than the memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clampid.effect import Effect
from clampid.fitting.accuracy import StageErrors
from clampid.fitting.base_names import BaseParameter
from clampid.fitting.base_parameters import grouped
from clampid.fitting.descent import covariance_of
from clampid.fitting.equal_weights import Weights
from clampid.fitting.fit_log import LogFit, LogPrior, fit_log
from clampid.fitting.log_errors import log_errors, parts_of
from clampid.fitting.log_sample import MOST_ROWS, sampled_columns
from clampid.fitting.log_springs import log_by_springs
from clampid.fitting.log_weights import best_weighted
from clampid.fitting.nulls import assumed_of, named_directions
from clampid.fitting.observability import observability, projected
from clampid.fitting.prior_and_start import prior_of, start_of
from clampid.fitting.priors import description_priors
from clampid.fitting.solve import limits_of
from clampid.models.model import StageModel
from clampid.roles import INERTIAL, INERTIAS
from clampid.slots import Layout, Prior, Slot, Term, slots_of_terms
from clampid.stages.counting import explains_acceleration
from clampid.stages.fit_problem import fit_problem
from clampid.stages.log_design import KEPT_BYTES, LogDesign, fold_table
from clampid.stages.log_facts import WINDOW, LogFacts, LogPart, facts_of
from clampid.stages.row_constants import SeriesConstants
from clampid.stages.rows import Array, Bools, Integers, Rows

__all__ = ["FittedLog", "LogStage"]


@dataclass(frozen=True)
class FittedLog:
    """The fitted stage free air.

    Attributes
    ----------
    stage
        The rows and effects that were fitted.
    model
        The stage's part of a model.
    fit, prior
        The fit by sums over rows, and its prior.
    covariance
        Covariance ``(P + K, P + K)``, SI.
    kept
        Which folds were fitted ``(F,)``.
    weights
        How the weights of the log were chosen; None if they are those of the noise model.
    """

    stage: LogStage
    model: StageModel
    fit: LogFit
    prior: LogPrior
    covariance: Array
    kept: Bools
    weights: Weights | None = None

    def errors(self, verification: Rows | None, seed: int) -> StageErrors:
        """Errors on fitted and held-out rows; ``verification`` is not used, since logs have no such table."""
        some_held_out = any(self.model.held_out)
        return log_errors(self.stage.design, self.fit, self.prior, self.stage.folds, self.kept, some_held_out, seed)

    @property
    def evidence(self) -> dict[str, Any]:
        """Further results for the ledger, in addition to the errors."""
        return {} if self.weights is None else {"weights": self.weights.to_json()}

    def with_solution(self, theta: Array, covariance: Array, carried_prior: Prior) -> FittedLog:
        """The stage at the solution of a joint fit.

        Parameters
        ----------
        theta, covariance
            Solution ``(P + K,)`` and covariance ``(P + K, P + K)``, SI.
        carried_prior
            Information of the other stages.
        """
        fit = replace(self.fit, moments=self.fit.moments.moved(theta))
        prior = LogPrior(*prior_of(self.stage.problem, (carried_prior,)), self.prior.limits)
        model = self.stage.model_of(fit, prior, covariance, self.kept, self.model.held_out, carried_prior)
        return replace(self, model=model, fit=fit, prior=prior, covariance=covariance)


class LogStage:
    """The stage free air of some tables, with some active effects.

    Parameters
    ----------
    parts
        The tables.
    layout
        Layout of the campaigns.
    effects
        The catalogue: name → effect.
    terms
        The active effects, with their places.
    window, kept_bytes
        Number of rows read at once, and number of bytes kept between passes; they affect only time and memory.
    facts
        Facts of the tables, if they are known.
    """

    def __init__(
        self,
        parts: Sequence[LogPart],
        layout: Layout,
        effects: Mapping[str, Effect],
        terms: Sequence[Term],
        *,
        window: int = WINDOW,
        kept_bytes: int = KEPT_BYTES,
        facts: LogFacts | None = None,
    ) -> None:
        self.parts, self.terms = list(parts), tuple(terms)
        self.facts = facts_of(parts, window) if facts is None else facts
        slots = slots_of_terms(terms, effects, layout, "free_air")
        bare = self._bare(layout, np.zeros((0, 2), dtype=np.int64))
        chain = fit_problem(bare, effects, slots).chain
        self.design = LogDesign(
            parts,
            self.facts,
            chain,
            layout.wrist,
            explains_acceleration([effects[term.effect] for term in terms]),
            window=window,
            kept_bytes=kept_bytes,
            sampled=MOST_ROWS,
        )
        self.folds = self._bare(layout, self.design.offset_keys)
        self.problem = fit_problem(self.folds, effects, slots)

    @property
    def linear(self) -> bool:
        """Whether all effects are linear in their parameters; a fit then takes fewer passes over the log."""
        return self.design.linear

    def fit(
        self,
        held_out: Sequence[Sequence[int]],
        start: Mapping[Slot, float] | None = None,
        seed: int = 0,
        *,
        correlated: bool = False,
    ) -> FittedLog:
        """Fit all folds but those held out.

        Parameters
        ----------
        held_out
            Numbers of the folds that are not fitted, for each session.
        start
            Slot → initial value, SI.
        seed
            For the cross-validation that chooses the weights (:mod:`clampid.fitting.equal_weights`).
        correlated
            Whether the weights of the correlated noise model are kept, without that choice.

        Raises
        ------
        clampid.fitting.solve.FitError
            There are no rows to fit, or the model gives no finite prediction.
        """
        kept = ~self.folds.in_folds(held_out) if held_out else np.ones(len(self.folds), dtype=bool)
        priors = description_priors(self.folds)
        at = start_of(self.problem, start, priors)
        precision, mean = prior_of(self.problem, priors)
        mean = np.where(self.problem.centred(), at, mean)
        prior = LogPrior(precision, mean, limits_of(self.problem))
        part = parts_of(self.folds, kept, seed)
        fit, weights = fit_log(self.design, kept, prior, at, part), None
        if not correlated:
            fit, weights = best_weighted(self.design, fit, prior, kept, part)
        covariance = covariance_of(fit.moments.normal, prior.precision, fit.moments.squares, fit.moments.count)
        model = self.model_of(fit, prior, covariance, kept, tuple(tuple(f) for f in held_out))
        return FittedLog(self, model, fit, prior, covariance, kept, weights)

    def model_of(
        self,
        fit: LogFit,
        prior: LogPrior,
        covariance: Array,
        kept: Bools,
        held_out: tuple[tuple[int, ...], ...],
        carried_prior: Prior | None = None,
    ) -> StageModel:
        """The stage's part of a model.

        Parameters
        ----------
        fit, prior
            The fit and its prior.
        covariance
            Covariance ``(P + K, P + K)``, SI.
        kept
            Which folds were fitted ``(F,)``.
        held_out
            Numbers of the folds that were not, for each session.
        carried_prior
            Information of other stages; None for a fit of this stage alone.
        """
        slots, count = self.problem.slots, len(self.problem.slots)
        here = np.flatnonzero(np.r_[np.ones(count, dtype=bool), kept[self.design.offset_keys[:, 0]]])
        inside = np.ix_(here, here)
        own = covariance[:count, :count]
        std, size = np.sqrt(np.maximum(np.diag(own), 0.0)), prior.size[here]
        information = fit.moments.normal[inside] * np.outer(size, size)
        assumed = assumed_of(self.problem)
        return StageModel(
            stage="free_air",
            terms=self.terms,
            slots=slots,
            theta=fit.moments.at[:count],
            covariance=own,
            identified=tuple(bool(b) for b in std < self.problem.clear()[:count]),
            held_out=held_out,
            outliers=tuple(self._place(int(row)) for row in fit.outliers),
            null_directions=named_directions(information, size, slots, prior.precision[inside], assumed),
            base=self._base(fit, own, prior.precision[:count, :count]),
            carried_prior=carried_prior,
            observability=observability(projected(information, count), fit.moments.count),
            by_springs=log_by_springs(self.design, self.parts, slots, fit.noise.sigma, fit.moments, prior.precision),
        )

    def _base(self, fit: LogFit, covariance: Array, precision: Array) -> tuple[BaseParameter, ...]:
        """The base parameters of gravity and inertia, with their covariance; none without such effects."""
        slots = self.problem.slots
        if not self.problem.numbers_of(*INERTIAL):
            return ()
        steady = not self.problem.numbers_of(*INERTIAS)
        columns = sampled_columns(self.design, self.parts, slots, fit.noise.sigma, steady)
        return grouped(self.problem, fit.moments.at[: len(slots)], covariance, precision, *columns)

    def _place(self, row: int) -> tuple[int, str, int]:
        """Session, table, and number in it from 1, of a row of the whole log, from 0."""
        for part in self.parts:
            if row < part.table.rows:
                return part.session, part.name, row + 1
            row -= part.table.rows
        raise IndexError(row)

    def _bare(self, layout: Layout, offset_keys: Integers) -> Rows:
        """Rows without signals, one for each fold; ``offset_keys`` ``(K, 2)``: unknown constants of single runs."""
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
            constants=SeriesConstants(run=folds["run"], time=np.zeros(count), offset_keys=offset_keys),
        )
