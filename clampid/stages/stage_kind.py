"""A stage as a value: all differences between kinds of rows are stated here once, so no other code asks for its name.

Each file of :mod:`clampid.stages.kinds` holds one, ``STAGE``. It is found by its name in
:data:`clampid.standard_sets.STANDARD`; no other code depends on the number of stages.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal, TypeVar

from clampid.chain.stage_chain import StageChain
from clampid.effect import STAGES, Effect, EffectError

if TYPE_CHECKING:
    from clampid.chain.chain import Chain
    from clampid.slots import Layout
    from clampid.stages.rows import Array, Rows
    from experiments.campaign import Campaign

__all__ = [
    "StageKind",
    "StageWords",
    "Trait",
    "Wanted",
    "acts_with",
    "derivative_of",
    "error_of",
    "kind_of",
    "kinds",
    "known_of",
    "moved_of",
    "only_of",
    "stage_of_table",
    "stages_with",
]

T = TypeVar("T")
Trait = Literal["points", "moving", "solved", "resting"]
"""Properties of :class:`StageKind` by which the rest of the program distinguishes stages."""


@dataclass(frozen=True)
class StageWords:
    """Words for a stage in texts.

    Attributes
    ----------
    title
        Heading of its figures and tables.
    rows
        What its rows are, for a list of effects: "measured points".
    folds
        The unit of cross-validation, in the plural: "poses".
    moved
        The verb for a joint's motion before a row: "approached", "moved".
    record
        What to record so that direction-dependent effects are identifiable: "the direction of approach".
    measurement
        The whole measurement, with its article: "a log of torques in free air".
    more
        Further rows that would distinguish effects that these rows confuse.
    """

    title: str
    rows: str
    folds: str
    moved: str
    record: str
    measurement: str
    more: str


@dataclass(frozen=True)
class Wanted:
    """Which rows of a stage are wanted; each stage reads the fields that it needs.

    Attributes
    ----------
    active
        The effects that the rows are for: they decide which rows can be used.
    base, anchors
        Where the instrument sees base and anchors, as of :func:`clampid.stages.pose_rows.pose_rows`.
    table
        The stage's table `StageKind.verification`; "": the tables that are fitted.
    """

    active: Collection[Effect] = ()
    base: Mapping[int, Array] | None = None
    anchors: Mapping[int, Mapping[str, Array]] | None = None
    table: str = ""


Residual = Callable[["Rows", "Chain", "Array", "Array"], tuple["Array", "Array"]]
"""``(rows, chain, theta, offsets)`` to measured less predicted ``(N, m)``, SI, and the prediction's derivative
``(N, m, P + K)`` by slots ``(P,)`` and offsets ``(K,)``."""


def error_of(residual: Residual) -> Callable[[Rows, Chain, Array, Array], Array]:
    """The residual without its derivative, of a stage that has no shorter way to it."""
    return lambda rows, chain, theta, offsets: residual(rows, chain, theta, offsets)[0]


def derivative_of(residual: Residual) -> Callable[[Rows, Chain, Array, Array, int], Array]:
    """The prediction's derivative by the slots from one on, of a stage that has no shorter way to it."""
    return lambda rows, chain, theta, offsets, first: residual(rows, chain, theta, offsets)[1][:, :, first : len(theta)]


def moved_of(residual: Residual) -> Callable[[Rows, Chain, Array, Array, Array], Array]:
    """Change of the prediction by steps, of a stage that has no shorter way to it."""
    return lambda rows, chain, theta, offsets, steps: residual(rows, chain, theta, offsets)[1] @ steps


