"""Every verb that prints something, on streams that are not UTF-8: it ends as elsewhere, and its result is there."""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import typer

from clampid.cli import app, run
from clampid.loop.demo import demo
from clampid.verbs.streams import any_encoding, spelt
from experiments.campaign import write_campaign
from experiments.simulate import simulate
from kinematics.description import load_robot
from kinematics.poe import forward

ENCODINGS = ["ascii", "cp1252"]
TIP = [0.1, 0.0, 0.12]
PEAKS = "".join(f"{g},{d},0.8,{np.arccos(np.cos(g) * np.cos(d)):.6f},1e-4\n" for g in (0.1, 0.3) for d in (0.1, 0.2))
POSITION = ["--gamma", "0.3", "--delta", "0.2", "--r", "0.8"]
MAPPING = """format = "clampid-mapping/1"
table = "poses"
[columns]
pose = {from = "pose"}
target = {value = "T1"}
q1 = {from = "q1_rad", unit = "rad"}
q2 = {from = "q2_rad", unit = "rad"}
q3 = {from = "q3_rad", unit = "rad"}
q4 = {from = "q4_rad", unit = "rad"}
q5 = {from = "q5_rad", unit = "rad"}
q6 = {from = "q6_rad", unit = "rad"}
x = {from = "x_m", unit = "m"}
y = {from = "y_m", unit = "m"}
z = {from = "z_m", unit = "m"}
[campaign]
robot = "ur10"
gravity_m_s2 = [0.0, 0.0, -9.81]
tool = {mass_kg = 12.0, com_m = [0.0, 0.0, 0.08]}
targets_m = {T1 = [0.10, 0.00, 0.12]}
instrument = {name = "Lasertracker süd", position_std_m = 5e-5}
"""
CALLS: dict[str, list[list[str]]] = {
    "check": [["arm"], ["arm", "--verbose"], ["arm", "--iso9283"], ["arm", "--json", "-"]],
    "identify": [["arm", "-o", "{}.json", "--effects", "poses=geometry,backlash", "--verbose"]],
    "compare": [["m.json", "arm", "--verbose"], ["m.json", "arm", "--json", "-"]],
    "diagnose": [["m.json", "arm", "--verbose"]],
    "add": [["gear_eccentricity@joint2", "g.json", "arm", "-o", "{}.json", "--verbose"]],
    "history": [["m.json"], ["m.json", "--json", "-"]],
    "undo": [["m.json", "arm", "-o", "{}.json"]],
    "report": [["m.json", "arm", "-o", "{}.html"]],
    "export dh": [["m.json"], ["m.json", "-o", "{}.csv"]],
    "export urdf": [["m.json", "-o", "{}.urdf"]],
    "export angles": [["m.json"], ["m.json", "-o", "{}.csv"]],
    "export kuka": [["k.json"], ["k.json", "-o", "{}.dat"]],
    "export dynamics": [["torques.json"], ["torques.json", "-o", "{}.json"]],
    "base": [["around", "--rigid"]],
    "effects": [[], ["backlash"], ["--json", "-"]],
    "effect new": [["mine", "--depends-on", "q4", "--at", "joint4", "-o", "{}.py"]],
    "effect trust": [["own.py"]],
    "robots": [[], ["kuka_kr20_r1810"], ["staubli_tx40"], ["--json", "-"]],
    "simulate": [["--robot", "ur10", "--poses", "8", "--tables", "poses", "-o", "{}"]],
    "import": [["map.toml", "p.csv", "-o", "{}"]],
    "plan free-air": [["--time", "60", "-o", "{}.toml", "--verbose"]],
    "plan wrist": [["--time", "60", "-o", "{}.toml", "--verbose"]],
    "plan clamping": [["--time", "1500", "--joints", "1", "-o", "{}.toml", "--verbose"]],
    "plan poses": [["--poses", "12", "--verification", "2", "--replicates", "1", "-o", "{}.toml", "--verbose"]],
    "plan iso9283": [["--cube", "1.2,0,0.9,0.3", "-o", "{}.toml", "--verbose"]],
    "plan line": [["--from", "1.1,-0.2,0.9", "--to", "1.1,0.2,0.9", "-o", "{}.toml", "--verbose"]],
    "plan fixed-point": [["-o", "{}.toml", "--verbose"]],
    "plan warm-up": [["--hours", "0.2", "-o", "{}.toml", "--verbose"]],
    "run": [["still.toml", "-o", "{}", "--dry-run", "--verbose"]],
    "ik": [["m.json", *POSITION], ["m.json", *POSITION, "--json", "-"]],
    "sample": [["m.json", "peaks.csv"]],
    "serve": [["m.json", "--listen", "nowhere"]],
    "link-files": [["-o", "{}"]],
    "virtual-robot": [["--listen", "nowhere"]],
}
LONG = {
    "demo": ["--out", "{}"],
    "auto": ["arm", "-o", "{}.json"],
    "worked-example": ["--out", "{}"],
}
SECONDS = {"plan free-air", "plan wrist", "diagnose"}  # 6 to 18 s each: in one encoding only
REFUSED = {"serve", "virtual-robot"}  # otherwise they answer until they are stopped


def leaves() -> set[str]:
    program: Any = typer.main.get_command(app())
    return {
        f"{name} {second}".strip()
        for name, verb in program.commands.items()
        for second in (verb.commands if hasattr(verb, "commands") else [""])
    }


