"""A bad day: killed at any moment, a full disk, a home that is none, two at once; nothing is lost or half-written."""

from __future__ import annotations

import json
import os
import pwd
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from bad_day import Bench, child, digests, results

from clampid.chain import library_folder
from clampid.cli import run
from clampid.effect import EffectError
from clampid.trusted import trust_file
from experiments import outputs
from experiments.campaign import read_campaign, write_campaign
from experiments.outputs import new_folder, scratch_folder
from experiments.simulate import simulate

ROOT = Path(__file__).parents[2]


def program(what: str, folder: Path, *verbs: str) -> dict[str, dict[str, Any]]:
    """Run the trials in a process of its own; the counts of each verb."""
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    ran = subprocess.run(
        [sys.executable, Path(__file__).with_name("bad_day.py"), what, folder, "1", *verbs],
        capture_output=True, text=True, timeout=800, check=False, env={**os.environ, "PYTHONPATH": paths},
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr[-2000:]
    lines = [json.loads(line) for line in ran.stdout.splitlines() if line.startswith("{")]
    assert not [line for line in lines if "bad" in line]
    for line in lines:
        print(line)
    return {line["verb"]: line for line in lines}


@pytest.mark.parametrize(
    ("times", "total"), [pytest.param(1, 40, marks=pytest.mark.slow), pytest.param(5, 200, marks=pytest.mark.study)]
)
def test_kills_lose_nothing(times: int, total: int, tmp_path: Path) -> None:
    verbs = {"identify": 9, "auto": 2, "import": 11, "export": 12, "serve": 6}
    wanted = {verb: times * count for verb, count in verbs.items()}
    counts = program("kill", tmp_path, *(f"{verb}:{count}" for verb, count in wanted.items()))
    assert {verb: line["killed"] for verb, line in counts.items()} == wanted
    assert sum(wanted.values()) == total


@pytest.mark.parametrize(
    ("every", "least"), [pytest.param(3, 20, marks=pytest.mark.slow), pytest.param(1, 50, marks=pytest.mark.study)]
)
def test_a_disk_that_is_full_from_any_write_on_costs_no_older_result(every: int, least: int, tmp_path: Path) -> None:
    strides = {"export": 1, "urdf": 2, "import": 2, "simulate": 1, "identify": 4, "auto": 12}
    counts = program("full", tmp_path, *(f"{verb}:{every * stride}" for verb, stride in strides.items()))
    assert sum(line["tried"] for line in counts.values()) >= least


@pytest.mark.slow
def test_two_processes_with_one_output_leave_one_whole_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    bench = Bench(tmp_path)
    bench.fill()
    bench.calls["other"] = [*bench.calls["identify"], "--seed", "5"]
    wanted = [results(bench, "identify"), results(bench, "other")]
    assert wanted[0]["m.json"] != wanted[1]["m.json"]
    for _ in range(5):
        bench.clear()
        pair = [child(bench.calls["identify"]), child(bench.calls["other"])]
        assert [os.waitpid(number, 0)[1] for number in pair] == [0, 0]
        found = digests(bench.out)
        assert set(found) == set(wanted[0])
        assert all(mark in (wanted[0][name], wanted[1][name]) for name, mark in found.items())
    for _ in range(5):
        bench.clear()
        pair = [child(bench.calls["import"]), child(bench.calls["import"])]
        codes = [os.waitstatus_to_exitcode(os.waitpid(number, 0)[1]) for number in pair]
        assert sorted(codes) in ([0, 0], [0, 2])
        assert sorted(p.name for p in bench.out.iterdir()) == ["new", "r.json"]
        read_campaign(bench.out / "new")


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    return simulate(tmp_path / "arm", "ur10", seed=3, poses=14, tables=("poses",), file_format="csv")


@pytest.mark.parametrize("home", ["/proc/nothing", "/dev/null", "none"])
def test_without_a_home_it_works_and_trusts_nobody(
    home: str, arm: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    for name in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    if home == "none":
        monkeypatch.setattr(pwd, "getpwuid", lambda _: {}[0])  # a user that no list knows, as in a container
    else:
        monkeypatch.setenv("HOME", home)
    monkeypatch.chdir(tmp_path)
    library_folder._private.cache_clear()
    assert run(["identify", str(arm), "-o", "m.json", "-q"]) == 0
    (tmp_path / "own.py").write_text("EFFECT = 1\n")
    capsys.readouterr()
    assert run(["effect", "trust", "own.py"]) == 2
    assert "the list of trusted effects" in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["arm", "arm.hidden.json", "m.json", "own.py"]


def test_where_the_list_of_trusted_effects_would_be_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.setattr(pwd, "getpwuid", lambda _: {}[0])
    with pytest.raises(EffectError, match="has no place"):
        trust_file()


def test_a_killed_process_s_folder_is_removed_by_the_next_one(tmp_path: Path) -> None:
    number = os.fork()
    if number == 0:
        with scratch_folder(tmp_path, "library"):
            os._exit(0)
    os.waitpid(number, 0)
    assert len(list(tmp_path.iterdir())) == 1
    with scratch_folder(tmp_path, "library") as folder:
        assert list(tmp_path.iterdir()) == [folder]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("at_once", [True, False])
def test_a_campaign_written_over_is_there_at_every_moment(
    at_once: bool, arm: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not at_once:
        monkeypatch.setattr(outputs, "_exchange", lambda *_: False)
    elif not outputs._exchange(arm, arm.with_name("nowhere")) and sys.platform != "linux":
        pytest.skip("this system cannot exchange folders")
    seen = []

    def heard(event: str, _: object) -> None:
        if event == "os.rename" and watching:
            seen.append(arm.is_dir())

    watching = True
    sys.addaudithook(heard)
    (arm / "notes.md").write_text("mine\n")
    campaign = read_campaign(arm)
    header = {"robot": "ur10", "gravity_m_s2": [0.0, 0.0, -9.81], "targets_m": {"T1": [0.1, 0.0, 0.12]}}
    table = campaign.tables["poses"].query("target == 'T1'").iloc[:6]
    write_campaign(arm, header, {"poses": table}, "csv", overwrite=True)
    watching = False
    assert (all(seen) and not seen) == at_once  # by one exchange, no rename takes it away
    assert len(read_campaign(arm).tables["poses"]) == 6
    assert (arm / "notes.md").read_text() == "mine\n"
    assert sorted(p.name for p in arm.parent.iterdir()) == ["arm", "arm.hidden.json"]


def test_a_folder_that_appears_meanwhile_is_not_written_over(tmp_path: Path) -> None:
    def write() -> None:
        with new_folder(tmp_path / "new") as partial:
            (partial / "mine").touch()
            (tmp_path / "new").mkdir()
            (tmp_path / "new" / "theirs").touch()

    with pytest.raises(outputs.OutputError, match="cannot be written"):
        write()
    assert [p.name for p in tmp_path.iterdir()] == ["new"]
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["theirs"]
