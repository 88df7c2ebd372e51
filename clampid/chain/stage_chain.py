"""What the chain has to know of a stage: which stations its measurement sees, and what the joints bear meanwhile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from clampid.effect import Effect

__all__ = ["Loads", "StageChain"]

Loads = Literal["moving", "equilibrium", "rest"]
"""Where joint torques come from: an arm in motion (its weight and other loads, none of them friction), an arm clamped
at both ends (the solution of an equilibrium, given to the chain as a signal), an arm at rest (its weight where it
stands, with friction that holds against it and decides on which flank each gear rests)."""


@dataclass(frozen=True, kw_only=True)
class StageChain:
    """One stage as the chain sees it.

    Attributes
    ----------
    name
        As models, effects and command lines name it.
    outputs
        The stations whose deviations its measurement sees, in the order of the chain's outputs.
    loads
        See :data:`Loads`.
    effects_of
        Another stage, if those effects of it act here, too, of which these outputs see all that they do; else "".
    """

    name: str
    outputs: tuple[str, ...]
    loads: Loads
    effects_of: str = ""

    @property
    def solved(self) -> bool:
        """Whether the joint torques are unknown of an equilibrium."""
        return self.loads == "equilibrium"

    @property
    def moving(self) -> bool:
        """Whether rows are of an arm in motion, sampled one after the other."""
        return self.loads == "moving"

    @property
    def resting(self) -> bool:
        """Whether rows are of an arm at rest, so that its loads and flanks follow the parameters."""
        return self.loads == "rest"

    def has(self, effect: Effect) -> bool:
        """Whether an effect acts in this stage."""
        if self.name in effect.stages:
            return True
        return self.effects_of in effect.stages and all(station in self.outputs for station in effect.acts)