def around() -> pd.DataFrame:
    """Points of the first target while joint 1, then joint 2 turns alone, of a rigid robot."""
    robot = load_robot("ur10")
    q = np.tile([0.2, -1.0, 1.2, 0.1, 0.3, 0.2], (16, 1))
    q[:8, 0], q[8:, 1] = np.linspace(-2, 2, 8), np.linspace(-2, 0.4, 8)
    points = (forward(robot.screws, robot.flange, q) @ np.r_[TIP, 1.0])[:, :3]
    columns = {f"q{i + 1}_rad": q[:, i] for i in range(6)} | {f"dir{i + 1}": 1 for i in range(6)}
    columns |= dict(zip(("x_m", "y_m", "z_m"), points.T, strict=True))
    return pd.DataFrame({"pose": np.arange(1, 17), "visit": 1, "time_s": np.arange(16.0), "target": "T1", **columns})


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Inputs of all verbs, in a folder whose name no ASCII has."""
    folder = tmp_path_factory.mktemp("Prüfstand")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("XDG_CONFIG_HOME", str(folder / "config"))
        patch.setenv("COLUMNS", "100")
        simulate(folder / "arm", "ur10", ["gear_eccentricity@joint2:3"], seed=3, poses=40, tables=("poses",))
        simulate(folder / "logs", "ur10", seed=3, tables=("free_air",))
        simulate(folder / "kr", seed=3, poses=16, tables=("poses",))
        for campaign, model in (("arm", "g.json"), ("kr", "k.json"), ("logs", "torques.json")):
            assert run(["identify", campaign, "-o", model, "-q"]) == 0
        assert run(["add", "gear_eccentricity@joint2", "g.json", "arm", "-o", "m.json", "-q"]) == 0
        (folder / "map.toml").write_text(MAPPING, encoding="utf-8")
        poses = pd.read_parquet(folder / "arm" / "poses.parquet")
        poses[poses["target"] == "T1"].drop_duplicates("pose").to_csv(folder / "p.csv", index=False)
        header = {
            "robot": "ur10", "gravity_m_s2": [0.0, 0.0, -9.81], "tool": {"mass_kg": 0.0, "com_m": [0.0, 0.0, 0.0]},
            "targets_m": {"T1": TIP}, "instrument": {"name": "none", "position_std_m": 1e-5},
        }  # fmt: skip
        write_campaign(folder / "around", header, {"poses": around()}, "csv")
        (folder / "peaks.csv").write_text("gamma_rad,delta_rad,r_m,two_theta_rad,std_two_theta_rad\n" + PEAKS)
        (folder / "own.py").write_text("EFFECT = 1\n")
        assert run(["plan", "fixed-point", "-o", "still.toml", "-q"]) == 0
        yield folder


def printed(call: list[str], encoding: str, monkeypatch: pytest.MonkeyPatch) -> tuple[int, bytes, bytes]:
    """The exit code and what went to both streams, as the interpreter makes them of such an encoding."""
    out, err = io.BytesIO(), io.BytesIO()
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", io.TextIOWrapper(out, encoding=encoding, errors="strict"))
        patch.setattr(sys, "stderr", io.TextIOWrapper(err, encoding=encoding, errors="strict"))
        any_encoding()
        code = run(call)
        sys.stdout.flush()
        sys.stderr.flush()
        return code, out.getvalue(), err.getvalue()


def calls_of(verb: str, name: str) -> list[list[str]]:
    return [[*verb.split(), *(part.format(f"{name}-{k}-ö") for part in one)] for k, one in enumerate(CALLS[verb])]


def test_every_verb_is_among_these() -> None:
    assert leaves() == set(CALLS) | set(LONG)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("verb", "encoding"), [(verb, one) for verb in CALLS for one in ENCODINGS[: 1 if verb in SECONDS else 2]]
)
def test_a_verb_ends_as_elsewhere_and_says_its_result(
    verb: str, encoding: str, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for call in calls_of(verb, f"{verb.replace(' ', '-')}-{encoding}"):
        code, out, err = printed(call, encoding, monkeypatch)
        assert code == (2 if verb in REFUSED else 0), (call, err)
        assert b"Traceback" not in err
        if verb in REFUSED:
            assert len(err.splitlines()) == 1
        elif call[-1] == "-":
            assert json.loads(out.decode("utf-8"))
        else:
            text = out.decode(encoding if "-o" in call or not verb.startswith("export") else "utf-8")
            assert len(text.split()) > 10
            assert "?" not in text  # nothing is printed that cannot be spelt


@pytest.mark.parametrize("verb", ["check", "compare", "plan warm-up", "history"])
def test_what_is_said_is_what_is_said_in_utf8_spelt(verb: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    call = calls_of(verb, "spelt")[0]
    whole = printed([*call, "--force"], "utf-8", monkeypatch)[1].decode()
    assert not whole.isascii()
    assert printed([*call, "--force"], "ascii", monkeypatch)[1].decode() == spelt(whole)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("verb", sorted({*CALLS, *LONG}))
def test_help_is_said(verb: str, encoding: str, monkeypatch: pytest.MonkeyPatch) -> None:
    code, out, err = printed([*verb.split(), "--help"], encoding, monkeypatch)
    assert (code, err) == (0, b"")
    assert b"Usage: clampid " + verb.encode() in out


@pytest.mark.parametrize(
    "verb", [pytest.param(v, marks=pytest.mark.study if v == "demo" else pytest.mark.slow) for v in LONG]
)
def test_a_verb_of_minutes_does_the_same(verb: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The demo with fewer poses, as its words are the same; that of all its poses is run by test_demo."""
    monkeypatch.setattr("clampid.loop.demo.demo", partial(demo, poses=60))
    code, out, err = printed([verb, *(part.format(f"{verb}-ö") for part in LONG[verb])], "ascii", monkeypatch)
    assert code == 0, err
    assert len(out.split()) > 10
    assert b"?" not in out
