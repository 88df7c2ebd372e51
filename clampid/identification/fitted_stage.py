"""One stage fitted to its rows, with what it takes over from other stages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from clampid.effect import Effect, Stage
from clampid.fitting.accuracy import Floor, StageErrors, noise_floor, stage_errors
from clampid.fitting.base_parameters import base_parameters
from clampid.fitting.equal_weights import Weights, with_best_weights
from clampid.fitting.fit import fit
from clampid.fitting.friction_start import with_friction_start
from clampid.fitting.gauge import independent_geometry
from clampid.fitting.kept_friction import with_kept_friction
from clampid.fitting.log_springs import rows_by_springs
from clampid.fitting.mean_norm import compared, mean_norm
from clampid.fitting.nulls import null_directions
from clampid.fitting.observability import observability, projected
from clampid.fitting.open_base import from_likeliest_turn, open_turns, with_open_base
from clampid.fitting.open_flanks import with_open_flanks
from clampid.fitting.rest_friction import RestFriction, with_open_friction, with_rest_friction
from clampid.fitting.solve import Estimate, FitError
from clampid.fitting.unknown_friction import unknown_frictions
from clampid.fitting.unknown_masses import with_unknown_masses
from clampid.identification.carried import carried_drives, carried_over
from clampid.identification.initial_values import initial_values
from clampid.models.agreement import Agreement
from clampid.models.model import StageModel
from clampid.models.ranges import ranges_of
from clampid.slots import Prior, Slot, Term, slots_of_terms
from clampid.stages.fit_problem import fit_problem
from clampid.stages.pose_rows import Anchors, anchors_of
from clampid.stages.rows import Array, Rows
from clampid.stages.stage_kind import known_of

__all__ = ["Cost", "FittedStage", "active_slots", "fit_stage", "freedom_of"]

Cost = Literal["least-squares", "mean-norm"]


@dataclass(frozen=True)
class FittedStage:
    """A stage's model with the estimate it came from.

    Attributes
    ----------
    rows
        All rows, those held out too.
    contradicted
        Springs and clearances of the clamped stage that the poses contradict, so that none were taken over.
    universal
        Of a fit by the mean norm: its P_mean, P_std and P_max beside those of least squares, m.
    weights
        How a log's weights were chosen, if they were.
    """

    model: StageModel
    estimate: Estimate
    base_reference: Mapping[int, Array]
    rows: Rows
    contradicted: tuple[Agreement, ...] = ()
    universal: Mapping[str, Any] | None = None
    weights: Weights | None = None

    @property
    def anchors(self) -> Anchors:
        """Where the anchors of distances stand before their fitted shifts."""
        return anchors_of(self.rows) if self.model.kind.points else {}

    @property
    def floor(self) -> Floor:
        """What noise alone leaves of the fitted rows, as far as this fit knows it."""
        return noise_floor(self.estimate.problem.rows, self.estimate.residual)

    def errors(self, verification: Rows | None, seed: int, floor: Floor | None = None) -> StageErrors:
        """Errors on fitted and held-out rows; torques in units of ``floor``, by default of this fit's own noise."""
        return stage_errors(self.estimate, self.rows, self.model.held_out, verification, seed, floor)

    @property
    def evidence(self) -> dict[str, Any]:
        """What the ledger keeps beside the errors."""
        found: dict[str, Any] = {}
        if self.contradicted:
            found["contradicted"] = [a.to_json() for a in self.contradicted]
        if self.universal is not None:
            found["universal"] = dict(self.universal)
        if self.weights is not None:
            found["weights"] = self.weights.to_json()
        return found

    def with_best_weights(self, seed: int) -> FittedStage:
        """A log with the weights that predict best (:mod:`clampid.fitting.equal_weights`); other stages as they are.

        For the model that is kept. Diagnosis judges fits by their whitened residuals, and needs the others.
        """
        if not self.model.kind.moving:
            return self
        estimate, weights = with_best_weights(self.estimate, seed)
        model = _model_of(estimate, self.rows, self.model.terms, self.model.held_out, self.model.carried_prior)
        return replace(self, model=model, estimate=estimate, weights=weights)

    def with_estimate(self, estimate: Estimate, carried_prior: Prior) -> FittedStage:
        """The same stage at the solution of a joint fit; ``carried_prior``: what other stages say."""
        estimate = with_open_base(with_kept_friction(estimate))
        model = _model_of(estimate, self.rows, self.model.terms, self.model.held_out, carried_prior)
        return replace(self, model=model, estimate=estimate)


