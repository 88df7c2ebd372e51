"""Verbs on spoilt inputs; run as a program it says what ended otherwise than right, or with 2 and one line.

A campaign that states all that can be stated, a model with its diagnosis, a robot's description and touches: each is
spoilt and given to the verbs that read it.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import resource
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from readers import most_memory
from spoil import misstated, spoilt

ROOT = Path(__file__).parents[2]
SECONDS = 20.0
STATED = """
[base]
position_m = {position}
rpy_rad = {rpy}
position_std_m = 0.01
rpy_std_rad = [1e-2, 1e-2, inf]
[targets_std_m]
T1 = 1e-3
T2 = [1e-3, 2e-3, 3e-3]
[[distance]]
between = ["T1", "T2"]
value_m = {apart}
std_m = 1e-3
[sensors]
link1 = {{at = "link3"}}
ambient = {{at = "ambient", weight = 0.5}}
"""
TIP = [0.1, 0.0, 0.12]
TOUCHED = f"""format = "clampid-touched/1"
robot = "ur10"
gravity_m_s2 = [0.0, 0.0, -9.81]
touches = "touches.csv"
tip_std_m = 1e-5
start_m = [0.0, 0.0, 0.0]
start_rad = [0.0, 0.0, 0.0]
[targets_m]
tip = {TIP}
[instrument]
position_std_m = 2e-5
"""


def stated(arm: Path) -> str:
    """What can be stated of a campaign: its base, from the nominal robot, and a distance."""
    from scipy.spatial.transform import Rotation

    from experiments.campaign import read_campaign
    from kinematics.poe import forward

    campaign = read_campaign(arm)
    rows, targets = campaign.tables["poses"], campaign.targets
    q = rows[[f"q{i + 1}_rad" for i in range(campaign.robot.n)]].to_numpy()
    flange = forward(campaign.robot.screws, campaign.robot.flange, q)
    points = np.array([(pose @ np.r_[targets[t], 1.0])[:3] for pose, t in zip(flange, rows["target"], strict=True)])
    seen = rows[["x_m", "y_m", "z_m"]].to_numpy()
    turn, _ = Rotation.align_vectors(seen - seen.mean(axis=0), points - points.mean(axis=0))
    position = seen.mean(axis=0) - turn.apply(points.mean(axis=0))
    apart = float(np.linalg.norm(targets["T1"] - targets["T2"]))
    return STATED.format(position=position.tolist(), rpy=turn.as_euler("xyz").tolist(), apart=apart)


def circles(folder: Path) -> None:
    """Circles of joints 1 and 2 that a rigid robot traces, as a campaign; and touches of points, with their file."""
    from experiments.campaign import write_campaign
    from kinematics.description import load_robot
    from kinematics.poe import forward

    robot, rng = load_robot("ur10"), np.random.default_rng(0)
    q = np.tile([0.2, -1.0, 1.2, 0.1, 0.3, 0.2], (16, 1))
    q[:8, 0], q[8:, 1] = np.linspace(-2, 2, 8), np.linspace(-2, 0.4, 8)
    place = (forward(robot.screws, robot.flange, q) @ np.r_[TIP, 1.0])[:, :3]
    table = pd.DataFrame({"pose": np.arange(1, 17), "visit": 1, "time_s": 10.0 * np.arange(16)})
    table[[f"q{i + 1}_rad" for i in range(6)]] = q
    table[[f"dir{i + 1}" for i in range(6)]] = 1
    table["target"] = "T1"
    table[["x_m", "y_m", "z_m"]] = place
    header = {
        "robot": "ur10", "gravity_m_s2": [0.0, 0.0, -9.81], "tool": {"mass_kg": 0.0, "com_m": [0.0, 0.0, 0.0]},
        "targets_m": {"T1": TIP}, "instrument": {"name": "none", "position_std_m": 1e-5},
    }  # fmt: skip
    write_campaign(folder / "circles", header, {"poses": table}, "csv")
    q = rng.uniform(-1, 1, (6, 6)) + np.array([0.0, -1.0, 1.2, 0.1, 0.3, 0.2])
    there = (forward(robot.screws, robot.flange, q) @ np.r_[TIP, 1.0])[:, :3]
    table = pd.DataFrame({f"q{i + 1}_rad": q[:, i] for i in range(6)})
    table.assign(feature=[f"p{k}" for k in range(6)]).to_csv(folder / "touches.csv", index=False)
    features = (f'[features.p{k}]\nkind = "point"\npoint_m = {p.tolist()}\n' for k, p in enumerate(there))
    (folder / "touched.toml").write_text(TOUCHED + "".join(features))


def inputs(folder: Path) -> dict[str, tuple[str, list[list[str]]]]:
    """Name → a file that verbs read, and calls with it; outputs go to the folder ``out``."""
    from clampid.cli import run
    from experiments.simulate import simulate

    arm = simulate(folder / "arm", "ur10", seed=3, poses=24, tables=("poses",), file_format="csv")
    circles(folder)
    with (arm / "campaign.toml").open("a") as header:
        header.write(stated(arm))
    os.chdir(folder)
    (folder / "out").mkdir()
    assert run(["identify", "arm", "-o", "model.json", "-q"]) == 0
    assert run(["diagnose", "model.json", "arm", "-q"]) == 0
    (folder / "robot.toml").write_bytes((ROOT / "appendix_data" / "robots" / "kuka_kr20_r1810.toml").read_bytes())
    report = ["report", "model.json", "arm", "-o", "out/r.html"]
    base = ["base", "touched.toml", "--rigid", "--json", "out/base.json"]
    rigid = ["base", "circles", "--rigid", "--json", "out/base.json"]
    dh = ["export", "dh", "model.json", "-o", "out/dh.csv"]
    return {
        "model": ("model.json", [["history", "model.json"], dh, report]),
        "diagnosis": ("model.diagnosis.json", [report]),
        "campaign": ("arm/campaign.toml", [["check", "arm"], report]),
        "poses": ("arm/poses.csv", [["check", "arm"], report]),
        "circles": ("circles/campaign.toml", [rigid]),
        "circles' points": ("circles/poses.csv", [rigid]),
        "robot": ("robot.toml", [["robots", "robot.toml", "--svg", "out/r.svg", "--json", "out/r.json"]]),
        "touched": ("touched.toml", [base]),
        "touches": ("touches.csv", [base]),
    }


def ended(call: list[str]) -> tuple[int, str]:
    """The exit code of a call, and what it said to standard error."""
    from clampid.cli import run

    said, printed = io.StringIO(), io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(printed):
        code = run([*call] if call[0] in ("history", "robots", "check") else [*call, "-q"])
    return code, said.getvalue()


def outcomes(names: list[str], count: int, seed: int) -> Iterator[dict[str, Any]]:
    """Call verbs with spoilt inputs; what was bad, and the counts of each input."""

    def late(*_: object) -> None:
        raise TimeoutError(f"no answer within {SECONDS:g} s")

    signal.signal(signal.SIGALRM, late)
    with tempfile.TemporaryDirectory() as place:
        every = inputs(Path(place))
        for name in names or list(every):
            file, calls = Path(every[name][0]), every[name][1]
            good, counts, slowest = file.read_bytes(), Counter[str](), 0.0
            for call in calls:  # as they are, they are read
                assert ended(call)[0] == 0, ended(call)
            for k in range(count):
                number, call = seed * 1_000_003 + k, calls[k // 2 % len(calls)]
                data = misstated(good, number, file.name) if k % 4 else spoilt(good, number)
                file.write_bytes(data)
                before = _hashes()
                print(json.dumps({"trying": name, "seed": number, "call": call}), flush=True)
                begun = time.monotonic()
                signal.setitimer(signal.ITIMER_REAL, SECONDS)
                try:
                    code, said = ended(call)
                except BaseException as error:  # what a user would see as a traceback
                    code, said = -1, f"{type(error).__name__}: {error}"
                finally:
                    signal.setitimer(signal.ITIMER_REAL, 0)
                slowest = max(slowest, time.monotonic() - begun)
                lines = [line for line in said.splitlines() if line.startswith("clampid: ")]
                fine = code == 0 or (code == 2 and len(lines) == 1 and len(said) < 6000)
                counts["right" if code == 0 else "refused" if fine else "bad"] += 1
                if not fine or "Traceback" in said:
                    yield {"input": name, "seed": number, "call": call, "code": code, "error": said[-600:]}
                if _hashes() != before:
                    yield {"input": name, "seed": number, "call": call, "error": "an input was changed"}
            file.write_bytes(good)
            yield {"counts": name, **counts, "slowest_s": round(slowest, 2), "memory_MB": most_memory()}


def _hashes() -> dict[str, str]:
    """Of every file but the outputs."""
    return {
        str(p): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in Path().rglob("*")
        if p.is_file() and p.parts[0] != "out"
    }


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for found in outcomes(sys.argv[3:], int(sys.argv[1]), int(sys.argv[2])):
        print(json.dumps(found), flush=True)
