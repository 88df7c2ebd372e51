"""Wrong calls and wrong input: exit code 2, one line that says what was expected and found, nothing left behind."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
import typer
from cli_runner import Clampid

VERBS = (
    "demo", "check", "identify", "auto", "compare", "diagnose", "add", "history", "effects", "export", "simulate",
    "ik", "serve", "base",
)  # fmt: skip


def test_help_lists_the_verbs_and_does_not_import_what_only_verbs_need(clampid: Clampid) -> None:
    ran = clampid("--help")
    assert ran.code == 0
    for verb in VERBS:
        assert f"  {verb}" in ran.out
    code = "import sys, clampid.cli as c; c.app(); print({'numpy', 'casadi', 'pandas', 'plotly'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize("group", ["", "export", "effect", "plan"])
def test_no_line_of_help_about_a_verb_is_cut_off(group: str, clampid: Clampid, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    ran = clampid(*group.split(), "--help")
    _, _, commands = ran.out.partition("Commands:")
    assert len(commands.splitlines()) > 2
    assert "..." not in commands


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help(verb: str, clampid: Clampid) -> None:
    ran = clampid(verb, "--help")
    assert (ran.code, ran.err) == (0, "")


def test_version(clampid: Clampid) -> None:
    assert clampid("--version").out.startswith("clampid ")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("chek x", "No such command 'chek'. Did you mean 'check'?"),
        ("check", "Missing argument 'CAMPAIGN'"),
        ("check --nonsense x", "No such option"),
        ("check nowhere", "nowhere: expected a campaign folder"),
        ("identify nowhere -o m.json", "nowhere: expected a campaign folder"),
        ("identify {poses} -o m.json --seed -1", "'--seed': Input should be greater than or equal to 0"),
        ("simulate -o new --seed -1", "'--seed': Input should be greater than or equal to 0"),
        ("plan poses -o new.toml --seed -1", "'--seed': Input should be greater than or equal to 0"),
        ("simulate -o new --hide payload:1e308", "payload: expected a finite magnitude of at most 1000 times"),
        ("simulate -o new --hide backlash@joint1:-1e4", "backlash: expected a finite magnitude of at most 1000 times"),
        ("virtual-robot --hide payload:inf", "payload: expected a finite magnitude of at most 1000 times"),
        ("simulate -o new --hide nonlinear_stiffness:-1000", "nonlinear_stiffness:-1000: "),
        ("simulate -o new --hide hysteresis:-1000", "hysteresis:-1000: "),
        ("identify {poses} -o m.json --holdout 1.5", "--holdout: expected a share from 0 to below 1, found 1.5"),
        ("identify {poses} -o m.json --effects geometri", "no effect is called 'geometri'; did you mean geometry?"),
        ("identify {poses} -o m.json --effects posse=geometry", "no stage is called 'posse'; did you mean poses?"),
        ("identify {poses} -o m.json --effects clamped=backlash", "the campaign has no table of the stage clamped"),
        ("identify {poses} -o m.json --effects poses=geometry,,", "found an empty one"),
        ("identify {poses} -o m.json --effects poses=geometry,stribeck_friction", "does not act in poses"),
        ("identify {poses} -o m.json --effects poses=geometry,backlash@joint9", "cannot sit at 'joint9'"),
        ("identify {poses} -o m.json --effects poses=geometry --effects poses=backlash", "given twice"),
        ("identify {poses} -o m.json --effects poses=geometry --effects backlash", "found both"),
        ("identify {poses} -o m.json --effects-from none.py", "none.py: expected a Python file"),
        ("identify {poses} -o .", "expected a file to write to, found a folder"),
        ("identify {whole} -o m.json --effects geometry,backlash", "the campaign has tables of free_air, clamped"),
        ("identify {poses} {whole} -o m.json", "several campaigns are sessions of one robot"),
        ("auto {poses} -o m.json --report .", "expected a file to write to, found a folder"),
        ("compare none.json {poses}", "none.json: expected a model file, found none"),
        ("compare {poses}/campaign.toml {poses}", "expected a model as JSON"),
        ("compare {model} {poses} --refit base tool", "did you mean --refit base,tool?"),
        ("compare {model} {poses} --refit elbow", "--refit: expected base, tool or both, found 'elbow'"),
        ("compare {model} {poses} --refit-fraction 0", "--refit-fraction: expected a share between 0 and 1"),
        ("compare {model} {whole}", "kuka_kr20_r1810"),
        ("diagnose {model} {whole}", "kuka_kr20_r1810"),
        ("add nonsense {model} {poses} -o m.json", "no effect is called 'nonsense'"),
        ("add poses= {model} {poses} -o m.json", "expected an effect after 'poses=', found none"),
        ("add stribeck_friction {model} {poses} -o m.json", "stribeck_friction"),
        ("history none.json", "none.json: expected a model file, found none"),
        ("export dh {model} --convention denavit", "'--convention': 'denavit' is not one of 'standard', 'hayati'"),
        ("export dh {model} --convention hayti", "; did you mean hayati?"),
        ("export dh {model} --session 2", "session 2: the model has sessions 1 to 1"),
        ("export urdf {model}", "Missing option"),
        ("export kuka {model} -o arm.dat --mm", "--mm is the unit of --lever"),
        ("export kuka {model} -o arm.dat", "ur10: expected an ortho-parallel arm"),
        ("simulate -o c --hide backlach", "did you mean 'backlash'?"),
        ("simulate -o c --hide backlash@elbow", "expected joint1, joint2"),
        ("simulate -o c --hide backlash:much", "expected a number after ':', found 'much'"),
        ("simulate -o c --robot kuka", "robot 'kuka': expected a path"),
        ("simulate -o c --poses 0", "poses: expected at least 1, found 0"),
        ("simulate -o {poses}", "expected a new or empty folder, found something there"),
    ],
)  # fmt: skip
def test_a_wrong_call_is_refused_in_one_line(
    arguments: str, words: str, clampid: Clampid, poses_only: Path, whole: Path, model: Path, tmp_path: Path
) -> None:
    typed = arguments.format(poses=poses_only, whole=whole, model=model).split()
    ran = clampid(*typed, cwd=tmp_path)
    assert ran.code == 2, ran.err
    assert words in ran.complaint
    assert list(tmp_path.iterdir()) == []


def test_an_error_of_the_program_is_one_line_with_its_kind(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import clampid.cli as cli

    def broken() -> None:
        raise RuntimeError("two\nlines")

    def app() -> typer.Typer:
        made = typer.Typer()
        made.command("a")(broken)
        made.command("b")(broken)
        return made

    monkeypatch.setattr(cli, "app", app)
    assert cli.run(["a"]) == 1
    assert capsys.readouterr().err == "clampid: RuntimeError: two lines (clampid --debug … shows where)\n"
    assert cli.run(["a"], debug=True) == 1
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.slow
def test_degrees_are_refused_by_identify_and_by_check(clampid: Clampid, poses_only: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(poses_only, tmp_path / "degrees")
    table = pd.read_parquet(folder / "poses.parquet")
    angles = [c for c in table.columns if c.startswith("q") and c.endswith("_rad")]
    table[angles] *= 180 / 3.141592653589793
    table.to_parquet(folder / "poses.parquet", index=False)
    for verb in (("identify", folder, "-o", tmp_path / "m.json"), ("check", folder)):
        ran = clampid(*verb)
        assert ran.code == 2
        assert "degrees" in ran.complaint
    assert not (tmp_path / "m.json").exists()


def test_a_spoiled_row_is_named(clampid: Clampid, poses_only: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(poses_only, tmp_path / "spoiled")
    table = pd.read_parquet(folder / "poses.parquet")
    table.loc[6, "x_m"] = float("nan")
    table.to_parquet(folder / "poses.parquet", index=False)
    ran = clampid("identify", folder, "-o", tmp_path / "m.json")
    assert ran.code == 2
    assert "poses.parquet, row 7, column x_m: expected" in ran.complaint


def test_a_spoiled_model_is_refused(clampid: Clampid, model: Path, poses_only: Path, tmp_path: Path) -> None:
    data = json.loads(model.read_text())
    del data["stages"]["poses"]["covariance"]
    spoiled = tmp_path / "m.json"
    spoiled.write_text(json.dumps(data))
    ran = clampid("compare", spoiled, poses_only)
    assert ran.code == 2
    count = len(data["stages"]["poses"]["parameters"])
    expected = f"expected {count} lists of {count} finite numbers, found no such key"
    assert f"m.json: key stages.poses.covariance: {expected}" in ran.complaint


def test_a_failed_write_leaves_the_old_file(clampid: Clampid, poses_only: Path, tmp_path: Path) -> None:
    old = tmp_path / "m.json"
    old.write_text("old")
    assert clampid("identify", poses_only, "-o", old, "--effects", "nonsense").code == 2
    assert old.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["m.json"]


@pytest.mark.parametrize("verb", ["identify", "add", "report", "compare", "import", "export dh", "plan poses", "ik"])
def test_help_speaks_of_names_and_not_of_types(verb: str, clampid: Clampid, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    said = clampid(*verb.split(), "--help").out
    assert max(map(len, said.splitlines())) <= 80
    for type_of_python in ("list[", "<path>", "<str>", "<int", "<float", "{", "]]"):
        assert type_of_python not in said
