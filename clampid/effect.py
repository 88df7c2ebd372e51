"""What a physical effect is: parameters, the signals it needs, and the deviation it causes at a station of the chain.

An effect is *location × covariate function*. Its file states the function; the chain (:mod:`clampid.chain.chain`) knows
what a deviation at each location does to the measurement. Zero amplitudes mean that the effect is absent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal

from clampid.roles import ROLES, Role
from clampid.search_policy import Search
from clampid.signals import PRESLIDING_LENGTHS, RELAXATION_TIMES, SIGNALS, Signal, Stage, signal
from clampid.standard_sets import STANDARD

__all__ = [
    "AT_A_SLIDE",
    "CAST_ARM",
    "PRESLIDING_LENGTHS",
    "RELAXATION_TIMES",
    "SIGNALS",
    "STAGES",
    "STATIONS",
    "UNITS",
    "Effect",
    "EffectError",
    "Parameter",
    "Signal",
    "Stage",
    "signal",
]

Per = Literal["robot", "joint", "link", "target", "anchor", "session"]
Within = Literal["q", "torque", "link_temperature"]
Deviation = Callable[[Any, Any], Any]

CAST_ARM = 730.0  # Nm: own weight about the shoulder of an arm for 20 kg, for which structural sizes are stated
LEAST_MOMENT = 1.0  # Nm: lighter than a toy's arm
STAGES: tuple[Stage, ...] = tuple(STANDARD)
"""The names of all stages, in the order in which they are fitted."""

WEAK_SPREAD = 10.0  # sizes: a prior that says next to nothing

UNITS: frozenset[str] = frozenset(
    {
        "", "m", "rad", "kg", "kg m", "kg m^2", "s", "K", "1/K", "Nm", "Nm s/rad", "Nm s^2/rad^2", "Nm/rad", "Nm/K",
        "rad/Nm", "rad/Nm^3", "rad/s", "m/Nm", "m/N", "m/s", "N/m", "rad/m", "1/(N m^2)", "rad/K",
        "1/m", "1/s", "m/rad", "N", "m/N^3", "N s/m", "N s^2/m^2", "N/K", "m/K",
    }
)  # fmt: skip

AT_A_SLIDE: Mapping[str, str] = MappingProxyType({
    "rad": "m", "rad/s": "m/s", "rad/K": "m/K", "rad/Nm": "m/N", "rad/Nm^3": "m/N^3", "Nm": "N", "Nm/rad": "N/m",
    "Nm/K": "N/K", "Nm s/rad": "N s/m", "Nm s^2/rad^2": "N s^2/m^2", "kg m^2": "kg",
})  # fmt: skip
"""Of a joint's parameter → what it is where the joint does not turn but slides."""

STATIONS: Mapping[str, tuple[tuple[str | int, ...], str]] = {
    "friction_state": (("n",), "state of the motors' dry friction beyond the sign of their last motion"),
    "joint_torque": (("n",), "torque at the joint, Nm; reaches the motors through T"),
    "motor_torque": (("n",), "torque at the motor, Nm"),
    "joint_angle": (("n",), "angle of the arm beyond what the controller reports, rad"),
    "base_twist": ((6,), "motion of the base, (w, v) in the base frame about its origin, rad and m"),
    "link_twist": (("n", 6), "motion of each link's far end, (w, v) at the next joint's point, rad and m"),
    "target_shift": ((3,), "shift of the tracked point, in the flange frame, m"),
    "fixture": ((6,), "motion of the clamped flange, (w, v) in the base frame about the flange, rad and m"),
    "measurement": ((3,), "error of the instrument, in its own frame, m"),
}
"""Where a deviation can act, in the order in which the chain visits them."""


class EffectError(ValueError):
    """An effect, or the name of one, that does not exist or does not fit; the message says what exists."""