def fit_stage(
    rows: Rows,
    effects: Mapping[str, Effect],
    terms: Sequence[Term],
    others: Mapping[Stage, StageModel] | Prior,
    start: Mapping[Slot, float] | None = None,
    held_out: Sequence[Sequence[int]] = (),
    cost: Cost = "least-squares",
    last: Estimate | None = None,
) -> FittedStage:
    """Fit one stage on all rows but those held out.

    Parameters
    ----------
    others
        The stages already fitted, whose values this one takes over; or, where a joint fit knows, what all other rows
        say.
    cost
        ``mean-norm``, of ``poses`` only: see :mod:`clampid.fitting.mean_norm`.
    last
        A fit of the same rows with other terms: how poses are weighted at first.

    Raises
    ------
    clampid.effect.EffectError
        An effect needs something of these rows to begin with that they do not have.
    FitError
        The rows have no more numbers than the parameters that they determine.
    """
    carried_prior, before = (others, {}) if isinstance(others, Prior) else (None, others)
    if carried_prior is None and not start and open_turns(rows):
        trial = fit_problem(rows, effects, active_slots(rows, effects, terms))
        rows = from_likeliest_turn(trial, carried_over(rows, before, effects)[0])
    fitted_rows = rows.outside(held_out)

    weights = last.noise if last is not None and rows.kind.points else None

    def begin(chosen: Sequence[Term], values: Mapping[Slot, float]) -> Estimate:
        first = fit_problem(fitted_rows, effects, active_slots(rows, effects, chosen))
        if carried_prior is not None:
            return fit(first, (carried_prior,), values, weights=weights)
        priors, carried = carried_over(rows, before, effects)
        return fit(first, priors, {**carried, **values}, weights=weights)

    terms, start = initial_values(terms, effects, rows.layout, start or {}, begin)
    trial = fit_problem(fitted_rows, effects, active_slots(rows, effects, terms))
    contradicted: tuple[Agreement, ...] = ()
    friction = RestFriction(start, None)
    if carried_prior is not None:
        estimate = fit(trial, (carried_prior,), start, weights=weights)
    else:
        priors, carried = carried_over(rows, before, effects)
        if known_of(before, "moving") is not None:
            earlier = None if last is None else last.slots
            friction = with_rest_friction(trial, priors, {**carried, **start}, before=earlier)
        else:
            friction = RestFriction(with_friction_start(trial, priors, {**carried, **start}), None)
        estimate = fit(trial, (*priors, *friction.priors), friction.start, weights=weights)
        _refuse_no_freedom(estimate)
        alone = with_open_friction(estimate, friction.fixed)
        drives = carried_drives(known_of(before, "solved") if rows.kind.points else None, alone)
        contradicted = drives.contradicted
        if drives.prior is not None:
            priors = (*priors, drives.prior)
            friction = RestFriction(estimate.values(), None)
            if known_of(before, "moving") is not None:
                friction = with_rest_friction(trial, priors, estimate.values(), anew=True)
            estimate = fit(trial, (*priors, *friction.priors), friction.start, weights=weights)
    estimate = with_kept_friction(estimate)
    if rows.kind.points and carried_prior is None:  # a joint fit has one value and error of what stages share
        estimate = with_open_friction(with_open_flanks(estimate), friction.fixed)
        estimate = with_unknown_masses(estimate) if known_of(before, "moving") is None else estimate
    universal = None
    if cost == "mean-norm":
        squares, estimate = estimate, mean_norm(estimate)
        universal = compared(estimate, squares)
    estimate = with_open_base(estimate)
    reference = {}
    if rows.kind.points:
        for s in np.unique(rows.session):
            reference[int(s)] = rows.pose.base_reference[np.flatnonzero(rows.session == s)[0]]
    return FittedStage(
        _model_of(estimate, rows, terms, held_out, carried_prior), estimate, reference, rows, contradicted, universal
    )


def active_slots(rows: Rows, effects: Mapping[str, Effect], terms: Sequence[Term]) -> tuple[Slot, ...]:
    """The slots of some terms in these rows; of the geometry, only what the robot's gauge leaves independent."""
    geometry = independent_geometry(rows, effects) if any(_is_geometry(t, effects) for t in terms) else ()
    rest = slots_of_terms([t for t in terms if not _is_geometry(t, effects)], effects, rows.layout, rows.stage)
    return (*geometry, *rest)


def _is_geometry(term: Term, effects: Mapping[str, Effect]) -> bool:
    return "link_frame" in effects[term.effect].roles


def _model_of(
    estimate: Estimate,
    rows: Rows,
    terms: Sequence[Term],
    held_out: Sequence[Sequence[int]],
    carried_prior: Prior | None,
) -> StageModel:
    count, fitted = len(estimate.slots), estimate.problem.rows
    bad = np.flatnonzero(estimate.outliers)
    turns, sessions = open_turns(fitted), rows.layout.sessions
    unknown = unknown_frictions(estimate) if rows.kind.points else []
    return StageModel(
        stage=rows.stage,
        terms=tuple(terms),
        slots=estimate.slots,
        theta=estimate.theta[:count],
        covariance=estimate.covariance[:count, :count],
        identified=tuple(bool(b) and k not in unknown for k, b in enumerate(estimate.identified[:count])),
        held_out=tuple(tuple(f) for f in held_out),
        outliers=tuple((int(fitted.session[i]), str(fitted.table[i]), int(fitted.row[i])) for i in bad),
        null_directions=(*(turn.words(sessions[turn.session]) for turn in turns), *null_directions(estimate)),
        base=base_parameters(estimate),
        by_springs=rows_by_springs(estimate) if rows.kind.moving else None,
        carried_prior=carried_prior,
        lean=estimate.problem.chain.lean,
        ranges=ranges_of(fitted, estimate.outliers) if rows.kind.points else None,
        observability=observability(_information(estimate), len(estimate.whitened.residual)),
    )


def _refuse_no_freedom(estimate: Estimate) -> None:
    """Refuse rows that the parameters can follow whatever was measured: what is left of them is no noise."""
    numbers, determined = freedom_of(estimate)
    if determined >= numbers:
        raise FitError(
            f"{estimate.problem.stage}: expected more measured numbers than parameters that they determine, found "
            f"{numbers} and {determined}: no degree of freedom is left; measure more, or fit "
            "fewer effects (--effects)"
        )


def freedom_of(estimate: Estimate) -> tuple[int, int]:
    """How many numbers were measured, and how many parameters they determine."""
    numbers = len(estimate.whitened.residual)
    return numbers, int(observability(_information(estimate), numbers)["parameters"])


def _information(estimate: Estimate) -> Array:
    """Information of the rows on the slots ``(P, P)``, in units of plausible sizes, without the prior."""
    size = estimate.problem.sizes()
    return projected(estimate.whitened.normal * np.outer(size, size), len(estimate.slots))
