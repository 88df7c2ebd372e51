"""Campaign folders, read, checked and written: the measurements of one robot in one session.

The contract is ``CAMPAIGN_FORMAT.md``. A folder that follows it is read; one that does not raises `CampaignError`,
which names the file, the row and column, what was expected and what was found. What is allowed but improbable
(degrees for radians, a joint that never moves) is for `experiments.checks.check`.
"""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from experiments.columns import LOGS, TABLES, lookalike, table_format, temperature_columns
from experiments.errors import CampaignError, fault
from experiments.fingerprint import fingerprint
from experiments.header import FORMAT, HEADER_FILE, Header, Instrument, Tool, read_header
from experiments.long_log import LongLog, is_long, read_long
from experiments.outputs import new_folder
from experiments.sensors import placed
from experiments.stated import Stated
from experiments.tables import TableFile, read_table
from experiments.targets import check_folder, protect
from experiments.toml_text import toml_text
from experiments.validate import validate_table
from kinematics.description import RobotDescription

__all__ = ["Campaign", "CampaignError", "Instrument", "Tool", "read_campaign", "target_points", "write_campaign"]

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Campaign:
    """One campaign, read and checked; treat its tables as read-only.

    Attributes
    ----------
    name
        The folder's name.
    path
        The folder, or None if the campaign never was one.
    robot
        The nominal robot.
    gravity
        Gravity in the robot base frame [m/s²], shape (3,).
    tool
        What the controller was told of the tool; massless where the campaign does not say.
    targets
        Nominal tracked points in the flange frame [m], shape (3,) each; may be empty.
    instrument
        The measuring instrument as stated.
    tables
        The tables present, with the contract's column names, in SI units; extra columns are kept.
    fingerprint
        SHA-256 of header and tables; the same for CSV and Parquet with equal numbers.
    header
        ``campaign.toml`` as it was read.
    long
        Torque logs that are not held; ``tables`` has extracts of them.
    stated
        What is known beforehand of base, targets and sensors.
    """

    name: str
    path: Path | None
    robot: RobotDescription
    gravity: FloatArray
    tool: Tool
    targets: Mapping[str, FloatArray]
    instrument: Instrument
    tables: Mapping[str, pd.DataFrame]
    fingerprint: str
    header: Mapping[str, Any] = field(default_factory=dict)
    long: Mapping[str, LongLog] = field(default_factory=dict)
    stated: Stated = field(default_factory=Stated)

    def __repr__(self) -> str:
        tables = ", ".join(f"{name} ({len(table)} rows)" for name, table in self.tables.items())
        return f"<Campaign: {self.name} of {self.robot.name}; {tables or 'no tables'}>"

    def placed(self, table: str) -> pd.DataFrame:
        """The table with its temperatures where ``[sensors]`` says that they were taken."""
        return placed(self.tables[table], self.stated.sensors)

    @property
    def robot_file(self) -> str | None:
        """Where the robot's description is, if it is none of the bundled ones."""
        named = str(self.header.get("robot", ""))
        if self.path is None or Path(named).suffix.lower() not in (".toml", ".urdf"):
            return None
        return str((self.path / named).resolve())


def read_campaign(folder: str | Path, *, rows_in_memory: float = inf) -> Campaign:
    """Read a campaign folder and check it against the format.

    Parameters
    ----------
    folder
        The folder with ``campaign.toml``.
    rows_in_memory
        How many rows of a torque log may be held. Of a Parquet file with more of them, every row is checked all the
        same, but ``tables`` has an extract only, and ``long`` the file.

    Returns
    -------
    Campaign
        With every table that ``[tables]`` names.

    Raises
    ------
    CampaignError
        If anything deviates from the contract; the message names file, row, column, what was expected and found.
    """
    path = Path(folder)
    header = read_header(path)
    protect(path / HEADER_FILE)
    tables: dict[str, pd.DataFrame] = {}
    long: dict[str, LongLog] = {}
    for name in TABLES:
        if name in header.tables:
            source = TableFile(path / header.tables[name])
            protect(source.path)
            layout = table_format(name, header.robot.n)
            behind_gears = name in header.at_joints
            if name in LOGS and not behind_gears and is_long(source.path, rows_in_memory):
                long[name], tables[name] = read_long(source.path, layout, header.robot.n)
                continue
            frame = validate_table(read_table(source.path), layout, source, header.targets)
            tables[name] = _at_motors(frame, np.asarray(header.robot.transmission)) if behind_gears else frame
    _refuse_absent_sensors(header, tables, path)
    hashed: dict[str, pd.DataFrame | Path] = {**tables, **{name: path / header.tables[name] for name in long}}
    campaign = Campaign(
        name=path.resolve().name,
        path=path,
        robot=header.robot,
        gravity=header.gravity,
        tool=header.tool,
        targets=header.targets,
        instrument=header.instrument,
        tables=MappingProxyType(tables),
        fingerprint=fingerprint(header.raw, hashed),
        header=header.raw,
        long=MappingProxyType(long),
        stated=header.stated,
    )
    protect(campaign.robot_file)
    return campaign


