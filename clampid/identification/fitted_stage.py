"""The fit of one stage to its rows, with priors and initial values from other stages."""

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
from clampid.identification.carried import carried_drives, carried_over, with_log_friction
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
    """The model of a stage with the estimate that it came from.

    Attributes
    ----------
    model
        The stage's part of a model.
    estimate
        The fit.
    base_reference
        Session → reference pose of the base ``(4, 4)``, instrument frame; empty if the stage has no poses.
    rows
        All rows, with those held out.
    contradicted
        Springs and clearances of the clamped stage that the poses contradict; none of its values were taken over then.
    universal
        For a fit of the mean norm: P_mean, P_std and P_max, m, of this fit and of least squares.
    weights
        How the weights of a log were chosen; None if they were not.
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
        """Reference positions of the anchors of distances, to which fitted shifts are added."""
        return anchors_of(self.rows) if self.model.kind.points else {}

    @property
    def floor(self) -> Floor:
        """The noise floor of the fitted rows."""
        return noise_floor(self.estimate.problem.rows, self.estimate.residual)

    def errors(self, verification: Rows | None, seed: int, floor: Floor | None = None) -> StageErrors:
        """Errors on fitted and held-out rows; torques in units of ``floor``, by default of the noise of the fit."""
        return stage_errors(self.estimate, self.rows, self.model.held_out, verification, seed, floor)

    @property
    def evidence(self) -> dict[str, Any]:
        """Further results for the ledger, in addition to the errors."""
        found: dict[str, Any] = {}
        if self.contradicted:
            found["contradicted"] = [a.to_json() for a in self.contradicted]
        if self.universal is not None:
            found["universal"] = dict(self.universal)
        if self.weights is not None:
            found["weights"] = self.weights.to_json()
        return found

    def with_best_weights(self, seed: int) -> FittedStage:
        """A log fitted with the weights that predict best (:mod:`clampid.fitting.equal_weights`); other stages as is.

        These weights are for the final model. Diagnosis tests whitened residuals and needs the noise model's weights.
        """
        if not self.model.kind.moving:
            return self
        estimate, weights = with_best_weights(self.estimate, seed)
        model = _model_of(estimate, self.rows, self.model.terms, self.model.held_out, self.model.carried_prior)
        return replace(self, model=model, estimate=estimate, weights=weights)

    def with_estimate(self, estimate: Estimate, carried_prior: Prior) -> FittedStage:
        """The stage at the solution of a joint fit; ``carried_prior``: information of the other stages."""
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
    """Fit one stage to all rows but those held out.

    Parameters
    ----------
    rows
        All rows of the stage.
    effects
        Name → effect.
    terms
        The active effects, with their places.
    others
        The stages already fitted, from which this one takes priors and initial values; or, after a joint fit, the
        information of all other rows as a prior.
    start
        Slot → initial value, SI.
    held_out
        Numbers of the folds that are not fitted, for each session.
    cost
        ``mean-norm``, for poses only: see :mod:`clampid.fitting.mean_norm`.
    last
        An earlier fit of the same rows with other terms. Its noise gives the first weights of poses and logs; its slots
        tell which clearances are new.

    Raises
    ------
    clampid.effect.EffectError
        An effect has no initial values in these rows.
    FitError
        The rows have no more numbers than the parameters that they determine.
    """
    carried_prior, before = (others, {}) if isinstance(others, Prior) else (None, others)
    rows = with_log_friction(rows, before, effects)
    if carried_prior is None and not start and open_turns(rows):
        trial = fit_problem(rows, effects, active_slots(rows, effects, terms))
        rows = from_likeliest_turn(trial, carried_over(rows, before, effects)[0])
    fitted_rows = rows.outside(held_out)

    weights = None if last is None or rows.kind.solved else last.noise

    def fit_terms(chosen: Sequence[Term], values: Mapping[Slot, float]) -> Estimate:
        """A fit of some terms, from which initial values of the others are found."""
        first = fit_problem(fitted_rows, effects, active_slots(rows, effects, chosen))
        if carried_prior is not None:
            return fit(first, (carried_prior,), values, weights=weights)
        priors, carried = carried_over(rows, before, effects)
        return fit(first, priors, {**carried, **values}, weights=weights)

    terms, start = initial_values(terms, effects, rows.layout, start or {}, fit_terms)
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
    if rows.kind.points and carried_prior is None:  # in a joint fit, shared parameters have one value and covariance
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
    """The slots of some terms in these rows; of the geometry only its independent parameters."""
    geometry = independent_geometry(rows, effects) if any(_is_geometry(t, effects) for t in terms) else ()
    rest = slots_of_terms([t for t in terms if not _is_geometry(t, effects)], effects, rows.layout, rows.stage)
    return (*geometry, *rest)


def _is_geometry(term: Term, effects: Mapping[str, Effect]) -> bool:
    """Whether a term is the geometry of the links, whose parameters are not independent."""
    return "link_frame" in effects[term.effect].roles


def _model_of(
    estimate: Estimate,
    rows: Rows,
    terms: Sequence[Term],
    held_out: Sequence[Sequence[int]],
    carried_prior: Prior | None,
) -> StageModel:
    """The stage's part of a model, from an estimate."""
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
    """Raise :class:`FitError` if no degree of freedom is left: the residual then does not show the noise."""
    numbers, determined = freedom_of(estimate)
    if determined >= numbers:
        raise FitError(
            f"{estimate.problem.stage}: expected more measured numbers than parameters that they determine, found "
            f"{numbers} and {determined}: no degree of freedom is left; measure more, or fit "
            "fewer effects (--effects)"
        )


def freedom_of(estimate: Estimate) -> tuple[int, int]:
    """Number of measured values, and number of parameters that they determine."""
    numbers = len(estimate.whitened.residual)
    return numbers, int(observability(_information(estimate), numbers)["parameters"])


def _information(estimate: Estimate) -> Array:
    """Information of the rows on the slots ``(P, P)``, in units of reasonable sizes, without the prior."""
    size = estimate.problem.sizes()
    return projected(estimate.whitened.normal * np.outer(size, size), len(estimate.slots))
