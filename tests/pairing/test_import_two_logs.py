"""``clampid import`` with ``[pairing]``: from two raw logs to a campaign."""

from __future__ import annotations

import json
from pathlib import Path

import log_maker
import numpy as np
import pandas as pd
import pytest
import typer
from click.testing import Result
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from clampid.verbs.import_table import import_table
from experiments import campaign
from experiments.pairing import rigid_residuals
from kinematics import forward, load_robot

MAPPING = """
format = "clampid-mapping/1"
units = {angle = "deg", length = "mm"}
table = "poses"
[columns]
time = {from = "t", unit = "s"}
x = {from = "X"}
y = {from = "Y"}
z = {from = "Z"}
q1 = {from = "A1"}
q2 = {from = "A2"}
q3 = {from = "A3"}
q4 = {from = "A4"}
q5 = {from = "A5"}
q6 = {from = "A6"}
target = {value = "T1"}
[pairing]
time = {from = "t", unit = "ms"}
[campaign]
robot = "kuka_kr20_r1810"
gravity_m_s2 = [0.0, 0.0, -9.81]
tool = {mass_kg = 12.0, com_m = [0.0, 0.0, 0.08]}
targets_m = {T1 = [0.10, 0.00, 0.12]}
instrument = {name = "laser tracker", position_std_m = 2e-5}
"""


def call(*arguments: object) -> Result:
    app = typer.Typer()
    app.command()(import_table)
    return CliRunner().invoke(app, [*map(str, arguments), "--quiet"])


def tracked(q: np.ndarray) -> np.ndarray:
    """Target T1 of the arm in a tracker's frame, on a few thousand knots of each motion."""
    robot = load_robot("kuka_kr20_r1810")
    poses = forward(robot.screws, robot.flange, q @ robot.linkage.T)
    turn = Rotation.from_euler("xyz", [0.1, -0.2, 2.0]).as_matrix()
    return (poses[:, :3, :3] @ [0.101, -0.002, 0.12] + poses[:, :3, 3]) @ turn.T + [3.0, 1.0, 0.5]


@pytest.fixture(scope="module")
def logs() -> log_maker.Logs:
    return log_maker.make_logs(5, poses=30, rate=100.0, point=tracked)


@pytest.fixture
def files(logs: log_maker.Logs, tmp_path: Path) -> tuple[Path, Path, Path]:
    instrument, robot, mapping = tmp_path / "tracker.csv", tmp_path / "robot.csv", tmp_path / "mapping.toml"
    pd.DataFrame(np.c_[logs.time, 1e3 * logs.points], columns=["t", "X", "Y", "Z"]).to_csv(instrument, index=False)
    names = ["t", *(f"A{i}" for i in range(1, 7))]
    pd.DataFrame(np.c_[1e3 * logs.robot_time, np.rad2deg(logs.joints)], columns=names).to_csv(robot, index=False)
    mapping.write_text(MAPPING)
    return mapping, instrument, robot


def test_campaign_from_two_logs(logs: log_maker.Logs, files: tuple[Path, Path, Path], tmp_path: Path) -> None:
    folder, result = tmp_path / "arm", tmp_path / "result.json"
    done = call(*files, "-o", folder, "--json", result)
    assert done.exit_code == 0, done.output + repr(done.exception)
    assert len(done.stdout.splitlines()) <= 24
    frame = campaign.read_campaign(folder).tables["poses"]
    said = json.loads(result.read_text())["tables"]["poses"]["pairing"]
    assert said["pairs"] == len(frame) >= int(logs.seen.sum())
    assert said["geometry_rms_m"] < 1e-4
    for row in frame.itertuples():
        (k,) = np.flatnonzero((logs.stops[:, 0] <= row.time_s) & (row.time_s <= logs.stops[:, 1]))
        assert [row.x_m, row.y_m, row.z_m] == pytest.approx(logs.true_points[k], abs=2e-5)
        assert [row.q1_rad, row.q6_rad] == pytest.approx(logs.postures[k][[0, 5]], abs=1e-5)
    # Where each joint came from is the sign of its last step of more than a milliradian.
    first, second = frame.iloc[0], frame.iloc[1]
    for i in range(1, 7):
        step = second[f"q{i}_rad"] - first[f"q{i}_rad"]
        if abs(step) > 0.1 and said["pairs"] == len(logs.stops):
            assert second[f"dir{i}"] == np.sign(step)
    assert not frame.duplicated(["pose", "visit"]).any()


@pytest.mark.parametrize(
    ("which", "row", "column", "text", "words"),
    [
        (1, 1000, "Y", "n/a", "tracker.csv, row 1001 (line 1002), column Y: expected a number, found 'n/a'"),
        (2, 50, "A3", "", "robot.csv, row 51 (line 52), column A3: expected a number, found an empty cell"),
        (2, 50, "t", "0", "robot.csv, row 51 (line 52), column t: expected a later time than before"),
    ],
)
def test_bad_cells_are_named(files: tuple[Path, Path, Path], tmp_path: Path, which, row, column, text, words) -> None:
    table = pd.read_csv(files[which], dtype=str)
    if which == 2 and column == "t":
        text = str(float(table.loc[row - 1, "t"]) - 1)
    table.loc[row, column] = text
    table.to_csv(files[which], index=False)
    done = call(*files, "-o", tmp_path / "arm")
    assert words in str(done.exception)
    assert "\n" not in str(done.exception)
    assert not (tmp_path / "arm").exists()


def test_logs_of_two_days_do_not_pair(files: tuple[Path, Path, Path], tmp_path: Path) -> None:
    other = log_maker.make_logs(6, poses=30, rate=100.0)
    names = ["t", *(f"A{i}" for i in range(1, 7))]
    pd.DataFrame(np.c_[1e3 * other.robot_time, np.rad2deg(other.joints)], columns=names).to_csv(files[2], index=False)
    done = call(*files, "-o", tmp_path / "arm")
    assert done.exit_code != 0
    assert "robot.csv: expected" in str(done.exception)


def test_geometry_finds_the_false_pair() -> None:
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.5, 1.5, size=(40, 6))
    robot = load_robot("kuka_kr20_r1810")
    points = tracked(q) + 1e-4 * rng.standard_normal((40, 3))
    points[7] += [0.0, 0.03, 0.0]
    off = rigid_residuals(points, forward(robot.screws, robot.flange, q @ robot.linkage.T))
    assert int(np.argmax(off)) == 7
    assert off[7] > 0.02
    assert np.delete(off, 7).max() < 1e-3
