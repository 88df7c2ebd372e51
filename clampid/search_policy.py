"""How diagnosis searches for an effect: when it is a candidate, where, instead of what; what parts it from others.

Nothing here changes what an effect does to a measurement: that is :class:`clampid.effect.Effect`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from clampid.signals import Stage

__all__ = ["JOINT_ANGLE_PERIODIC", "PROBES", "JointKind", "Scope", "Search", "Separator"]

JointKind = Literal["revolute", "prismatic", "helical"]
Scope = Literal["places", "together", "both", "jointly"]

JOINT_ANGLE_PERIODIC = "joint_angle_periodic"
"""Name of the probe that reveals effects of any periodic shape."""
PROBES: tuple[str, ...] = (JOINT_ANGLE_PERIODIC,)
"""The probes that an effect may wait for (``revealed_by``)."""


@dataclass(frozen=True)
class Separator:
    """What separates an effect from those of another family, where the same rows cannot distinguish the two.

    Attributes
    ----------
    family
        The other family.
    measurement
        What to measure next, in words.
    same_stage
        Whether it is more of the same measurement: the rows say then whether it suffices.
    """

    family: str
    measurement: str
    same_stage: bool = False


@dataclass(frozen=True)
class Search:
    """When and how diagnosis looks for an effect. The defaults: always, at each place and at all places at once.

    Attributes
    ----------
    scope
        Place by place (``places``), at all places at once (``together``), or ``both``; ``jointly``: at all places at
        once, after which each place must pay for itself.
    refines
        An effect that this one refines: diagnosis looks for it only where that one is active.
    superseded_by
        A recorded signal that shows the same better: diagnosis looks for it only at places that have none of it, until
        an effect of that signal is in the model.
    revealed_by
        A probe, one of :data:`PROBES`, that must have fired before diagnosis looks for it: so many parameters cost as
        much time as the rest of the catalogue, and the probe asks the same question of the same rows.
    opt_in
        Whether it is fitted only where somebody asks for it: diagnosis does not look for it.
    joint_kind
        The kind of joint at which alone diagnosis looks for it; None: any.
    symptom_of
        Effects whose outcome it states without a cause: where one of these leaves no larger error, it is that one.
    differs_from
        A stage that has the same quantity too, if the effect states by how much that is another one here: diagnosis
        looks for it only where that stage was measured.
    shown_by
        The stage that shows it directly: in another one diagnosis looks for it only if that stage has shown it. For an
        empirical form, which could stand for anything elsewhere.
    separators
        What separates it from effects of other families.
    """

    scope: Scope = "both"
    refines: str | None = None
    superseded_by: str | None = None
    revealed_by: str | None = None
    opt_in: bool = False
    joint_kind: JointKind | None = None
    symptom_of: tuple[str, ...] = ()
    differs_from: Stage | None = None
    shown_by: Stage | None = None
    separators: tuple[Separator, ...] = ()

    def __post_init__(self) -> None:
        if self.revealed_by not in (None, *PROBES):
            raise ValueError(f"probe {self.revealed_by!r} does not exist; known: {', '.join(PROBES)}")
