"""Torque logs with something wrong about them, as a user meets them: what the command says, and that it says it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cli_runner import Clampid

from experiments.simulate import simulate
from kinematics.description import load_robot

ROBOT = load_robot("kuka_kr20_r1810")
T = np.asarray(ROBOT.transmission)
RATED = np.abs(np.diag(T)) * [joint.rated_torque or np.nan for joint in ROBOT.joints]
Q, QD, TAU = ([p.format(i) for i in range(1, 7)] for p in ("q{}_rad", "qd{}_rad_s", "tau{}_Nm"))
Edit = Callable[[pd.DataFrame], pd.DataFrame]


@pytest.fixture(scope="module")
def heavier(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a free-air log whose tool is not the one declared."""
    return simulate(tmp_path_factory.mktemp("logs") / "arm", ROBOT.name, ["payload"], seed=3, tables=("free_air",))


@pytest.fixture
def edited(heavier: Path, tmp_path: Path) -> Callable[[Edit], Path]:
    """Write the campaign with another free-air table."""

    def write(edit: Edit) -> Path:
        folder = tmp_path / "edited"
        shutil.copytree(heavier, folder)
        edit(pd.read_parquet(heavier / "free_air.parquet")).reset_index(drop=True).to_parquet(
            folder / "free_air.parquet"
        )
        return folder

    return write


def behind_the_gears(log: pd.DataFrame) -> pd.DataFrame:
    return log.assign(**dict(zip(TAU, np.linalg.solve(T, log[TAU].to_numpy().T), strict=True)))


def per_cent(log: pd.DataFrame) -> pd.DataFrame:
    return log.assign(**dict(zip(TAU, 100.0 * log[TAU].to_numpy().T / RATED[:, None], strict=True)))


def forwards_only(log: pd.DataFrame) -> pd.DataFrame:
    return log[log["qd2_rad_s"] > -1e-3]


def one_speed(log: pd.DataFrame) -> pd.DataFrame:
    speed = log["qd2_rad_s"].abs()
    usual = float(speed[speed > 1e-2].quantile(0.75))
    return log[(speed < 1e-3) | ((speed / usual - 1.0).abs() < 0.02)]


def frozen(log: pd.DataFrame) -> pd.DataFrame:
    return log.iloc[:2000].assign(**{c: log[c].iloc[0] for c in Q}, **dict.fromkeys(QD, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (behind_the_gears, "torques look like those at the joints, behind the gears"),
        (per_cent, "torques look like per cent of the motors' rated torque"),
    ],
)
def test_torques_in_another_unit_are_named_and_refused(
    clampid: Clampid, edited: Callable[[Edit], Path], tmp_path: Path, edit: Edit, words: str
):
    campaign = edited(edit)
    for verb in (("check", campaign), ("identify", campaign, "-q", "-o", tmp_path / "model.json")):
        done = clampid(*verb)
        assert done.code == 2
        assert words in done.complaint
        assert "Nm at the motor shaft are expected" in done.complaint
        assert "free_air, column tau" in done.complaint
    assert not (tmp_path / "model.json").exists()


@pytest.mark.slow
def test_a_joint_that_never_reverses_is_reported(clampid: Clampid, edited: Callable[[Edit], Path], tmp_path: Path):
    done = clampid("identify", edited(forwards_only), "-q", "-o", tmp_path / "model.json")
    assert done.code == 0
    said = " ".join((done.err + done.out).split())
    assert "joint 2 never reverses" in said
    assert "its dry friction and its torque's offset are not separable" in said


def test_one_speed_is_reported_and_its_frictions_are_not_identified(
    clampid: Clampid, edited: Callable[[Edit], Path], tmp_path: Path
):
    model = tmp_path / "model.json"
    done = clampid("identify", edited(one_speed), "-q", "-o", model)
    assert done.code == 0
    said = " ".join((done.err + done.out).split())
    assert "joint 2 moves at one speed only" in said
    stage = json.loads(model.read_text(encoding="utf-8"))["stages"]["free_air"]
    told = {(p["effect"], p["at"]): p["identified"] for p in stage["parameters"]}
    for effect in ("coulomb_friction", "viscous_friction"):
        assert not told[effect, "joint2"]
        assert told[effect, "joint1"]


@pytest.mark.slow
def test_standstill_only_is_refused(clampid: Clampid, edited: Callable[[Edit], Path], tmp_path: Path):
    campaign = edited(frozen)
    checked = clampid("check", campaign)
    assert checked.code == 0
    assert "standstill only" in " ".join((checked.err + checked.out).split())
    done = clampid("identify", campaign, "-q", "-o", tmp_path / "model.json")
    assert done.code == 2
    assert "no motor moves" in done.complaint
    assert not (tmp_path / "model.json").exists()


@pytest.mark.slow
def test_a_tool_other_than_declared_is_diagnosed_as_payload(clampid: Clampid, heavier: Path, tmp_path: Path):
    model, report = tmp_path / "model.json", tmp_path / "diagnosis.json"
    assert clampid("identify", heavier, "-q", "-o", model).code == 0
    assert clampid("diagnose", model, heavier, "-q", "--json", report).code == 0
    stage = json.loads(report.read_text(encoding="utf-8"))["stages"]["free_air"]
    assert stage["verdict"] == "missing"
    (named,) = stage["candidates"][:1]
    assert named["effect"] == "payload"
    (truth,) = json.loads(Path(f"{heavier}.hidden.json").read_text(encoding="utf-8"))
    found = {p["name"].partition(".")[2].partition("@")[0]: p for p in named["parameters"]}
    for axis in "xyz":
        estimate, error = found[f"m{axis}"]["value"], found[f"m{axis}"]["std"]
        assert abs(estimate - truth["parameters"][f"moment_{axis}_kg_m"]) < 3.5 * error
