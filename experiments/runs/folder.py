"""From journals to the campaign folder: checked, and written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.campaign import Campaign, read_campaign, write_campaign
from experiments.header import HEADER_FILE
from experiments.outputs import scratch_folder, write_bytes
from experiments.plans.errors import PlanError
from experiments.plans.model import Cell, Plan, table_of
from experiments.targets import check_folder
from kinematics.reading import read_text, toml_of

__all__ = ["JOURNALS", "check_folder_for", "convert", "header_of", "is_in", "tables_of", "work_folder"]

JOURNALS = "journals"
"""Folder in the campaign where the journals of its finished runs stay."""


def work_folder(folder: str | Path) -> Path:
    """Where plan and journal of a run that is not finished lie: beside the campaign."""
    path = Path(folder).resolve()
    return path.with_name(f".{path.name}.run")


def tables_of(entries: Iterable[Mapping[str, Any]]) -> dict[str, pd.DataFrame]:
    """The tables of a journal, without entries that were declared void.

    Raises
    ------
    PlanError
        An entry is none that a run writes.
    """
    try:
        return _tables_of(entries)
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        why = f"{type(error).__name__}: {error}"
        raise PlanError(f"journal: expected entries that a run wrote, found another: {why[:200]}") from error


def _tables_of(entries: Iterable[Mapping[str, Any]]) -> dict[str, pd.DataFrame]:
    rows: dict[str, list[dict[str, Any]]] = {}
    logs: dict[str, list[pd.DataFrame]] = {}
    for entry in entries:
        if entry["what"] == "row":
            rows.setdefault(entry["table"], []).append(dict(entry["row"]))
        elif entry["what"] == "void":
            kept = rows.get(entry["table"], [])
            rows[entry["table"]] = [row for row in kept if row["sweep"] not in entry["sweeps"]]
        elif entry["what"] == "log" and entry["columns"]["time_s"]:
            logs.setdefault(entry["table"], []).append(pd.DataFrame(entry["columns"]))
    tables = {name: pd.DataFrame(found) for name, found in rows.items() if found}
    if "clamped" in tables:  # a sweep that was repeated stands where its number says
        tables["clamped"] = tables["clamped"].sort_values("sweep", kind="stable", ignore_index=True)
    # A sensor with a missing reading gets no column.
    tables = {name: frame.dropna(axis=1) for name, frame in tables.items()}
    return tables | {name: pd.concat(parts, ignore_index=True) for name, parts in logs.items()}


def header_of(cell: Cell, target: Path) -> dict[str, Any]:
    """``campaign.toml`` of a cell; a robot's own description is named relative to the folder."""
    reference = cell.reference
    if Path(reference).suffix:
        reference = os.path.relpath(Path(reference).resolve(), target.resolve())
    return {
        "robot": reference,
        "gravity_m_s2": np.asarray(cell.gravity).tolist(),
        "tool": {"mass_kg": cell.tool_mass, "com_m": np.asarray(cell.tool_com).tolist()},
        "targets_m": {name: np.asarray(point).tolist() for name, point in cell.targets.items()},
        "instrument": {"name": cell.instrument, "position_std_m": cell.position_std},
    }


def check_folder_for(plan: Plan, folder: Path) -> Campaign | None:
    """The campaign that is there already, if the plan's tables can be added to it.

    Raises
    ------
    PlanError
        Something else is there, it is of another cell, or it has a table of this plan.
    OutputError
        A folder cannot be written or replaced there.
    """
    check_folder(folder)
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return None
    if not (folder / HEADER_FILE).is_file():
        raise PlanError(f"{folder}: expected a new or empty folder, or a campaign, found something else")
    try:
        header = toml_of(read_text(folder / HEADER_FILE))
    except (OSError, ValueError) as error:  # TOML that is none, or bytes that are no UTF-8, are ValueErrors
        raise PlanError(f"{folder / HEADER_FILE}: expected a campaign's TOML, found none: {error}") from None
    for key, wanted in header_of(plan.cell, folder).items():
        if key in header and header[key] != wanted:
            raise PlanError(f"{folder}: expected a campaign of the plan's cell: {key} {wanted}, found {header[key]}")
    campaign = read_campaign(folder)
    for name in (*table_of(plan.kind), *(("distances",) if plan.kind == "poses" else ())):
        if name in campaign.tables:
            raise PlanError(f"{folder}: expected no table {name} yet, found one; run this plan to another folder")
    return campaign


def convert(plan: Plan, entries: Iterable[Mapping[str, Any]], folder: Path, *, journal: Path) -> Path:
    """Add a journal's tables to a campaign folder, new or not.

    The folder is first written beside its place and read back as any campaign is; only then does it take its place.

    Raises
    ------
    PlanError
        There are no rows, or another table is there.
    CampaignError
        The records are no valid campaign: the journal stays where it is.
    """
    before = check_folder_for(plan, folder)
    new = tables_of(entries)
    if not new:
        raise PlanError(f"{journal}: expected rows, found none")
    tables = {} if before is None else dict(before.tables)
    header = header_of(plan.cell, folder)
    if before is not None:
        header = {k: v for k, v in before.header.items() if k not in ("format", "tables")}
    folder.parent.mkdir(parents=True, exist_ok=True)
    with scratch_folder(folder.parent, f".{folder.name}.check") as scratch:
        trial = write_campaign(scratch / folder.name, header_of(plan.cell, scratch / folder.name), new, "csv")
        read_campaign(trial)
    write_campaign(folder, header, tables | new, "csv", overwrite=before is not None)
    journals = folder / JOURNALS
    journals.mkdir(exist_ok=True)
    number = 1 + sum(1 for _ in journals.glob(f"{plan.kind}-*.jsonl"))
    for source in (journal, *sorted(journal.parent.glob("plan*.toml"))):
        name = f"{plan.kind}-{number}{source.stem.removeprefix('plan').removeprefix('journal')}{source.suffix}"
        write_bytes(journals / name, source.read_bytes())
    return folder


def is_in(entries: Iterable[Mapping[str, Any]], folder: Path) -> bool:
    """Whether the folder holds a journal's tables already: the run was killed between writing it and tidying up."""
    if not (folder / HEADER_FILE).is_file():
        return False
    tables = read_campaign(folder).tables
    new = tables_of(entries)
    return bool(new) and all(
        name in tables and len(tables[name]) == len(frame) and np.array_equal(tables[name]["time_s"], frame["time_s"])
        for name, frame in new.items()
    )
