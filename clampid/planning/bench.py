"""Imagined campaigns: planned motion as tables of a campaign, so that its rows are made as those of measured ones."""

from __future__ import annotations

from types import MappingProxyType

import pandas as pd

from experiments.campaign import Campaign, Instrument, Tool
from experiments.plans.model import Cell

__all__ = ["imagined"]


def imagined(cell: Cell, **tables: pd.DataFrame) -> Campaign:
    """A campaign of a cell with the given tables (name → table), as if it had been read from a folder."""
    return Campaign(
        name="plan",
        path=None,
        robot=cell.robot,
        gravity=cell.gravity,
        tool=Tool(cell.tool_mass, cell.tool_com),
        targets=MappingProxyType(dict(cell.targets)),
        instrument=Instrument(cell.instrument, cell.position_std, None),
        tables=MappingProxyType(tables),
        fingerprint="",
    )
