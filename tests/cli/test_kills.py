"""Killed at any moment, or writing at the same time as another: an output is the old one or a new one, and whole."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from pathlib import Path

from experiments.outputs import new_file, write_bytes

WRITER = """
import sys
from experiments.outputs import write_bytes
k = int(sys.argv[2])
print("ready", flush=True)
while True:
    write_bytes(sys.argv[1], b"%d\\n" % k * 200_000)
    k += 2
"""
ROOT = Path(__file__).parents[2]


def writer(path: Path, first: int) -> subprocess.Popen[str]:
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    found = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path), str(first)], stdout=subprocess.PIPE, text=True, env=env
    )
    assert found.stdout is not None
    assert found.stdout.readline() == "ready\n"
    return found


def is_whole(path: Path) -> bool:
    lines = path.read_bytes().split(b"\n")
    return len(lines) == 200_001 and len(set(lines[:-1])) == 1


def test_two_writers_that_are_killed_leave_a_whole_file(tmp_path: Path) -> None:
    rng, path = random.Random(0), tmp_path / "out.txt"
    for k in range(12):
        pair = [writer(path, 2 * k), writer(path, 2 * k + 1)]
        time.sleep(rng.uniform(0.02, 0.2))
        for one in pair:
            one.kill()
            one.wait()
            assert one.stdout is not None
            one.stdout.close()
        assert not path.exists() or is_whole(path)
    assert is_whole(path)
    write_bytes(path, b"the next writer\n")  # takes away what the killed ones left
    assert [p.name for p in tmp_path.iterdir()] == ["out.txt"]


def test_what_a_writer_that_runs_has_beside_it_stays(tmp_path: Path) -> None:
    with new_file(tmp_path / "out.txt") as partial:
        write_bytes(tmp_path / "out.txt", b"other\n")
        assert partial.exists()
        partial.write_text("mine\n")
    assert (tmp_path / "out.txt").read_text() == "mine\n"
    assert [p.name for p in tmp_path.iterdir()] == ["out.txt"]
