"""Spoilt files: each reader reads them or refuses them in words; none hangs, ends the process, or eats memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from readers import is_refusal, misspelt, readers, share_of
from spoil import spoilt

from clampid.cli import run
from clampid.models.model import load_model
from experiments.campaign import CampaignError, read_campaign
from experiments.simulate import simulate
from kinematics.description import load_robot
from kinematics.reading import fraction_of
from kinematics.robot import DescriptionError

MEMORY = 1024  # MB
NAMES = (
    "model", "campaign.toml", "poses.csv", "poses.parquet", "robot", "plan", "mapping", "points", "cell", "touched",
    "touches", "peaks", "obstacles", "obj", "stl", "trusted", "dh", "machine data", "torque model", "free_air.csv",
    "wrist.parquet", "clamped.csv", "verification.parquet", "journal", "truth", "events", "channel", "readings",
    "answer", "address", "pairing", "robot's log", "effect", "until", "token", "checked campaign.toml",
    "checked poses.csv", "checked free_air.csv", "checked wrist.parquet", "checked clamped.csv",
    "checked verification.parquet", "arm", "paired mapping", "paired robot's log",
)  # fmt: skip
"""All but URDF, which compiled code reads: that is tried in a process of its own."""


@pytest.fixture(scope="module")
def every(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, dict]]:
    folder, before = tmp_path_factory.mktemp("fuzz"), os.environ.get("XDG_CONFIG_HOME")
    yield folder, readers(folder)
    os.environ.pop("XDG_CONFIG_HOME", None)
    if before is not None:
        os.environ["XDG_CONFIG_HOME"] = before


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("name", NAMES)
@settings(deadline=10_000, max_examples=40, suppress_health_check=list(HealthCheck), derandomize=True, database=None)
@given(seed=st.integers(0, 1 << 40))
def test_a_spoilt_file_is_read_or_refused(name: str, seed: int, every: tuple[Path, dict]) -> None:
    folder, known = every
    good, at, read = known[name]
    try:
        (folder / at).write_bytes(misspelt(name, at, good, seed) if seed % 2 else spoilt(good, seed))
        try:
            read(folder / at)
        except Exception as error:
            if not is_refusal(error):
                raise
    finally:
        (folder / at).write_bytes(good)


def fuzzed(count: int | str, seed: int, *names: str, program: str = "readers.py") -> None:
    """Run the readers in a process of its own, and look at what it says; ``share``, ``whole``: see `share_of`."""
    here = Path(__file__).parent
    done = subprocess.run(
        [sys.executable, program, str(count), str(seed), *names],
        cwd=here, capture_output=True, text=True, errors="replace", check=False,
        env={**os.environ, "PYTHONPATH": str(here.parents[1])},
    )  # fmt: skip
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    tried = [line for line in lines if "trying" in line]
    assert done.returncode == 0, f"ended by {done.returncode} at {tried[-1:]}: {done.stderr[-500:]}"
    counts = [line for line in lines if "counts" in line]
    for line in counts:
        print(line)
    print(f"{len(tried)} spoilt files")
    assert not [line for line in lines if "error" in line]
    assert all(line["memory_MB"] < MEMORY for line in counts)
    assert all(line["slowest_s"] < (10 if program == "readers.py" else 20) for line in counts)  # a report takes seconds
    shares = [share_of(line["counts"], count == "whole") if isinstance(count, str) else count for line in counts]
    assert len(tried) == sum(shares)


@pytest.mark.slow
def test_compiled_readers_survive_spoilt_files() -> None:
    fuzzed(150, 7, "urdf")


@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    "seed",
    [pytest.param(8, marks=pytest.mark.slow), pytest.param(12, marks=pytest.mark.study)],
    ids=["first half", "second half"],
)
def test_each_reader_reads_or_refuses_its_share_of_spoilt_files(seed: int) -> None:
    """1000 of each reader in two halves; 50 of what goes on to work with a file."""
    fuzzed("share", seed)


@pytest.mark.study
@pytest.mark.timeout(7200)
def test_each_reader_reads_or_refuses_ten_thousand_spoilt_files() -> None:
    fuzzed("whole", 16)


@pytest.mark.slow
def test_verbs_answer_hundreds_of_spoilt_inputs_in_one_line() -> None:
    fuzzed(15, 10, program="verbs.py")


@pytest.mark.study
@pytest.mark.timeout(7200)
def test_verbs_answer_a_thousand_spoilt_inputs_in_one_line() -> None:
    fuzzed(130, 17, program="verbs.py")


@pytest.mark.slow
def test_hundreds_of_calls_that_cannot_be_meant_are_refused_in_one_line() -> None:
    fuzzed(8, 14, program="calls.py")


@pytest.mark.study
@pytest.mark.timeout(7200)
def test_ten_thousand_calls_that_cannot_be_meant_are_refused_in_one_line() -> None:
    fuzzed(320, 15, program="calls.py")


HUGE = {
    "a list in a cell": lambda t: t.assign(extra=[[1, 2]] * len(t)),
    "a pose beyond 2^53": lambda t: t.assign(pose=[9007199254740993 + int(k) for k in t["pose"]]),
    "a pose of 23 digits": lambda t: t.assign(pose=t["pose"].astype(float) * 1e22),
}


@pytest.mark.parametrize("what", HUGE)
def test_parquet_that_is_no_table_is_refused(what: str, every: tuple[Path, dict], tmp_path: Path) -> None:
    folder, _ = every
    change: Callable[[pd.DataFrame], pd.DataFrame] = HUGE[what]
    change(pd.read_csv(folder / "arm" / "poses.csv")).to_parquet(tmp_path / "poses.parquet")
    header = (folder / "arm" / "campaign.toml").read_text().replace("poses.csv", "poses.parquet")
    (tmp_path / "campaign.toml").write_text(header)
    with pytest.raises(CampaignError, match=r"poses\.parquet"):
        read_campaign(tmp_path)


def test_poses_in_text_whose_numbers_would_become_one_are_refused(every: tuple[Path, dict], tmp_path: Path) -> None:
    folder, _ = every
    table = pd.read_csv(folder / "arm" / "poses.csv")
    table["pose"] = table["pose"].replace({1: 2**53, 2: 2**53 + 1})
    table.to_csv(tmp_path / "poses.csv", index=False)
    (tmp_path / "campaign.toml").write_bytes((folder / "arm" / "campaign.toml").read_bytes())
    with pytest.raises(CampaignError, match=r"poses\.csv, row .*column pose: expected an integer"):
        read_campaign(tmp_path)


def test_more_poses_than_there_is_time_for_are_refused(tmp_path: Path, capsys) -> None:
    call = ["simulate", "--robot", "ur10", "-o", str(tmp_path / "arm"), "--poses", "1000000000"]
    assert run(call) == 2
    assert "poses: expected at most 100000, found 1000000000" in capsys.readouterr().err


@pytest.mark.parametrize("harm", [b"\r", b"," + b"x" * 1_000_000], ids=["carriage return", "a million characters"])
def test_text_that_is_no_table_is_refused(harm: bytes, every: tuple[Path, dict], tmp_path: Path) -> None:
    folder, _ = every
    good = (folder / "arm" / "poses.csv").read_bytes()
    (tmp_path / "campaign.toml").write_bytes((folder / "arm" / "campaign.toml").read_bytes())
    spoiled = good.replace(b"\n", harm) if harm == b"\r" else good.replace(b"\n", harm + b"\n", 1)
    (tmp_path / "poses.csv").write_bytes(spoiled)
    with pytest.raises(CampaignError, match=r"poses\.csv"):
        read_campaign(tmp_path)


@pytest.mark.parametrize("encoding", ["rot13", "hex", "none-such", "utf-7\u0000", "undefined"])
def test_an_encoding_that_is_none_is_refused(encoding: str, every: tuple[Path, dict], tmp_path: Path) -> None:
    folder, known = every
    good, at, read = known["mapping"]
    try:
        quoted = json.dumps(encoding)
        (folder / at).write_bytes(good.replace(b"delimiter =", f"encoding = {quoted}\ndelimiter =".encode(), 1))
        with pytest.raises(CampaignError):
            read(folder / at)
    finally:
        (folder / at).write_bytes(good)


@pytest.mark.parametrize("text", ["1e99999999", "1/0", "1e999", "--1", "", "1_0", "\u0661", "9" * 30])
def test_a_fraction_that_takes_for_ever_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected a number"):
        fraction_of(text)


@pytest.mark.parametrize("place", ["/dev/zero", "/dev/urandom", "/dev/tty", "/"])
def test_a_device_or_a_folder_is_no_file(place: str) -> None:
    for read in (load_robot, load_model, read_campaign):
        with pytest.raises((DescriptionError, ValueError)):
            read(place)


@pytest.mark.parametrize("text", ["x = " + "[" * 100_000, "x = " + "{a=" * 100_000, "x = " + "9" * 5000])
def test_nesting_ends_no_parser(text: str, tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text(text)
    with pytest.raises(DescriptionError):
        load_robot(tmp_path / "robot.toml")
    (tmp_path / "campaign.toml").write_text(text)
    with pytest.raises(CampaignError, match="TOML"):
        read_campaign(tmp_path)


def test_an_error_is_one_line_of_bounded_length(tmp_path: Path, capsys) -> None:
    (tmp_path / "campaign.toml").write_text(f"{'a' * 200_000} = 1\n")
    with suppress(SystemExit):
        assert run(["check", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert len(said) < 5000


def test_a_clock_in_nanoseconds_is_refused(tmp_path: Path) -> None:
    simulate(tmp_path / "arm", "ur10", seed=3, tables=("free_air",))
    table = pd.read_parquet(tmp_path / "arm" / "free_air.parquet")
    table.assign(time_s=1e-9 * table["time_s"]).to_parquet(tmp_path / "arm" / "free_air.parquet")
    with pytest.raises(CampaignError, match="column time_s: expected seconds"):
        read_campaign(tmp_path / "arm")