@dataclass(frozen=True, kw_only=True)
class StageKind(StageChain):
    """A stage: its measurements, how its rows are made, and the chain's prediction for them.

    Attributes
    ----------
    tables
        Tables of a campaign that feed it.
    words
        See :class:`StageWords`.
    error_unit
        ``m``: errors of rows are lengths of points' errors; ``sigma``: of single numbers in units of their noise.
    points
        Rows are points of the arm, seen by an instrument whose pose relative to the base is unknown. Their noise is
        estimated from repeated postures; frames, loads and flanks are part of the model.
    verification
        Name of a table of the same columns that no fit reads; "" where there is none.
    side
        Signal of the side from which a joint came to a row; None where every fold has both.
    shared_channels
        The noise of which columns ``(m,)`` is one number; of a stage that has as many channels as motors, none is.
    offset_size
        Plausible size of an unknown constant of one run or sweep: rad in an equilibrium, else Nm.
    spring_start
        Initial compliance of springs, in their sizes; None: zero.
    linear
        The prediction is linear in the stations' deviations, with the same derivative everywhere.
    rows
        Rows of the campaigns' tables, all that can be used with the active effects; see :class:`Wanted`.
    residual
        See :data:`Residual`.
    error
        The same without the derivative.
    derivative
        ``(rows, chain, theta, offsets, first)``: the derivative by slots from the ``first`` on, ``(N, m, P - first)``.
    moved
        ``(rows, chain, theta, offsets, steps)``: what steps ``(P + K, k)`` do to the prediction ``(N, m, k)``.
    frozen
        ``(rows, chain, theta)``: the rows' signals with flanks and loads frozen at these parameters; None where no
        signal follows the parameters.
    prior
        ``(rows, first, precision, mean)``: the prior ``(P + K, P + K)``, ``(P + K,)`` including that of the offsets,
        which start at ``first``; None where the offsets have none.
    """

    tables: tuple[str, ...]
    words: StageWords
    error_unit: Literal["m", "sigma"]
    rows: Callable[[Sequence[Campaign], Layout, Wanted], Rows]
    residual: Residual
    error: Callable[[Rows, Chain, Array, Array], Array]
    derivative: Callable[[Rows, Chain, Array, Array, int], Array]
    moved: Callable[[Rows, Chain, Array, Array, Array], Array]
    points: bool = False
    verification: str = ""
    side: str | None = None
    shared_channels: tuple[tuple[int, ...], ...] = ()
    offset_size: float = 1.0
    spring_start: float | None = None
    linear: bool = False
    frozen: Callable[[Rows, Chain, Array], Mapping[str, Array]] | None = None
    prior: Callable[[Rows, int, Array, Array], tuple[Array, Array]] | None = None

    def channels(self, width: int) -> list[tuple[int, ...]]:
        """Which of a row's ``width`` numbers share their noise."""
        if not self.shared_channels:
            return [(c,) for c in range(width)]
        return [tuple(c for c in group if c < width) for group in self.shared_channels]


@cache
def kind_of(name: str) -> StageKind:
    """The stage of a name.

    Raises
    ------
    EffectError
        There is none of this name.
    """
    if name not in STAGES:
        raise EffectError(f"stage {name!r} is not known; known: {', '.join(STAGES)}")
    found: StageKind = importlib.import_module(f"clampid.stages.kinds.{name}").STAGE
    return found


def kinds() -> tuple[StageKind, ...]:
    """All stages in the order in which they are fitted."""
    return tuple(map(kind_of, STAGES))


def stage_of_table(table: str) -> str | None:
    """The name of the stage that a table of a campaign feeds or verifies; None where it is of none."""
    return next((kind.name for kind in kinds() if table in kind.tables or table == kind.verification), None)


def stages_with(effect: Effect) -> tuple[str, ...]:
    """The names of the stages in which an effect acts."""
    return tuple(kind.name for kind in kinds() if kind.has(effect))


def acts_with(effect: Effect, *traits: Trait) -> bool:
    """Whether an effect acts in stages of all these traits."""
    own = [kind for kind in kinds() if kind.has(effect)]
    return all(any(getattr(kind, trait) for kind in own) for trait in traits)


def known_of(stages: Mapping[str, T], trait: Trait) -> T | None:
    """A mapping's value for its first stage with a trait; None where it has no such stage."""
    return next((stages[kind.name] for kind in kinds() if kind.name in stages and getattr(kind, trait)), None)


def only_of(stages: Mapping[str, T], trait: Trait) -> T:
    """The same where the caller knows that there is one.

    Raises
    ------
    KeyError
        There is none.
    """
    found = known_of(stages, trait)
    if found is None:
        raise KeyError(f"expected a stage of the kind {trait}, found {', '.join(stages) or 'none'}")
    return found
