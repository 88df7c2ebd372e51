"""Candidates for addition to a model: every absent effect at each place where it could act, and probes without physics.

A candidate is *location × covariate function*. Effects and probes therefore share one code path: each column is the
derivative of the measurement by one parameter.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from clampid.effect import Effect, Parameter
from clampid.evidence.columns import AnyColumns, Columns, columns_from
from clampid.evidence.of_size import SIZES
from clampid.fitting.further_columns import Derivatives, whitened_columns
from clampid.fitting.gauge import independent_geometry
from clampid.fitting.noise import Whitened
from clampid.fitting.solve import Estimate
from clampid.roles import Role
from clampid.slots import Slot, Term, number_of, slots_of
from clampid.stages.fit_problem import FitProblem, parameter_of
from clampid.stages.rows import Array
from clampid.stages.temperatures import reads_temperatures

__all__ = [
    "Candidate",
    "candidate_of",
    "columns_of",
    "is_sought",
    "label_of",
    "named_candidates",
    "terms_not_active",
]

FRICTION_SHARES = (0.5, 1.0)  # of a joint's friction in the log, that may be the arm side's


@dataclass(frozen=True)
class Candidate:
    """Columns that might be missing from the model.

    Attributes
    ----------
    name
        The effect's name, or a sentence for a probe.
    terms
        What would be added; empty for a probe.
    slots
        The amplitudes, one for each column; empty for a probe.
    shapes
        Values of the shape parameters at which the columns were evaluated, SI.
    columns
        Whitened, one for each slot.
    depends_on
        Recorded variables it depends on, by column name without unit.
    places
        Where it acts: ``joint3``, ``base`` …
    prior
        Prior standard deviations ``(k,)`` of the amplitudes, if they are too many to be identified without a prior;
        else None.
    sizes
        Factors on that prior, where it only bounds the size of the effect; the score test chooses one.
    sized_by
        The effect's shape parameter that is this size.
    reasonable
        Declared reasonable sizes ``(k,)`` of the amplitudes; None for a probe.
    units
        Units of the amplitudes on this robot.
    describes
        Names of the effects of which this one is a symptom (:attr:`clampid.search_policy.Search.symptom_of`).
    friction
        Frictions of the model at which the columns were evaluated, where these are not the fit's, SI.
    """

    name: str
    family: str
    terms: tuple[Term, ...]
    slots: tuple[Slot, ...]
    shapes: Mapping[Slot, float]
    columns: AnyColumns
    depends_on: tuple[str, ...]
    places: tuple[str, ...]
    prior: Array | None = None
    sizes: tuple[float, ...] = (1.0,)
    sized_by: Slot | None = None
    reasonable: Array | None = None
    units: tuple[str, ...] = ()
    describes: tuple[str, ...] = ()
    friction: Mapping[Slot, float] = field(default_factory=dict)

    def is_variant_of(self, other: Candidate) -> bool:
        """Whether fits decide between two candidates at the same places: of one family, or a cause and its symptom."""
        kin = self.family == other.family or self.name in other.describes or other.name in self.describes
        return kin and self.places == other.places

    def of_size(self, size: float) -> Candidate:
        """The same candidate with the prior multiplied by ``size``; the columns are not changed."""
        if self.prior is None:
            return self
        shapes = {s: value * size if s == self.sized_by else value for s, value in self.shapes.items()}
        return replace(self, prior=self.prior * size, sizes=(1.0,), shapes=shapes)

    @property
    def remembered(self) -> Candidate:
        """The same without its columns, to save memory."""
        return replace(self, columns=Columns((), 0))

    @property
    def label(self) -> str:
        """``effect@place`` for messages; see :func:`label_of`."""
        return label_of(self.name, self.places)


def label_of(name: str, places: Sequence[str]) -> str:
    """``effect@place1,place2`` for messages; the name alone where it has no places."""
    return f"{name}@{','.join(places)}" if places else name


def terms_not_active(estimate: Estimate, effects: Mapping[str, Effect]) -> list[Term]:
    """Every effect that acts in this stage, at all places where it is not active; not those that are sought otherwise.

    An effect that refines another one is searched only where the other is active: a hardening spring where there is a
    spring.
    """
    active = {(s.effect, s.place) for s in estimate.slots}
    layout = estimate.problem.rows.layout
    out = []
    for effect in effects.values():
        if not estimate.problem.kind.has(effect) or effect.aligns is not None:
            continue
        if effect.event is not None or effect.scanned is not None or effect.order is not None:
            continue
        if effect.search.opt_in or not _temperatures_vary(estimate, effect):
            continue
        if effect.search.refines is not None and not any(name == effect.search.refines for name, _ in active):
            continue
        if effect.search.scope == "together" or effect.per == "robot":
            if not any(name == effect.name for name, _ in active):
                out.append(Term(effect.name, None if effect.per != "robot" else effect.at))
            continue
        refined = {place for name, place in active if name == effect.search.refines and place.startswith(effect.per)}
        out += [
            Term(effect.name, p)
            for p in layout.allowed(effect, estimate.problem.stage)
            if (effect.name, p) not in active and (not refined or p in refined) and is_sought(estimate, effect, p)
        ]
    return out


def _temperatures_vary(estimate: Estimate, effect: Effect) -> bool:
    """Whether every temperature that an effect needs varies; a constant one makes it a constant of another effect."""
    signals = estimate.problem.rows.signals
    return all(np.any(np.ptp(signals[name], axis=0) > 0.0) for name in effect.needs if reads_temperatures(name))


def is_sought(estimate: Estimate, effect: Effect, place: str) -> bool:
    """Whether an effect is searched at a joint or link: the kind of joint fits, and no recorded signal replaces it."""
    joint = estimate.problem.rows.robot.joints[number_of(place)]
    return effect.search.joint_kind in (None, joint.kind) and not _recorded(estimate, effect, place)


def _recorded(estimate: Estimate, effect: Effect, place: str) -> bool:
    """Whether the signal that supersedes an effect was recorded at a joint or link, that is, varies.

    Once an effect of that signal is in the model, it does not count: a sensor that sits elsewhere may not show all.
    """
    signal, effects = effect.search.superseded_by, estimate.problem.effects
    if signal is None or any(signal in effects[slot.effect].needs for slot in estimate.slots):
        return False
    number = number_of(place)
    return bool(np.ptp(estimate.problem.rows.signals[signal][:, number]) > 0.0)


def named_candidates(
    estimate: Estimate,
    effects: Mapping[str, Effect],
    fired: Collection[str] | None = None,
    known: Derivatives | None = None,
) -> list[Candidate]:
    """The absent effects as candidates: place by place, or at all remaining places together, as their scope says.

    Events are scored by :func:`clampid.evidence.events.event_scores`.

    Parameters
    ----------
    estimate
        The fit whose residual is searched.
    effects
        All known effects, by name.
    fired
        Names of the significant probes. An effect with a revealing probe
        (:attr:`clampid.search_policy.Search.revealed_by`) is a candidate only if that probe is among them. None: every
        absent effect is a candidate.
    known
        Derivatives at this fit, to which those that are missing are added.
    """
    known = known or Derivatives()
    rows = estimate.problem.rows
    terms = terms_not_active(estimate, effects)
    if fired is not None:
        terms = [
            t
            for t in terms
            if effects[t.effect].search.revealed_by is None or effects[t.effect].search.revealed_by in fired
        ]
    slots: dict[Slot, None] = {}
    of_term: dict[Term, tuple[Slot, ...]] = {}
    for term in terms:
        effect = effects[term.effect]
        if "link_frame" in effect.roles:
            found = independent_geometry(rows, effects)
        else:
            alone = term.place is not None and effect.per != "robot"
            found = slots_of(effect, rows.layout, rows.stage, (term.place,) if alone and term.place else None)
        of_term[term] = found
        slots |= dict.fromkeys(found)
    every = [s for s in slots if s not in estimate.slots]
    parameters = {s: parameter_of(s, effects, rows.robot) for s in every}
    out: list[Candidate] = []
    for friction, extra, values in _evaluations(estimate, every, parameters, effects):
        white = known.of(_with(estimate, friction), extra, values)
        index = {s: k for k, s in enumerate(extra)}
        changed = {s.effect for s in extra}
        for name in dict.fromkeys(t.effect for t in terms):
            if name not in changed:
                continue
            effect = effects[name]
            own = [t for t in terms if t.effect == name]
            groups: list[Sequence[Term]] = []
            if effect.search.scope in ("places", "both") or effect.per == "robot":
                groups += [(t,) for t in own]
            if effect.search.scope in ("together", "jointly") or (effect.search.scope == "both" and len(own) > 1):
                groups.append(own)
            for group in groups:
                members = list(dict.fromkeys(s for t in group for s in of_term[t] if s in index))
                if members:
                    candidate = candidate_of(effect, group, members, parameters, index, values, white)
                    out.append(replace(candidate, friction=friction) if friction else candidate)
    return out


def _evaluations(
    estimate: Estimate, slots: Sequence[Slot], parameters: Mapping[Slot, Parameter], effects: Mapping[str, Effect]
) -> Iterator[tuple[Mapping[Slot, float], list[Slot], list[float]]]:
    """Where the columns of absent slots are evaluated: frictions other than the fit's, slots and their values, SI.

    At the first value of every shape, and at the further ones. Beside that with other friction at the joints, where
    little in the rows shows it:

    * of effects that read flanks, with the flanks that more friction gives: without a clearance in the model nothing
      shows the friction that selects them.
    * of effects that read torques, without friction: without a spring in the model only flanks show it.
    """
    for level in range(max((len(p.grid) for p in parameters.values() if p.shape), default=1)):
        deep = {s.effect for s in slots if level < len(parameters[s].grid)}
        extra = [s for s in slots if level == 0 or s.effect in deep]
        yield {}, extra, [parameters[s].grid[level] if parameters[s].shape else 0.0 for s in extra]
    for signal, others in (
        ("flank", [_friction_of_log(estimate, share) for share in FRICTION_SHARES]),
        ("torque", [_no_friction(estimate)]),
    ):
        extra = [s for s in slots if signal in effects[s.effect].needs and not parameters[s].shape]
        for friction in others if extra else ():
            if friction:
                yield friction, extra, [0.0] * len(extra)


def _friction_of_log(estimate: Estimate, share: float) -> dict[Slot, float]:
    """A share of the log's dry friction at the joints without clearance, as far as known and not the fit's.

    Where the joint bears less than that, too: there the last motion selects most flanks, which the fit's own friction
    may have absorbed, with any sign.
    """
    problem = estimate.problem
    most = problem.rows.pose.flank_friction if problem.kind.points else None
    if most is None:
        return {}
    own = [slot for slot in _frictions_beside_no(problem, "clearance") if np.isfinite(most[slot.number])]
    return _changed(estimate, {slot: share * float(most[slot.number]) for slot in own})


def _no_friction(estimate: Estimate) -> dict[Slot, float]:
    """Zero for the friction at the arm's side of joints that have no spring, where the fit of poses has some."""
    problem = estimate.problem
    if not problem.kind.points:
        return {}
    return _changed(estimate, dict.fromkeys(_frictions_beside_no(problem, "compliance"), 0.0))


