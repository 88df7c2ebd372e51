"""The virtual worlds in which the benchmark of hidden effects hides something, each with its cases."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from hidden_cases import FAMILIES, OUTSIDE, SEVERAL, Bench, Case
from hidden_second import SECOND_FAMILIES, SECOND_OUTSIDE, SecondBench

from experiments.campaign import Campaign

__all__ = ["WORLDS", "World"]


class AnyBench(Protocol):
    """A robot of some world, and how large effects of some magnitude are on it."""

    setup: Mapping[str, str]

    @property
    def present(self) -> frozenset[str]:
        """Effects that it has without being asked, beyond the start model."""

    def places(self) -> list[str]:
        """Where each hidden effect sits; empty where it sits everywhere."""

    def depends_on(self) -> tuple[str, ...]:
        """The variables that what was hidden depends on."""

    def magnitude(self, name: str, size: float) -> tuple[float, float]:
        """The magnitude that has a size, and the size that it has."""

    def campaign(self, magnitudes: Sequence[float]) -> Campaign:
        """A campaign on the robot with the case's effects in it; all tables where the case has none."""


@dataclass(frozen=True)
class World:
    """A world: its cases by kind, and how one of its robots is set up.

    Attributes
    ----------
    bench
        Of a case, a seed, a number of poses (where the world's programs leave it open) and a folder.
    """

    name: str
    cases: Mapping[str, tuple[Case, ...]]
    bench: Callable[[Case, int, int, Path], AnyBench]


WORLDS: Mapping[str, World] = {
    w.name: w
    for w in (
        World("first", {"single": FAMILIES, "outside": OUTSIDE, "several": SEVERAL}, Bench),
        World("second", {"single": SECOND_FAMILIES, "outside": SECOND_OUTSIDE}, SecondBench),
    )
}
