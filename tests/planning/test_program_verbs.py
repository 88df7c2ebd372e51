"""The verbs of ``clampid plan`` for returns and warm-ups: files that read back, units, and calls that are refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from clampid.verbs.check import check
from clampid.verbs.errors import CallError
from clampid.verbs.plan import plan
from experiments.plans import read_plan
from experiments.plans.virtual import run_virtually

CUBE = ["--cube", "1.1,0,1.0,0.4"]
LINE = ["--from", "0.9,-0.3,1.0", "--to", "0.9,0.3,1.0"]


def call(*words: str) -> str:
    found = CliRunner().invoke(plan, list(words))
    if found.exception is not None and not isinstance(found.exception, SystemExit):
        raise found.exception
    assert found.exit_code == 0, found.output
    return " ".join(found.output.split())


@pytest.mark.parametrize(
    ("words", "visits", "said"),
    [
        (["iso9283", *CUBE, "--cycles", "3"], 15, "3 cycles of 5 poses"),
        (["line", *LINE, "--stops", "4", "--repetitions", "2"], 16, "4 stops, 2 times out and back"),
        (["fixed-point", "--readings", "3"], 3, "3 readings of a fixed point"),
        (["warm-up", "--hours", "0.5", "--until-steady", "0.5"], 13, "7 measurements of the reference point"),
    ],
)
def test_a_plan_is_written_and_reads_back(tmp_path: Path, words: list[str], visits: int, said: str) -> None:
    file, told = tmp_path / "plan.toml", tmp_path / "told.json"
    assert said in call(*words, "-o", str(file), "--json", str(told))
    assert len(read_plan(file).visits) == visits == json.loads(told.read_text())["visits"]


def test_degrees_and_millimetres(tmp_path: Path) -> None:
    common = ["--stops", "3", "--repetitions", "1", "--last-move", "1", "--one-side"]
    call("line", *LINE, *common, "--approach", str(np.radians(0.15)), "-o", str(tmp_path / "a.toml"))
    call(
        "line", "--from", "900,-300,1000", "--to", "900,300,1000", "--mm", "--deg", *common, "--approach", "0.15",
        "-o", str(tmp_path / "b.toml"),
    )  # fmt: skip
    a, b = read_plan(tmp_path / "a.toml"), read_plan(tmp_path / "b.toml")
    np.testing.assert_allclose([v.q for v in a.visits], [v.q for v in b.visits])
    np.testing.assert_allclose([v.via for v in a.visits], [v.via for v in b.visits])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["iso9283", "--cube", "1,0,1"], "--cube: expected X,Y,Z,EDGE, found '1,0,1'"),
        (["iso9283", *CUBE, "--plane", "z"], "plane: expected one of a, b, c, d, found 'z'"),
        (["iso9283", *CUBE, "--way", "0,1"], "--way: expected three numbers, found 2"),
        (["iso9283", *CUBE, "--targets", "T9"], "targets: expected some of T1, T2, T3, found 'T9'"),
        (["iso9283", *CUBE, "--speed", "0"], "speed: expected a share"),
        (["line", "--from", "0,0,1", "--to", "1"], "--to: expected three numbers, found 1"),
        (["fixed-point", "--posture", "0,0"], "--posture: expected 6 angles in rad, found 2"),
        (["warm-up", "--joints", "7"], "--joints: expected different numbers from 1 to 6, found '7'"),
        (["warm-up", "--interrupt", "1"], "--interrupt: expected two numbers of hours"),
        (["warm-up", "--until-steady", "-1"], "until steady: expected K/h above 0"),
        (["warm-up", "--every", "0"], "every: expected above 0"),
        (["warm-up", "--hours", "nan"], "hours: expected above 0"),
        (["warm-up", "--measure-time", "-1"], "measuring time: expected seconds from 0"),
    ],
)
def test_calls_that_cannot_be_meant(tmp_path: Path, words: list[str], said: str) -> None:
    with pytest.raises(CallError) as error:
        call(*words, "-o", str(tmp_path / "plan.toml"))
    assert said in str(error.value)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "plan.toml").exists()


def test_five_poses_are_enough_for_the_metrics_though_not_for_a_fit(tmp_path: Path) -> None:
    call("iso9283", *CUBE, "--cycles", "4", "--both-sides", "-o", str(tmp_path / "plan.toml"))
    campaign = run_virtually(read_plan(tmp_path / "plan.toml"), tmp_path / "C", ["backlash@joint2"], seed=1)
    verb = typer.Typer()
    verb.command()(check)
    told = tmp_path / "told.json"
    found = CliRunner().invoke(verb, [str(campaign), "--iso9283", "--json", str(told)])
    assert found.exception is None, found.exception
    metrics = json.loads(told.read_text())["iso9283"]["poses"]["position"]
    assert metrics["RP"]["places"] == 10
    assert metrics["vAP"]["mean"] > 3 * metrics["RP"]["mean"]  # the clearance shows between the sides
    fit = CliRunner().invoke(verb, [str(campaign)])
    assert "5 poses are fewer than" in str(fit.exception)
