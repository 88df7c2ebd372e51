"""``clampid base`` as a user calls it, on circles that a rigid nominal robot traces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cli_runner import Clampid

from experiments.campaign import write_campaign
from kinematics.description import load_robot
from kinematics.poe import forward
from kinematics.screws import exp_se3

WHERE = exp_se3(np.array([0.3, -0.2, 1.9, 2.0, -1.0, 0.4]))
TARGET = [0.1, 0.0, 0.12]


@pytest.fixture(scope="module")
def circles(tmp_path_factory: pytest.TempPathFactory) -> Path:
    robot = load_robot("ur10")
    q = np.tile([0.2, -1.0, 1.2, 0.1, 0.3, 0.2], (16, 1))
    q[:8, 0], q[8:, 1] = np.linspace(-2, 2, 8), np.linspace(-2, 0.4, 8)
    pose = WHERE @ forward(robot.screws, robot.flange, q)
    table = pd.DataFrame({"pose": np.arange(1, 17), "visit": 1, "time_s": 10.0 * np.arange(16)})
    table[[f"q{i + 1}_rad" for i in range(6)]] = q
    table[[f"dir{i + 1}" for i in range(6)]] = 1
    table["target"] = "T1"
    table[["x_m", "y_m", "z_m"]] = pose[:, :3, :3] @ TARGET + pose[:, :3, 3]
    header = {
        "robot": "ur10", "gravity_m_s2": [0.0, 0.0, -9.81], "tool": {"mass_kg": 0.0, "com_m": [0.0, 0.0, 0.0]},
        "targets_m": {"T1": TARGET}, "instrument": {"name": "none", "position_std_m": 1e-5},
    }  # fmt: skip
    return write_campaign(tmp_path_factory.mktemp("campaigns") / "circles", header, {"poses": table})


@pytest.mark.slow
def test_base_of_a_rigid_robot(clampid: Clampid, circles: Path, tmp_path: Path) -> None:
    ran = clampid("base", circles, "--rigid", "--json", "-", "-q")
    assert ran.code == 0, ran.err
    np.testing.assert_allclose(ran.json["base"], WHERE, atol=1e-9)
    assert {"std_w_v", "axes_1_2", "uncorrected_w_v", "springs", "circles"} <= set(ran.json)
    shown = clampid("base", circles, "--rigid", "-q")
    assert "2 circles, 16 points" in shown.out
    assert "biased by deflection" in shown.out


@pytest.mark.slow
def test_base_refuses_what_it_cannot_do(clampid: Clampid, circles: Path, poses_only: Path, model: Path) -> None:
    for arguments, words in (
        ((circles,), "ur10 has no springs or no masses"),
        ((poses_only, "--rigid"), "expected circles of joints 1 and 2"),
        ((circles, "--rigid", "--model", model), "expected no --model with it"),
        ((circles, "--model", circles / "none.json"), "expected a model file, found none"),
    ):
        ran = clampid("base", *arguments, "-q")
        assert ran.code == 2, ran.err
        assert words in ran.complaint


def test_base_from_touches(clampid: Clampid, tmp_path: Path) -> None:
    robot, rng = load_robot("ur10"), np.random.default_rng(0)
    q = rng.uniform(-1, 1, (6, 6)) + np.array([0.0, -1.0, 1.2, 0.1, 0.3, 0.2])
    there = (WHERE @ forward(robot.screws, robot.flange, q) @ np.r_[TARGET, 1.0])[:, :3]
    table = pd.DataFrame({f"q{i + 1}_rad": q[:, i] for i in range(6)})
    table.assign(feature=[f"p{k}" for k in range(6)]).to_csv(tmp_path / "touches.csv", index=False)
    text = 'format = "clampid-touched/1"\nrobot = "ur10"\ngravity_m_s2 = [0, 0, -9.81]\ntouches = "touches.csv"\n'
    text += f"[targets_m]\ntip = {TARGET}\n[instrument]\nposition_std_m = 2e-5\n"
    text += "".join(f'[features.p{k}]\nkind = "point"\npoint_m = {p.tolist()}\n' for k, p in enumerate(there))
    path = tmp_path / "cell.toml"
    path.write_text(text)
    ran = clampid("base", path, "--rigid", "--json", "-", "-q")
    assert ran.code == 0, ran.err
    np.testing.assert_allclose(ran.json["base"], WHERE, atol=1e-9)
    assert ran.json["degrees_of_freedom"] == 12
    shown = clampid("base", path, "--rigid", "-q").out
    assert "6 touches" in shown
    assert "the base in the frame of the cell" in shown
    path.write_text(text.partition("[features.p1]")[0])
    refused = clampid("base", path, "--rigid", "-q")
    assert refused.code == 2
    assert "row 2" in refused.complaint
