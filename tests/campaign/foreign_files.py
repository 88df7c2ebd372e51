"""Mappings of foreign files, and the campaigns that `clampid import` makes of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from import_call import call

from experiments.campaign import Campaign, read_campaign

__all__ = ["ANGLES", "CAMPAIGN", "HEAD", "JOINTS", "PLACE", "POINT", "XYZ", "agree", "imported", "refused"]

ANGLES = [f"q{i + 1}_rad" for i in range(6)]
XYZ = ["x_m", "y_m", "z_m"]
HEAD = """format = "clampid-mapping/1"
units = {angle = "deg", length = "mm", temperature = "degC", time = "s", torque = "Nm"}
"""
CAMPAIGN = """
[campaign]
robot = "kuka_kr20_r1810"
gravity_m_s2 = [0.0, 0.0, -9.81]
tool = {mass_kg = 12.0, com_m = [0.0, 0.0, 0.08]}
targets_m = {T1 = [0.10, 0.00, 0.12], T2 = [-0.05, 0.0866, 0.12], T3 = [-0.05, -0.0866, 0.12]}
instrument = {name = "tracker", position_std_m = 5e-5}
"""
JOINTS = "\n".join(f'q{i + 1} = {{from = "A{i + 1}"}}' for i in range(6)) + "\n"
POINT = 'pose = {from = "Point"}\ntarget = {from = "SMR"}\n'
PLACE = 'x = {from = "X"}\ny = {from = "Y"}\nz = {from = "Z"}\n'


def imported(folder: Path, mapping: str, *files: Path) -> Campaign:
    (folder / "m.toml").write_text(mapping, encoding="utf-8")
    ran = call(folder / "m.toml", *files, "-o", folder / "arm")
    assert ran.exit_code == 0, (ran.output, ran.exception)
    return read_campaign(folder / "arm")


def refused(folder: Path, mapping: str, *files: Path) -> str:
    (folder / "m.toml").write_text(mapping, encoding="utf-8")
    ran = call(folder / "m.toml", *files, "-o", folder / "arm")
    assert ran.exception is not None
    assert not (folder / "arm").exists()
    return str(ran.exception)


def agree(found: Campaign, points: pd.DataFrame, table: str = "poses") -> pd.DataFrame:
    frame = found.tables[table]
    assert len(frame) == len(points)
    np.testing.assert_allclose(frame[ANGLES], np.deg2rad(points[[f"A{i + 1}" for i in range(6)]]), atol=1e-9)
    np.testing.assert_allclose(frame[XYZ], points[["X", "Y", "Z"]] / 1e3, atol=1e-9)
    assert list(frame["target"]) == list(points["SMR"])
    assert list(frame["pose"]) == list(pd.factorize(points["Point"])[0] + 1)
    return frame