def _frictions_beside_no(problem: FitProblem, role: Role) -> list[Slot]:
    """Frictions at the arm's side of joints that have no parameter of a role."""
    there = {problem.slots[k].place for k in problem.numbers_of(role)}
    return [problem.slots[k] for k in problem.numbers_of("arm_friction") if problem.slots[k].place not in there]


def _changed(estimate: Estimate, wanted: dict[Slot, float]) -> dict[Slot, float]:
    """Wanted values of parameters if any of them is not the fit's."""
    values = estimate.values()
    return wanted if any(values[slot] != value for slot, value in wanted.items()) else {}


def _with(estimate: Estimate, changed: Mapping[Slot, float]) -> Estimate:
    """The fit with other values of those of its parameters that are among ``changed``."""
    if not changed:
        return estimate
    theta = estimate.theta.copy()
    for k, slot in enumerate(estimate.slots):
        theta[k] = changed.get(slot, theta[k])
    return replace(estimate, theta=theta)


def columns_of(estimate: Estimate, candidates: Sequence[Candidate]) -> Array:
    """Whitened columns ``(M, k)`` of candidates in the rows of an estimate; slots active there are left out."""
    seen, found = set(estimate.slots), [np.zeros((len(estimate.whitened.residual), 0))]
    rest = list(candidates)
    while rest:
        friction = rest[0].friction
        alike, rest = [c for c in rest if c.friction == friction], [c for c in rest if c.friction != friction]
        shapes = {slot: value for c in alike for slot, value in c.shapes.items() if slot not in seen}
        amplitudes = list(dict.fromkeys(slot for c in alike for slot in c.slots if slot not in seen))
        if amplitudes:
            values = [0.0] * len(amplitudes) + list(shapes.values())
            white = whitened_columns(_with(estimate, friction), [*amplitudes, *shapes], values)
            found.append(white.jacobian[:, : len(amplitudes)])
            seen.update(amplitudes)
    return np.hstack(found)


