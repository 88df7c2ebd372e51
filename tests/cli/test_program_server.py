"""The command that tests call in the place of the installed one does what that does."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path

import pytest
from cli_runner import Clampid


@pytest.mark.parametrize(
    "call",
    [
        ("robots",),
        ("effects", "backlash", "--json", "-"),
        ("effects", "gear_eccentrcity"),
        ("check", "nowhere"),
        ("effect", "trust", "ö.py"),
        ("--nonsense", ""),
    ],
    ids=" ".join,
)
def test_streams_and_codes_are_those_of_the_installed_command(
    call: tuple[str, ...], clampid: Clampid, installed: Clampid, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    (tmp_path / "ö.py").write_text("EFFECT = 1\n")
    assert clampid(*call, cwd=tmp_path) == installed(*call, cwd=tmp_path)


def test_calls_run_beside_each_other_and_a_killed_one_takes_its_process_with_it(program: Path, tmp_path: Path) -> None:
    pipe = tmp_path / "table.csv"
    os.mkfifo(pipe)
    with subprocess.Popen([program, "import", pipe, pipe, "-o", tmp_path / "new"], stderr=subprocess.DEVNULL) as first:
        reading = os.open(pipe, os.O_WRONLY)  # as soon as it reads
        assert subprocess.run([program, "robots"], capture_output=True, check=True).stdout
        first.send_signal(signal.SIGKILL)
    until = time.monotonic() + 20.0
    while is_read(reading) and time.monotonic() < until:
        time.sleep(0.05)
    assert not is_read(reading)
    os.close(reading)


def is_read(pipe: int) -> bool:
    """Whether somebody reads from a pipe that is written to."""
    with suppress(BrokenPipeError):
        os.write(pipe, b"\n")
        return True
    return False
