"""Writes a campaign folder as CAMPAIGN_FORMAT.md says, and beside it the file that tells what was hidden."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.second_world.arrays import Array, exp_so3, rpy_of, rpy_rotation
from experiments.second_world.individual import Robot
from experiments.second_world.session import Session
from experiments.second_world.urdf_text import urdf_text

__all__ = ["base_section", "hidden_file", "write_campaign", "write_truth"]

_BASE_STD_M, _BASE_STD_RAD = 2e-4, 1e-4


def _list(values: Array) -> str:
    return "[" + ", ".join(f"{v:.9g}" if "." in f"{v:.9g}" or "e" in f"{v:.9g}" else f"{v:.1f}" for v in values) + "]"


def base_section(session: Session, rng: np.random.Generator) -> str:
    """
    State where the base stands, as well as somebody measured it.

    The base is the one of the description, whose first joint stands where the robot's own does: a base plate off which
    that joint is by the tolerance of its making would be known less well than is stated.
    """
    seen, (nominal, built) = session.instrument, (a.joints[0] for a in (session.robot.nominal, session.robot.arm))
    turn = rpy_rotation(built.rpy_rad) @ rpy_rotation(nominal.rpy_rad).T
    shift = built.xyz_m - turn @ nominal.xyz_m
    R = seen.rotation @ turn @ exp_so3(_BASE_STD_RAD * rng.standard_normal(3))
    position = seen.position_m + seen.rotation @ shift + _BASE_STD_M * rng.standard_normal(3)
    return (
        f"\n[base]\nposition_m = {_list(position)}\nrpy_rad = {_list(rpy_of(R))}\n"
        f"position_std_m = {_BASE_STD_M}\nrpy_std_rad = {_BASE_STD_RAD}\n"
    )


def _campaign_toml(robot: Robot, session: Session, tables: Sequence[str], base: str) -> str:
    tool = robot.declared_tool
    targets = robot.nominal_targets_m[: session.poses.targets]
    lines = [
        'format = "clampid-campaign/1"',
        'robot = "robot.urdf"',
        f"gravity_m_s2 = {_list(robot.gravity_m_s2)}",
        "",
        "[tool]",
        f"mass_kg = {tool.mass_kg:.6g}",
        f"com_m = {_list(tool.com_m)}",
    ]
    if "poses" in tables:
        lines += ["", "[targets_m]", *(f"T{k} = {_list(t)}" for k, t in enumerate(targets, start=1))]
        stated = session.instrument.stated_std_m
        lines += ["", "[instrument]", f'name = "{session.instrument.name}"', f"position_std_m = {stated}"]
    lines += ["", "[tables]", *(f'{t} = "{t}.csv"' for t in tables), ""]
    return "\n".join(lines) + base


def hidden_file(folder: Path) -> Path:
    """Path beside a campaign folder of the file that tells what was hidden."""
    return folder.with_name(folder.name + ".hidden.json")


def write_campaign(
    folder: Path, robot: Robot, session: Session, tables: Mapping[str, pd.DataFrame], base: str = ""
) -> None:
    """
    Write a campaign folder.

    Parameters
    ----------
    folder
        Made if it does not exist.
    robot, session
        Whose nominal description, declared tool, nominal targets and stated noise go into it.
    tables
        Tables by name.
    base
        Text of the section `[base]`, where the base is known.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text(urdf_text(robot.nominal, robot.stated_friction), encoding="utf-8")
    (folder / "campaign.toml").write_text(_campaign_toml(robot, session, list(tables), base), encoding="utf-8")
    for name, table in tables.items():
        table.to_csv(folder / f"{name}.csv", index=False, float_format="%.10g", lineterminator="\n")


def write_truth(path: Path, hidden: Sequence[Mapping[str, object]]) -> None:
    """Write what was hidden as JSON."""
    path.write_text(json.dumps(list(hidden), indent=1) + "\n", encoding="utf-8")
