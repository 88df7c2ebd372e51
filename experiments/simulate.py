"""A campaign measured on the virtual robot, as a folder; what was hidden in it goes to a file beside the folder."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Unpack

import numpy as np
import pandas as pd

from experiments.campaign import Campaign, Instrument, Tool, write_campaign
from experiments.outputs import write_text
from experiments.virtual_robot import Hidden, Measured, MeasurementChoice, measure
from kinematics.description import RobotDescription, load_robot

__all__ = ["SimulationError", "declared_campaign", "hidden_file", "measured_campaign", "simulate"]


class SimulationError(ValueError):
    """The virtual robot cannot do what was asked; the message says what it can do."""


def hidden_file(folder: str | Path) -> Path:
    """Where :func:`simulate` tells what it hid: ``FOLDER.hidden.json`` beside the folder."""
    path = Path(folder).resolve()
    return path.with_name(f"{path.name}.hidden.json")


def simulate(
    folder: str | Path,
    robot: str = "kuka_kr20_r1810",
    hidden: Sequence[str | Hidden] = (),
    *,
    file_format: Literal["csv", "parquet"] = "parquet",
    overwrite: bool = False,
    **chosen: Unpack[MeasurementChoice],
) -> Path:
    """Measure a campaign on the virtual robot and write it.

    Parameters
    ----------
    folder
        Where to; new or empty.
    robot
        Name of a bundled robot, or path of a description.
    hidden
        Effects to hide: ``effect``, ``effect@joint3``, ``effect@joint3:2.0``; the number is a factor on the default
        size.
    file_format
        How the tables are stored.
    overwrite
        Replace an existing campaign.
    chosen
        Seed, session, poses, tables, outliers and alter, see :func:`experiments.virtual_robot.measure`.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    SimulationError
        An effect cannot be hidden, or there, or a number is out of range.
    DescriptionError
        There is no such robot.
    CampaignError
        The folder exists and is not empty.
    """
    description = load_robot(robot)
    try:
        asked = [Hidden.parse(item) if isinstance(item, str) else item for item in hidden]
        beyond: Any = dict.fromkeys(("over", "divide", "invalid"), "ignore") if asked else {}  # is refused below
        with np.errstate(**beyond):
            measured = measure(description, asked, **chosen)
    except ValueError as error:
        # The virtual robot imports nothing of ours, and so says every refusal as a plain ValueError.
        raise SimulationError(str(error)) from error
    except RuntimeError as error:  # its equations have no solution
        if not asked:
            raise
        raise SimulationError(f"{_named(asked)}: {error}; expected a smaller magnitude") from error
    if asked:
        _check_finite(measured, asked)
    header = dict(measured.header)
    if Path(robot).suffix:  # a description of the user's own is found by its path only
        header["robot"] = os.path.relpath(Path(robot).resolve(), Path(folder).resolve())
    path = write_campaign(folder, header, measured.tables, file_format, overwrite=overwrite)
    write_text(hidden_file(folder), json.dumps(measured.hidden, indent=1) + "\n")
    return path


def _check_finite(measured: Measured, asked: Sequence[Hidden]) -> None:
    for name, table in measured.tables.items():
        for column in table.select_dtypes("float").columns:
            if not np.isfinite(table[column]).all():
                raise SimulationError(
                    f"{_named(asked)}: expected magnitudes with which the robot still moves, found {name}, column "
                    f"{column}, beyond all numbers"
                )


def _named(asked: Sequence[Hidden]) -> str:
    return ", ".join(f"{item.effect}:{item.magnitude:g}" for item in asked)


def measured_campaign(measured: Measured, robot: RobotDescription, name: str = "virtual") -> Campaign:
    """What the virtual robot measured, as a campaign that never was a folder: for benchmarks, tests and notebooks.

    Parameters
    ----------
    measured
        What :func:`experiments.virtual_robot.measure` gave.
    robot
        The description that the campaign names: that of the robot measured, or another one.
    name
        The campaign's name.

    Returns
    -------
    Campaign
        Without a path; its fingerprint is of no file.
    """
    return declared_campaign(measured.header, measured.tables, robot, name)


def declared_campaign(
    header: Mapping[str, Any], tables: Mapping[str, pd.DataFrame], robot: RobotDescription, name: str = "virtual"
) -> Campaign:
    """Tables of a virtual robot with the content of ``campaign.toml``, as :func:`measured_campaign` gives them."""
    tool, instrument = header["tool"], header["instrument"]
    return Campaign(
        name=name,
        path=None,
        robot=robot,
        gravity=np.array(header["gravity_m_s2"]),
        tool=Tool(tool["mass_kg"], np.array(tool["com_m"])),
        targets={target: np.array(point) for target, point in header["targets_m"].items()},
        instrument=Instrument(
            instrument["name"],
            instrument["position_std_m"],
            instrument.get("orientation_std_rad"),
            distance_std=instrument.get("distance_std_m"),
        ),
        tables=tables,
        fingerprint="0" * 64,
    )
