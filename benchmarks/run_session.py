"""A whole session on the virtual robot, over sockets, with nothing but commands of this suite.

An effect is hidden by one program (``clampid virtual-robot --hide``). Free air, wrist, clamping, poses and verification
are planned and run into one folder; then identify, diagnose, add, compare and export. The commands are printed as they
run. ``python benchmarks/run_session.py FOLDER`` takes two to three minutes.
"""

from __future__ import annotations

import argparse
import json
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

HIDDEN = "gear_eccentricity@joint2:2"


PROGRAM = (sys.executable, "-m", "clampid")


def clampid(*words: str, code: int = 0) -> None:
    """Run a command, print it, and expect its exit code."""
    print(f"$ clampid {shlex.join(words)}", flush=True)
    start = time.monotonic()
    done = subprocess.run([*PROGRAM, *words], capture_output=True, text=True, check=False)
    print(done.stdout, end="")
    if done.returncode != code:
        raise RuntimeError(f"expected exit code {code}, found {done.returncode}: {done.stderr[-2000:]}")
    print(f"({time.monotonic() - start:.0f} s)\n", flush=True)


@contextmanager
def virtual_robot(folder: Path, hidden: str, seed: int) -> Iterator[dict[str, int]]:
    """The controller with an instrument and an operator; ports by name, and its process's number as ``process``."""
    words = ["virtual-robot", "--hide", hidden, "--seed", str(seed), "--truth", str(folder / "truth.json")]
    words += ["--listen", "127.0.0.1:0", "--tracker", "127.0.0.1:0", "--operator", "127.0.0.1:0"]
    print(f"$ clampid {shlex.join(words)} &")
    with subprocess.Popen([sys.executable, "-m", "clampid", *words], stdout=subprocess.PIPE, text=True) as process:
        ports: dict[str, int] = {}
        while len(ports) < 3:
            line = process.stdout.readline() if process.stdout else ""
            found = re.match(r"(\w+) on [\d.]+:(\d+)", line)
            if found is None:
                raise RuntimeError(f"the virtual robot ended: {line}")
            ports[found[1]] = int(found[2])
        try:
            yield {**ports, "process": process.pid}
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(20)


def faster(port: int, speed: float) -> None:
    """Simulated seconds in a second."""
    with socket.create_connection(("127.0.0.1", port), 10) as peer:
        peer.sendall(f"speed {speed:g}\n".encode())
        peer.recv(4096)


def session(folder: Path, hidden: str = HIDDEN, seed: int = 7, poses: int = 60) -> dict[str, Any]:
    """From an empty folder to the compensated table; what was found, and the errors."""
    at = {name: str(folder / name) for name in ("free_air.toml", "wrist.toml", "clamping.toml", "poses.toml")}
    clampid("plan", "free-air", "-o", at["free_air.toml"], "--time", "60", "-q")
    clampid("plan", "wrist", "-o", at["wrist.toml"], "--time", "60", "-q")
    clampid("plan", "clamping", "-o", at["clamping.toml"], "--time", "1500", "--joints", "2,3", "--dwell", "0.5", "-q")
    clampid("plan", "poses", "-o", at["poses.toml"], "--poses", str(poses), "--verification", "15",
            "--measure-time", "1", "-q")  # fmt: skip
    arm, model, mended = str(folder / "arm"), str(folder / "model.json"), str(folder / "mended.json")
    clampid("run", at["poses.toml"], "-o", arm, "--dry-run", "--json", str(folder / "dry.json"), "-q")
    with virtual_robot(folder, hidden, seed) as ports:
        link = f"eki://127.0.0.1:{ports['listening']}?torque=Nm"
        tracker, operator = f"tcp://127.0.0.1:{ports['tracker']}", f"127.0.0.1:{ports['operator']}"
        for plan, speed in (("free_air", 10), ("wrist", 10), ("clamping", 30), ("poses", 50)):
            faster(ports["operator"], speed)
            clampid("run", at[f"{plan}.toml"], "-o", arm, "--link", link, "--instrument", tracker,
                    "--operator", operator, "--yes", "-q")  # fmt: skip
    clampid("check", arm)
    clampid("identify", arm, "-o", model, "-q", "--json", str(folder / "model_fit.json"))
    clampid("diagnose", model, arm, "-q", "--json", str(folder / "found.json"))
    found = json.loads((folder / "found.json").read_text(encoding="utf-8"))["stages"]["poses"]
    confirmed = [c for c in found["candidates"] if not c["alternative"]]
    added = [f"poses={c['name']}@{place}" for c in confirmed for place in c["where"]]
    if not added:
        raise RuntimeError(f"diagnose found nothing that was missing: {found['summary']}")
    clampid("add", ",".join(added), model, arm, "-o", mended, "-q")
    for name, which in (("before", model), ("after", mended)):
        clampid("compare", which, arm, "-q", "--json", str(folder / f"{name}.json"))
    clampid("export", "dh", mended, "--convention", "hayati", "-o", str(folder / "dh.csv"))
    errors = {
        name: json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))["tables"]["poses"]["heldout"]["rms"]
        for name in ("before", "after")
    }
    floor = json.loads((folder / "after.json").read_text(encoding="utf-8"))["tables"]["poses"]["noise_floor"]
    return {"verdict": found["verdict"], "found": added, **errors, "noise_floor": floor}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--hide", default=HIDDEN)
    parser.add_argument("--seed", type=int, default=7)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    print(json.dumps(session(given.folder, given.hide, given.seed), indent=1))


if __name__ == "__main__":
    main()
