"""A chart: panels beside and below each other, and the chart itself as SVG for a notebook."""

from __future__ import annotations

from dataclasses import dataclass, field

from clampid.charts.marks import Mark, Panel
from clampid.charts.svg import standalone

__all__ = ["Chart"]


@dataclass(frozen=True)
class Chart:
    """Panels, row by row.

    Attributes
    ----------
    across
        Panels in a row; 0 is three at most.
    height
        Of the whole, for a width of 1080.
    heights
        Of the rows, relative to each other; empty is all alike.
    left
        Room for the texts left of each row.
    below
        A title of the x axis under all panels.
    """

    panels: tuple[Panel, ...]
    height: float = 420
    across: int = 0
    heights: tuple[float, ...] = field(default=())
    left: float = 64
    below: str = ""

    @property
    def columns(self) -> int:
        """Panels in a row."""
        return self.across or min(3, max(1, len(self.panels)))

    def named(self, name: str) -> list[Mark]:
        """The marks of a name in all panels."""
        return [m for panel in self.panels for m in panel.named(name)]

    def _repr_svg_(self) -> str:
        """Itself, for a notebook."""
        return standalone(self)
