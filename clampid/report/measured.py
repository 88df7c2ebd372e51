"""What was measured: tables, poses, runs, instrument, temperatures, and the fingerprint of the data."""

from __future__ import annotations

import numpy as np
import pandas as pd

from clampid.display import count_text, counted, number
from clampid.models.model import Model
from clampid.report.style import Section, as_table
from experiments.campaign import Campaign
from experiments.columns import POSES

__all__ = ["measured_section"]

_WHAT = {
    "free_air": "motor torques, arm moving in free air",
    "wrist": "motor torques, only the wrist moving",
    "clamped": "motor torques against motor angles, flange held",
    "poses": "a point of the arm, standing still",
    "distances": "distance from an anchor to a point of the arm, standing still; fitted, not drawn",
    "verification": "as poses; never used in any fit",
}


def measured_section(model: Model, campaign: Campaign) -> Section:
    """Section "What was measured"."""
    rows = [
        (name, _WHAT.get(name, ""), count_text(len(frame)), _units(name, frame), _duration(frame), _temperatures(frame))
        for name, frame in campaign.tables.items()
    ]
    table = as_table(("Table", "What", "Rows#", "Made of", "Duration#", "Temperatures#"), rows)
    instrument = campaign.instrument
    stated = []
    if instrument.position_std is not None:
        stated.append(f"{number(instrument.position_std * 1e6)} µm per axis")
    if instrument.tracker is not None:
        t = instrument.tracker
        stated = [
            f"{number(t.range_std * 1e6)} µm and {number(t.range_rate * 1e6)} µm/m along the beam, "
            f"{number(t.angle_std * 1e6)} µrad in its angles"
        ]
    if instrument.orientation_std is not None:
        stated.append(f"{number(instrument.orientation_std * 1e6)} µrad")
    targets = ", ".join(f"{k} ({', '.join(number(1e3 * float(x)) for x in v)}) mm" for k, v in campaign.targets.items())
    facts = [
        ("Robot", f"{campaign.robot.title} ({campaign.robot.name}), {campaign.robot.n} joints"),
        ("Campaign", campaign.name),
        ("Instrument", f"{instrument.name}; its maker states {' and '.join(stated) or 'no uncertainty'} (1 σ)"),
        ("Tracked points, flange frame", targets or "the flange"),
        ("Tool as declared", f"{number(campaign.tool.mass)} kg" if campaign.tool.mass else "none"),
        ("Gravity, base frame", f"({', '.join(number(float(g)) for g in campaign.gravity)}) m/s²"),
        ("Fingerprint of the data (SHA-256)", campaign.fingerprint),
        (
            "The model was fitted on",
            _fitted_on(model, campaign),
        ),
    ]
    if model.holdout:
        facts.append(
            ("Held out", f"{number(100 * model.holdout)} % of whole poses, runs and sweeps, drawn by the seed")
        )
    return Section("measured", "What was measured", (), (as_table(("", ""), facts), table))


def _fitted_on(model: Model, campaign: Campaign) -> str:
    names = [s.name for s in model.sessions if s.fingerprint != campaign.fingerprint]
    if len(names) < len(model.sessions):
        return " and ".join(["this campaign", *names])
    return (
        f"{', '.join(names)}; not on this campaign, all rows of which are held out; its base was aligned with the poses"
    )


def _units(table: str, frame: pd.DataFrame) -> str:
    if table in POSES:
        poses = frame["pose"].nunique()
        visits = len(frame[["pose", "visit"]].drop_duplicates())
        targets = frame["target"].nunique()
        again = f", {counted(visits - poses, 'return')}" if visits > poses else ", no returns"
        return f"{counted(poses, 'pose')}{again}, {counted(targets, 'target')}"
    if table == "clamped":
        return f"{frame['sweep'].nunique()} sweeps of {frame['joint'].nunique()} joints"
    if "run" not in frame:
        return counted(len(frame), "row")
    runs = frame["run"].nunique()
    return f"{runs} run{'s' if runs != 1 else ''}"


def _duration(frame: pd.DataFrame) -> str:
    step = float(frame["time_s"].max() - frame["time_s"].min())
    if step <= len(frame):  # a clock that counts rows says nothing
        steps = np.diff(frame["time_s"].to_numpy(float))
        if len(steps) and np.allclose(steps, 1.0):
            return "not recorded"
    return f"{number(step / 60.0)} min"


def _temperatures(frame: pd.DataFrame) -> str:
    columns = [c for c in frame.columns if str(c).startswith("temp_")]
    values = frame[columns].to_numpy(float)
    if not columns or not np.isfinite(values).any():
        return "not recorded"
    return f"{np.nanmin(values):.1f} to {np.nanmax(values):.1f} °C"
