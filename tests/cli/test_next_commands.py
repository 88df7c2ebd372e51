"""Verbs that write a file end in one screen, too, and its next command runs as it is printed."""

from __future__ import annotations

import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from cli_runner import Clampid, Ran

from clampid.screen import HEIGHT, WIDTH
from clampid.verbs.run import _after
from clampid.verbs.screens import fit_screen
from experiments.campaign import write_campaign
from experiments.simulate import simulate


@pytest.fixture(scope="module")
def fitted(clampid: Clampid, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small campaign and a model that has errors of joint angles and torques."""
    folder = tmp_path_factory.mktemp("fitted")
    simulate(folder / "arm", seed=1, poses=60, tables=("free_air", "poses"))
    terms = ("--effects", "poses=geometry,joint_compliance,backlash,gear_eccentricity@joint2")
    assert clampid("identify", folder / "arm", "-o", folder / "model.json", *terms, "-q").code == 0
    return folder


def next_command(ran: Ran) -> list[str]:
    """The words of the first command that a screen offers, after checking the screen's size."""
    assert ran.code == 0, ran.err
    lines = ran.out.splitlines()
    assert len(lines) <= HEIGHT
    assert all(len(line) <= WIDTH or "/" in line.split()[-1] for line in lines)  # a long path is kept whole
    offered = [line for line in ran.out.replace("\\\n", "").splitlines() if line.startswith("  clampid ")]
    assert offered, ran.out
    return shlex.split(offered[0])[1:]


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("export", "kuka", "model.json", "-o", "robot.dat"),
        ("export", "kuka", "model.json", "--campaign", "arm", "-o", "robot2.dat"),
        ("export", "urdf", "model.json", "-o", "robot.urdf"),
        ("export", "dh", "model.json", "--campaign", "arm", "-o", "dh.csv"),
        ("export", "angles", "model.json", "-o", "angles.csv"),
        ("export", "dynamics", "model.json", "-o", "dynamics.json"),
        ("plan", "fixed-point", "-o", "fixed.toml", "--readings", "5"),
        ("plan", "poses", "-o", "poses.toml", "--poses", "8", "--replicates", "1", "--verification", "2"),
    ],
    ids=lambda words: " ".join(words[:2] + (("--campaign",) if "--campaign" in words else ())),
)
def test_what_a_verb_says_to_type_next_runs(
    words: tuple[str, ...], clampid: Clampid, fitted: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    monkeypatch.chdir(fitted)
    ran = clampid(*words)
    again = clampid(*next_command(ran))
    assert again.code == 0, again.err


@pytest.mark.slow
def test_no_campaign_is_named_that_lies_elsewhere(
    clampid: Clampid, fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.json").write_bytes((fitted / "model.json").read_bytes())
    offered = next_command(clampid("export", "urdf", "model.json", "-o", "robot.urdf"))
    assert "--campaign" not in offered


def test_a_new_effect_is_trusted_on_a_screen(clampid: Clampid, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.chdir(tmp_path)
    file = "bump.py"
    next_command(clampid("effect", "new", "bump", "--depends-on", "q3", "--at", "joint3", "-o", file))
    assert clampid(*next_command(clampid("effect", "trust", file))).code == 0


def test_a_missing_option_names_the_help_of_its_verb(clampid: Clampid) -> None:
    assert clampid("effect", "new", "bump").complaint.endswith("(see clampid effect new --help)")


def test_an_effect_file_that_is_not_there_is_said_to_be_missing(clampid: Clampid, tmp_path: Path) -> None:
    assert "found no such file" in clampid("effect", "trust", tmp_path / "none.py").complaint


@pytest.mark.slow
def test_a_dry_run_is_one_screen_and_lists_every_motion_on_demand(
    clampid: Clampid, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    monkeypatch.chdir(tmp_path)
    look = next_command(clampid("plan", "fixed-point", "-o", "fixed.toml", "--readings", "20"))
    short, whole = clampid(*look), clampid(*look, "--verbose")
    assert next_command(short)[:2] == ["run", "fixed.toml"]
    assert "reading" not in short.err
    assert len(whole.out.splitlines()) > len(short.out.splitlines()) + 20


@pytest.fixture
def one_pose(tmp_path: Path) -> Path:
    """A campaign of one pose, measured five times: too little for a fit, enough for repeatability."""
    rng = np.random.default_rng(2)
    table = pd.DataFrame({"pose": 1, "visit": range(1, 6), "time_s": np.arange(5.0)})
    for joint, angle in enumerate((0.2, -1.0, 1.2, 0.1, 0.3, 0.2)):
        table[f"q{joint + 1}_rad"], table[f"dir{joint + 1}"] = angle, 1
    table["target"] = "T1"
    table[["x_m", "y_m", "z_m"]] = np.array([1.0, 0.5, 0.8]) + rng.normal(0.0, 2e-5, (5, 3))
    header = {
        "robot": "kuka_kr20_r1810", "gravity_m_s2": [0.0, 0.0, -9.81], "targets_m": {"T1": [0.1, 0.0, 0.12]},
        "tool": {"mass_kg": 12.0, "com_m": [0.0, 0.0, 0.08]}, "instrument": {"name": "none", "position_std_m": 2e-5},
    }  # fmt: skip
    return write_campaign(tmp_path / "still", header, {"poses": table})


@pytest.mark.slow
def test_poses_that_are_too_few_for_a_fit_offer_no_fit(
    clampid: Clampid, one_pose: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(one_pose.parent)
    assert clampid("identify", "still", "-o", "model.json", "-q").code == 2
    ran = clampid("check", "still", "--iso9283", "-q")
    assert next_command(ran) == shlex.split("plan poses --robot kuka_kr20_r1810 --like still -o plan.toml")
    after = _after(Path("still"))
    assert shlex.split(after.command) == ["clampid", "check", "still", "--iso9283"]
    assert clampid(*next_command(ran), "-q").code == 0


def test_no_accuracy_is_stated_where_base_and_targets_fit_the_poses_exactly(clampid: Clampid, one_pose: Path) -> None:
    ran = clampid("check", one_pose, "--iso9283", "-q", "--json", "-")
    position = ran.json["iso9283"]["poses"]["position"]
    assert "AP" not in position
    assert "fit them exactly" in position["not_determinable"]["AP"]
    assert 5e-6 < position["RP"]["mean"] < 2e-4
    shown = clampid("check", one_pose, "--iso9283", "-q", "--verbose").out
    assert "take up" not in shown


@pytest.mark.parametrize(("targets", "like"), [({}, ""), ({"T1": [0.0, 0.0, 0.1]}, "--like few ")])
def test_too_few_poses_of_the_flange_itself_offer_a_plan_too(
    targets: dict[str, Any], like: str, clampid: Clampid, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A campaign of the flange with its orientation names no target: a plan like it has none to measure."""
    part = {"unit": "m", "heldout_rms": 1.2e-3, "rms": 1.5e-4, "noise_floor": 1.7e-5, "effects": ["geometry"],
            "parameters": 30, "not_identifiable": [], "enough_poses": 25}  # fmt: skip
    few: Any = SimpleNamespace(header={"robot": "ur10"}, robot=SimpleNamespace(name="ur10"), targets=targets)
    screen = fit_screen({"model": "m.json", "stages": {"poses": part}}, {}, {}, [few], [Path("few")], None)
    assert [step.command for step in screen.next] == [f"clampid plan poses --robot ur10 {like}--poses 25 -o plan.toml"]
    if not targets:
        monkeypatch.chdir(tmp_path)
        ran = clampid(*shlex.split(screen.next[0].command)[1:], "-q")
        assert ran.code == 0, ran.err
        assert (tmp_path / "plan.toml").is_file()


def test_check_of_what_it_refuses_does_not_say_what_identify_fits(
    clampid: Clampid, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    monkeypatch.chdir(tmp_path)
    simulate(tmp_path / "arm", seed=1, poses=40, tables=("poses",))
    assert "identify fits geometry" in " ".join(clampid("check", "arm").out.split())
    file = tmp_path / "arm" / "poses.parquet"
    table = pd.read_parquet(file)
    angles = [f"q{j}_rad" for j in range(1, 7)]
    table[angles] = table.groupby(["pose", "visit"])[angles].transform("first").shift(3).bfill()
    table.to_parquet(file, index=False)
    ran = clampid("check", "arm")
    assert ran.code == 2
    assert "The campaign cannot be used" in ran.out
    assert "identify fits" not in " ".join(ran.out.split())
    assert ran.out.endswith("Mend the tables, then check again:\n  clampid check arm\n")