def _at_motors(frame: pd.DataFrame, transmission: FloatArray) -> pd.DataFrame:
    """A log whose torques were measured behind the gears, with those that the motors then have: T tau.

    Friction between motor and sensor is not in them. Friction behind the sensor reaches the motors through T, as
    arm-side friction does.
    """
    names = [f"tau{i + 1}_Nm" for i in range(len(transmission))]
    return frame.assign(**dict(zip(names, (frame[names].to_numpy(np.float64) @ transmission.T).T, strict=True)))


def _refuse_absent_sensors(header: Header, tables: Mapping[str, pd.DataFrame], path: Path) -> None:
    """A sensor that no table has would be ignored without a message."""
    columns = dict.fromkeys(name for frame in tables.values() for name in temperature_columns(map(str, frame.columns)))
    for name in header.stated.sensors:
        if f"temp_{name}_C" not in columns:
            near = lookalike(f"temp_{name}_C", list(columns))
            found = f"none; the tables have {', '.join(columns) or 'no temperatures'}"
            found += f"; did you mean {near}?" if near else ""
            raise fault(
                path / HEADER_FILE, expected=f"a table with a column temp_{name}_C", found=found,
                column=f"sensors.{name}",
            )  # fmt: skip


def target_points(campaign: Campaign, table: str) -> FloatArray:
    """Nominal tracked point of each row of ``poses`` or ``verification``.

    Parameters
    ----------
    campaign
        The campaign.
    table
        ``"poses"``, ``"distances"`` or ``"verification"``.

    Returns
    -------
    ndarray, shape (rows, 3)
        In the flange frame [m]; zero where the flange itself was measured.
    """
    known = {"flange": np.zeros(3), **campaign.targets}
    return np.stack([known[str(name)] for name in campaign.tables[table]["target"]])


def write_campaign(
    folder: str | Path,
    header: Mapping[str, Any],
    tables: Mapping[str, pd.DataFrame],
    file_format: Literal["csv", "parquet"] = "parquet",
    *,
    overwrite: bool = False,
) -> Path:
    """Write a campaign folder, whole or not at all.

    Everything goes to a hidden folder beside it, which is then renamed. CSV keeps every digit of a float64. The values
    are not judged here, so that a long measurement can always be saved; `read_campaign` judges them.

    Parameters
    ----------
    folder
        Where to; its parents are created.
    header
        Content of ``campaign.toml``; ``format`` and ``[tables]`` are filled in.
    tables
        The tables by name, with the contract's columns; the index is not written.
    file_format
        How the tables are stored.
    overwrite
        Replace an existing campaign folder; files in it that are not part of the campaign are kept.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    CampaignError
        If a table's name or the format is unknown, there is no table, or the folder exists, is not empty, and is not a
        campaign folder that may be overwritten.
    """
    path = Path(folder).resolve()  # "." has no name to rename to
    if file_format not in ("csv", "parquet"):
        raise CampaignError(f"{path}: expected the file format csv or parquet, found {file_format!r}")
    unknown = [name for name in tables if name not in TABLES]
    if unknown or not tables:
        found = ", ".join(map(repr, unknown)) or "none"
        raise CampaignError(f"{path}: expected tables among {', '.join(TABLES)}, found {found}")
    _refuse_overwriting(path, overwrite)
    files = {name: f"{name}.{file_format}" for name in TABLES if name in tables}
    content = {"format": FORMAT, **{k: v for k, v in header.items() if k not in ("format", "tables")}, "tables": files}
    text = toml_text(content)
    check_folder(path)
    with new_folder(path) as partial:
        for name, file in files.items():
            _write_table(tables[name], partial / file)
        (partial / HEADER_FILE).write_text(text, encoding="utf-8")
        _keep_others(path, partial)
    return Path(folder)


def _write_table(frame: pd.DataFrame, file: Path) -> None:
    if file.suffix == ".parquet":
        frame.to_parquet(file, index=False)
    else:
        # pandas prints a float with as many digits as it takes to read the same float64 back.
        frame.to_csv(file, index=False, lineterminator="\n", encoding="utf-8")


def _refuse_overwriting(path: Path, overwrite: bool) -> None:
    if path.exists() and not path.is_dir():
        raise fault(path, expected="a folder to write to", found="a file")
    if not path.exists() or not any(path.iterdir()):
        return
    if not (path / HEADER_FILE).is_file():
        raise fault(path, expected="a new or empty folder", found="files that are not a campaign")
    if not overwrite:
        raise fault(path, expected="a new or empty folder", found="a campaign (overwrite=True replaces it)")


def _keep_others(path: Path, partial: Path) -> None:
    """Take along what an older folder holds beside its campaign."""
    for item in path.iterdir() if path.exists() else ():
        if item.name not in _campaign_files(path) and not (partial / item.name).exists():
            copy = shutil.copytree if item.is_dir() else shutil.copy2
            copy(item, partial / item.name)


def _campaign_files(path: Path) -> set[str]:
    try:
        tables = tomllib.loads((path / HEADER_FILE).read_text(encoding="utf-8")).get("tables", {})
        return {HEADER_FILE, *(str(file) for file in tables.values())}
    except (OSError, ValueError, AttributeError):
        # A damaged header does not say which tables are its own; those with the usual names are.
        return {HEADER_FILE, *(f"{table}.{ending}" for table in TABLES for ending in ("csv", "parquet"))}