@dataclass(frozen=True)
class Parameter:
    """One number of an effect, or one per joint, link or target.

    Attributes
    ----------
    name
        As in the effect's equation.
    unit
        SI, one of :data:`UNITS`.
    size
        What it may reasonably amount to: scales the solver.
    spread
        Standard deviation of its prior in sizes. The usual 10 is a weak prior. For an effect with many parameters that
        are hardly identifiable one by one, 1 keeps them near zero unless the rows say otherwise.
    gearing
        Of a number at the motor whose size, bounds and grid are stated at the joint: the power of the gear ratio by
        which they are larger at the motor, such as 2 for a compliance (angles times the ratio, torques over it), 1 for
        a speed and -2 for viscous friction. A description without gears has its motors at the joints.
    moment
        Of a compliance of the structure, Nm: the moment of an arm's own weight about its shoulder, stretched out, for
        which size and bounds are stated. A lighter arm has smaller bearings and thinner walls, and yields by as much
        under its own weight: size and bounds are larger in proportion. For a joint or link further out the bounds are
        wider still, by the moment that it carries (:func:`kinematics.masses.own_moment`). 0: the same for all arms.
    per
        ``robot``: one; ``joint``, ``link``, ``target``, ``anchor``, ``session``: one for each.
    bounds
        Physical limits.
    shape
        Not an amplitude: it has a start value and a grid, and means nothing while the amplitudes are zero.
    grid
        The values of a shape parameter that a search visits; the first is its start.
    fixed
        Where a fit keeps it at its start: ``everywhere``, because it is chosen and not measured, or at the ``first`` of
        its places, because the others count from there.
    share
        Whether it is a fraction in [0, 1] of another amplitude. It starts at 1: at 0 the shape parameters have no
        gradient.
    role, axis
        What it is in the field's terms, one of :data:`clampid.roles.ROLES`, where the core needs to know, and which
        component of that.
    """

    name: str
    unit: str
    size: float
    per: Per = "robot"
    bounds: tuple[float, float] = (-float("inf"), float("inf"))
    meaning: str = ""
    shape: bool = False
    grid: tuple[float, ...] = ()
    spread: float = WEAK_SPREAD
    fixed: Literal["nowhere", "first", "everywhere"] = "nowhere"
    gearing: int = 0
    share: bool = False
    moment: float = 0.0
    role: Role = ""
    axis: str = ""

    def __post_init__(self) -> None:
        if self.unit not in UNITS:
            raise EffectError(f"parameter {self.name}: unit {self.unit!r} is not known; known: {sorted(UNITS)}")
        if self.shape and not self.grid:
            raise EffectError(f"parameter {self.name}: a shape parameter needs a grid; its first value is the start")
        if self.share and self.bounds != (0.0, 1.0):
            raise EffectError(f"parameter {self.name}: a share has the bounds (0, 1), found {self.bounds}")
        if self.role not in ROLES:
            raise EffectError(f"parameter {self.name}: role {self.role!r} does not exist; known: {', '.join(ROLES)}")
        if self.axis not in ROLES[self.role][1]:
            axes = ", ".join(ROLES[self.role][1]) or "none"
            raise EffectError(f"parameter {self.name}: {self.role} has no axis {self.axis!r}; known: {axes}")
        if not self.size > 0:
            raise EffectError(f"parameter {self.name}: size must be positive, found {self.size}")
        if not self.spread > 0:
            raise EffectError(f"parameter {self.name}: spread must be positive, found {self.spread}")

    @property
    def prior_std(self) -> float:
        """Standard deviation of the prior, in the parameter's unit; a shape is known up to its own size."""
        return self.size * (1.0 if self.shape else self.spread)

    @property
    def start(self) -> float:
        """Where a fit begins, and what its prior is centred on."""
        if self.shape:
            return self.grid[0]
        return 1.0 if self.share else 0.0

    @property
    def clear(self) -> float:
        """The standard error below which the rows identify it: its size, at most half of its prior's deviation."""
        return self.size if self.shape else min(self.size, 0.5 * self.prior_std)

    def no_larger(self, limit: float) -> Parameter:
        """The same with a prior whose standard deviation is at most ``limit``."""
        return replace(self, spread=min(self.spread, limit / self.size))

    def geared(self, ratio: float) -> Parameter:
        """The same with size, bounds and grid for a joint whose motor turns ``ratio`` times as fast."""
        if not self.gearing:
            return self
        return replace(self._times(abs(ratio) ** self.gearing), gearing=0)

    def of_weight(self, shoulder: float, carried: float) -> Parameter:
        """The same for an arm whose weight has a moment, Nm, about its shoulder, and another about this joint or link.

        The size is that of the arm. A wrist may yield by more, as much as it carries less.
        """
        if not self.moment:
            return self
        size, most = (max(self.moment / max(moment, LEAST_MOMENT), 1.0) for moment in (shoulder, carried))
        lower, upper = self.bounds
        return replace(self._times(size), bounds=(lower * most, upper * most), moment=0.0)

    def _times(self, factor: float) -> Parameter:
        lower, upper = self.bounds
        grid = tuple(value * factor for value in self.grid)
        return replace(self, size=self.size * factor, bounds=(lower * factor, upper * factor), grid=grid)


