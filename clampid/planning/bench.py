"""Campaigns that have not been measured: planned motion as tables, so that rows are made as for measured ones."""

from __future__ import annotations

from types import MappingProxyType

import pandas as pd

from experiments.campaign import Campaign, Instrument, Tool
from experiments.plans.model import Cell

__all__ = ["imagined"]


def imagined(cell: Cell, **tables: pd.DataFrame) -> Campaign:
    """A campaign of a cell with the given tables, as if it had been read."""
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