def candidate_of(
    effect: Effect,
    group: Sequence[Term],
    members: Iterable[Slot],
    parameters: Mapping[Slot, Parameter],
    index: Mapping[Slot, int],
    values: Sequence[float],
    white: Whitened,
) -> Candidate:
    """An effect at one place or several as a candidate.

    Parameters
    ----------
    group, members
        What would be added, and its slots.
    parameters, index, values
        Slot → parameter on this robot; slot → number of its column; value of each column's slot, SI.
    white
        The whitened columns.
    """
    members = list(members)
    amplitudes = tuple(s for s in members if not parameters[s].shape)
    shapes = {s: values[index[s]] for s in members if parameters[s].shape}
    assumed = all(parameters[s].spread <= 1.0 for s in amplitudes)
    sized_by = next((s for s in shapes if s.parameter == effect.sized_by), None)
    return Candidate(
        name=effect.name,
        family=effect.family,
        describes=effect.search.symptom_of,
        terms=tuple(group),
        slots=amplitudes,
        shapes=shapes,
        columns=columns_from(white, [index[s] for s in amplitudes]),
        depends_on=(),
        places=tuple(t.place for t in group if t.place is not None),
        prior=np.array([parameters[s].prior_std for s in amplitudes]) if assumed else None,
        sizes=(1.0,) if sized_by is None else SIZES,
        sized_by=sized_by,
        reasonable=np.array([parameters[s].size for s in amplitudes]),
        units=tuple(parameters[s].unit for s in amplitudes),
    )