@dataclass(frozen=True)
class Effect:
    """A physical effect: where it acts, with what parameters, on what signals, and where that is written.

    Attributes
    ----------
    name
        The variant, unique in the catalogue.
    family
        Its own name, or that of the effect that leads the family; a verdict goes by these.
    acts
        Station → ``deviation(p, x)``; p gives the parameters (casadi, ``(n,)`` or scalar), x the signals.
    parameters
        Its parameters.
    needs
        The signals its deviations read.
    stages
        The experiments it can act in.
    equation
        The deviation as the sources write it.
    source
        Keys of ``appendix_data/sources.bib``.
    at
        Name of the place of an effect that has just one, such as ``base``.
    coupled_only
        Stages in which it can sit only at joints that the transmission couples with others.
    holds_weight
        Whether it holds the arm's weight: a joint that bears next to none, such as an upright one, does not have it.
    sized_by
        Its shape parameter that is the size of all its amplitudes, which are counted in it and have a prior of one.
        If it is not given, it is estimated from the rows (:mod:`clampid.evidence.of_size`); a fit keeps it fixed.
    aligns
        An effect with a curve of each joint's own, of which this one says that they are one curve, turned and mirrored.
        From nothing it has no start: it begins with that effect's curves, aligned (:mod:`clampid.evidence.alignment`),
        and takes its place where they are one. Diagnosis tests for it there, and does not look for it among the
        candidates.
    event
        Its shape parameter that says when, in ``sweep_progress``, of an effect that happens once. It shows in the sweep
        in which it happens, and like the posture at which that was clamped its amplitudes are that sweep's own: no
        other sweep identifies them. Diagnosis tries every time; a fit begins at the likeliest.
    scanned
        Its shape parameter that says where, along the angle of its joint, an effect on that angle sits that is nothing
        elsewhere. Diagnosis tries every place that poses visited (:mod:`clampid.evidence.scan`), with every value of
        its other shapes; a fit begins at the likeliest.
    order
        Its shape parameter that says how often an effect on motor torques repeats in a revolution of its motor, where
        nobody knows. Diagnosis tries every order that the rows resolve (:mod:`clampid.evidence.orders`); a fit begins
        at the likeliest.
    caveat
        What standard errors of its parameters leave out, in words.
    known_within
        Of an empirical form per joint or link: the signal inside whose measured range alone the form is known, so that
        its stated uncertainty grows beyond (:mod:`clampid.models.ranges`). None of a law.
    search
        When and how diagnosis looks for it, and what parts it from others.
    """

    name: str
    family: str
    acts: Mapping[str, Deviation]
    parameters: tuple[Parameter, ...]
    needs: tuple[str, ...]
    stages: tuple[Stage, ...]
    equation: str
    source: tuple[str, ...]
    at: str = "robot"
    coupled_only: tuple[Stage, ...] = ()
    holds_weight: bool = False
    sized_by: str | None = None
    aligns: str | None = None
    event: str | None = None
    scanned: str | None = None
    order: str | None = None
    meaning: str = field(default="")
    caveat: str = field(default="")
    known_within: Within | None = None
    search: Search = field(default_factory=Search)

    def __post_init__(self) -> None:
        if self.known_within is not None and (self.known_within not in self.needs or self.per == "robot"):
            raise EffectError(
                f"effect {self.name}: known_within: expected a signal that it needs and parameters per joint or link, "
                f"found {self.known_within!r}, needs {', '.join(self.needs)}, parameters per {self.per}"
            )
        if self.scanned is not None and (self.per != "joint" or tuple(self.acts) != ("joint_angle",)):
            raise EffectError(
                f"effect {self.name}: scanned: expected an effect per joint on joint_angle alone, found one per "
                f"{self.per} on {', '.join(self.acts)}"
            )
        if self.order is not None and (self.per != "joint" or tuple(self.acts) != ("motor_torque",)):
            raise EffectError(
                f"effect {self.name}: order: expected an effect per joint on motor_torque alone, found one per "
                f"{self.per} on {', '.join(self.acts)}"
            )
        search = self.search
        for kind, found, known in (
            ("station", tuple(self.acts), tuple(STATIONS)),
            ("signal", (*self.needs, *((search.superseded_by,) if search.superseded_by else ())), tuple(SIGNALS)),
            ("stage", (*self.stages, *filter(None, (search.differs_from, search.shown_by))), STAGES),
        ):
            for name in found:
                if name not in known and not (kind == "signal" and signal(name)):
                    raise EffectError(f"effect {self.name}: {kind} {name!r} does not exist; known: {', '.join(known)}")

    @cached_property
    def by_name(self) -> Mapping[str, Parameter]:
        """Its parameters by their names."""
        return {parameter.name: parameter for parameter in self.parameters}

    @cached_property
    def roles(self) -> frozenset[Role]:
        """The roles that its parameters have."""
        return frozenset(p.role for p in self.parameters if p.role)

    @property
    def caveat_json(self) -> dict[str, str]:
        """What to add for programs: the caveat, where there is one."""
        return {"caveat": self.caveat} if self.caveat else {}

    @property
    def again(self) -> Effect:
        """Of an event, the same happening a second time, for which diagnosis looks once the first is known."""
        search = replace(self.search, refines=self.name)
        return replace(self, name=f"second_{self.name}", search=search, meaning=f"{self.name}, a second time")

    @property
    def of_readings(self) -> bool:
        """Whether it alters the instrument's readings alone, so that neither a command nor an export has it."""
        return set(self.acts) == {"measurement"}

    @property
    def of_session(self) -> bool:
        """Whether all its amplitudes belong to single sessions, so that it predicts nothing for others."""
        kinds = {p.per for p in self.parameters if not p.shape}
        return kinds == {"session"}

    @cached_property
    def per(self) -> Per:
        """``joint`` or ``link`` where the effect can sit at several places, else ``robot``."""
        kinds: set[Per] = {p.per for p in self.parameters if p.per in ("joint", "link")}
        if len(kinds) > 1:
            raise EffectError(f"effect {self.name}: parameters per {sorted(kinds)} in one effect")
        return kinds.pop() if kinds else "robot"
