"""Campaign folders of the second world: valid, repeatable, with noise as stated and no hint of the truth."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import experiments.second_world as world
from experiments.second_world import LOG_PROGRAMS, NOISES, POSE_PROGRAMS, ROBOTS, draw_robot, measure
from experiments.second_world.noise import NOISES as KINDS
from experiments.second_world.noise import covariance, draw_noise
from experiments.second_world.session import open_session, points_seen, torques

CASES = [
    ("seven7", "few", "warm_up", "stereo", False),
    ("offset6", "few", "two_warmths", "quantised", False),
    ("big6", "line24", "trapezoids_10hz", "walk", True),
]


@pytest.mark.parametrize(("name", "poses", "log", "noise", "base_known"), CASES)
def test_the_program_accepts_a_campaign(tmp_path, program, name, poses, log, noise, base_known):
    folder = tmp_path / "campaign"
    truth = measure(
        draw_robot(name, 1),
        folder,
        program=poses,
        log=log,
        noise=noise,
        base_known=base_known,
        hidden=[("thermal_expansion", None, 1.0)],
        seed=1,
    )
    answer = subprocess.run([program, "check", folder], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    assert sorted(p.name for p in folder.iterdir()) == [
        "campaign.toml",
        "free_air.csv",
        "poses.csv",
        "robot.urdf",
        "verification.csv",
    ]
    hidden = json.loads(truth.hidden_file.read_text())
    assert truth.hidden_file == tmp_path / "campaign.hidden.json"
    assert [(h["effect"], len(h["where"])) for h in hidden] == [("thermal_expansion", 1)]
    assert {p["name"] for p in hidden[0]["parameters"]} == {"expansion", "lag"}


def test_the_same_call_writes_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        measure(
            draw_robot("small6", 4), tmp_path / name, program="few", hidden=[("stribeck_friction", None, 1)], seed=9
        )
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()
    measure(draw_robot("small6", 4), tmp_path / "c", program="few", seed=10)
    assert (tmp_path / "a" / "poses.csv").read_bytes() != (tmp_path / "c" / "poses.csv").read_bytes()


def test_hiding_something_changes_neither_noise_nor_program(tmp_path):
    robot = draw_robot("small6", 4)
    kwargs = {"program": "few", "noise": "student", "tables": ("poses",), "seed": 2}
    measure(robot, tmp_path / "plain", **kwargs)
    measure(robot, tmp_path / "hidden", hidden=[("time_of_day", None, 1.0)], **kwargs)
    plain, hidden = (pd.read_csv(tmp_path / f / "poses.csv") for f in ("plain", "hidden"))
    points = ["x_m", "y_m", "z_m"]
    pd.testing.assert_frame_equal(plain.drop(columns=points), hidden.drop(columns=points))
    difference = (hidden[points] - plain[points]).to_numpy()
    np.testing.assert_allclose(np.linalg.svd(difference)[1][1:], 0.0, atol=1e-7)  # along one direction


@pytest.mark.parametrize("noise", NOISES)
def test_tables_scatter_about_the_truth_as_stated(tmp_path, noise):
    robot = draw_robot("uncoupled6", 5)
    truth = measure(robot, tmp_path / "c", program="many", noise=noise, seed=6)
    session = open_session(robot, "many", "trapezoids_10hz", noise, 6)
    seen = pd.read_csv(tmp_path / "c" / "poses.csv")[["x_m", "y_m", "z_m"]].to_numpy()
    off = seen - points_seen(session, session.visits, []).reshape(-1, 3)
    expected = np.sqrt(truth.position_std_m**2 + (1.2 * robot.repeatability_rad) ** 2)
    np.testing.assert_allclose(off.std(0), expected, rtol=0.25)
    log = pd.read_csv(tmp_path / "c" / "free_air.csv")
    tau = log[[f"tau{j}_Nm" for j in range(1, 7)]].to_numpy() - torques(session, session.motion, [])
    np.testing.assert_allclose(tau.std(0), truth.torque_std_Nm, rtol=0.25)


def test_heavy_tails_and_slow_drifts_are_there():
    rng = np.random.default_rng(0)
    rows = np.arange(4000.0)
    std = np.ones(3)
    drawn = {k: draw_noise(KINDS[k], std, rows, rng) for k in ("white", "walk", "pink", "student")}
    kurtosis = {k: (v**4).mean() / (v**2).mean() ** 2 for k, v in drawn.items()}
    assert kurtosis["student"] > 4 > kurtosis["white"]
    blocks = {k: v.reshape(40, 100, 3).mean(1).std() for k, v in drawn.items()}
    assert min(blocks["walk"], blocks["pink"]) > 1.5 * blocks["white"]


def test_temperatures_can_be_left_out(tmp_path):
    measure(draw_robot("small6", 4), tmp_path / "c", program="few", temperatures=False, seed=1)
    for table in ("poses", "free_air"):
        assert not [c for c in pd.read_csv(tmp_path / "c" / f"{table}.csv", nrows=1) if c.startswith("temp_")]


def test_only_numpy_scipy_pandas_and_pinocchio_are_imported():
    allowed = {"numpy", "scipy", "pandas", "pinocchio", *sys.stdlib_module_names}
    for file in Path(world.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                assert name.split(".")[0] in allowed or name.startswith("experiments.second_world"), f"{file}: {name}"


def test_wrong_choices_are_told_with_what_exists(tmp_path):
    robot = draw_robot("small6", 4)
    with pytest.raises(ValueError, match="expected one of quick"):
        measure(robot, tmp_path / "c", program="quik")
    with pytest.raises(ValueError, match="expected one of trapezoids_10hz"):
        measure(robot, tmp_path / "c", log="none")
    with pytest.raises(ValueError, match="expected one of white"):
        measure(robot, tmp_path / "c", noise="loud")
    with pytest.raises(ValueError, match="expected some of free_air"):
        measure(robot, tmp_path / "c", tables=("clamped",))
    with pytest.raises(ValueError, match=f"expected one of {', '.join(ROBOTS)}"):
        draw_robot("r2d2", 1)
    assert not (tmp_path / "c").exists()


def test_what_may_be_chosen_is_public():
    assert all(hasattr(world, name) for name in world.__all__)
    assert {"line24", "two_sided"} <= set(POSE_PROGRAMS)
    assert {p.kind for p in LOG_PROGRAMS.values()} == {"trapezoids", "fourier"}


@pytest.mark.parametrize("kind", ["white", "walk", "pink"])
def test_the_covariance_is_that_of_the_draws(kind: str):
    """Of pink noise, each column of which has exactly the same spread, to a twentieth."""
    count, columns = 60, 20_000
    drawn = draw_noise(KINDS[kind], np.ones(columns), np.arange(float(count)), np.random.default_rng(3))
    found, stated = drawn @ drawn.T / columns, covariance(KINDS[kind], np.arange(float(count)))
    off = np.sqrt((np.outer(np.diag(stated), np.diag(stated)) + stated**2) / columns)
    assert np.all(np.abs(found - stated) < 5.0 * off + (0.05 if kind == "pink" else 0.0))
