"""``clampid ik`` and ``clampid serve`` from the outside: output, JSON, exit codes."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from ik_arms import drawn_model
from program_server import INSTALLED
from typer.testing import CliRunner

from clampid.cli import app
from clampid.display import number, readable
from clampid.models.model import save_model
from offline_ik.inverse.assumed import assumed_in_words
from offline_ik.inverse.opening import open_detector

Run = Callable[..., subprocess.CompletedProcess[str]]
PLACE = ("--gamma", "0.3", "--delta", "0.2", "--r", "0.8")


@pytest.fixture
def run(program: Path) -> Run:
    def called(*args: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run([program, *map(str, args)], capture_output=True, text=True, check=False, timeout=300)

    return called


@pytest.mark.slow
def test_ik_gives_angles_for_people_and_for_programs(
    model_file: Path, cell_file: Path, tmp_path: Path, run: Run
) -> None:
    out = tmp_path / "ik.json"
    near = "0.1,-1.2,1.2,0.1,0.4,0"
    done = run(
        "ik",
        model_file,
        *PLACE,
        "--cell",
        cell_file,
        "--near",
        near,
        "--approach",
        "--pyfai",
        "--json",
        out,
        "--verbose",
    )
    assert done.returncode == 0, done.stderr
    assert "convention: thesis, gamma_outer" in done.stdout
    assert "joint 6" in done.stdout
    data = json.loads(out.read_text(encoding="utf-8"))
    assert data["reachable"] is True
    detector = open_detector(model_file, cell_file)
    q = np.array(data["solutions"][0]["q_rad"])
    from dataclasses import replace

    given = replace(detector.still, direction=np.array(data["solutions"][0]["approach_direction"], dtype=float))
    assert np.allclose(detector.pose(q[None], given)[0][:3, 3], data["detector_position_m"], atol=3e-9)
    assert data["path"]["safe"] in (True, False)
    assert data["approach"]["gain_m"] > 0
    assert data["pyfai"]["dist"] == pytest.approx(0.8)
    assert f"rot2 {data['pyfai']['rot2']:.9f}" in done.stdout
    assert data["convention"]["beam"][1] == pytest.approx(np.sqrt(0.5))
    assert data["notes"] == []


@pytest.mark.slow
def test_ik_says_how_far_off_in_every_direction_and_what_of_the_way_was_checked(
    model_file: Path, cell_file: Path, tmp_path: Path
) -> None:
    out, asked = tmp_path / "ik.json", ["ik", str(model_file), *PLACE, "--cell", str(cell_file)]

    def said(*more: str) -> tuple[str, dict]:
        done = CliRunner(env={"COLUMNS": "400"}).invoke(app(), [*asked, *more, "--json", str(out), "--verbose"])
        assert done.exit_code == 0, done.output
        return done.output, json.loads(out.read_text(encoding="utf-8"))

    text, data = said()
    solution = data["solutions"][0]
    across, up, along = solution["uncertainty"]["std_axes_m"]
    sphere = np.hypot(across, up)
    for value in (
        f"{readable(sphere, 'm')} along the sphere", f"({readable(sphere / 0.8, 'microrad')} as seen from the sample",
        f"{number(sphere / 55e-6)} pixels of 55 µm", f"{readable(along, 'm')} along the line of sight",
        f"{readable(np.linalg.norm(solution['uncertainty']['std_axes_rad']), 'microrad')} in orientation",
    ):  # fmt: skip
        assert value in text
    assert f"KUKA Status and Turn: S{solution['status']}T{solution['turn']}" in text
    assert "path: not checked: give the starting posture with --near" in text
    assert data["path"]["checked"] == "place"
    text, data = said("--approach")
    assert "from there on safe" in text
    assert data["path"]["checked"] == "approach"
    text, data = said("--approach", "--near", "0.1,-1.2,1.2,0.1,0.4,0")
    path = data["path"]
    assert f"path: safe: {' and '.join(path['between'])} come within {readable(path['least_distance_m'], 'm')}," in text
    assert f"axes 4 and 5 within {readable(path['forearm_to_base_m'], 'm')} of the base; " in text
    assert f"approach through {', '.join(f'{q:.6f}' for q in data['approach']['through_q_rad'])} rad" in text
    assert path["checked"] == "way"


def test_ik_reports_inputs_unused_by_the_model(cell_file: Path, tmp_path: Path, run: Run) -> None:
    model, out = tmp_path / "cold.json", tmp_path / "ik.json"
    save_model(drawn_model(effects=("geometry",)), model)
    done = run("ik", model, *PLACE, "--cell", cell_file, "--json", out)
    assert done.returncode == 0, done.stderr
    note = "the link temperatures are not used: no effect of this model depends on them"
    assert note in " ".join(done.stdout.split())
    assert json.loads(out.read_text(encoding="utf-8"))["notes"] == [note]


@pytest.mark.slow
def test_ik_checks_every_way_and_says_where_the_nearest_is_refused(
    model_file: Path, cell_file: Path, tmp_path: Path, run: Run
) -> None:
    out = tmp_path / "ik.json"
    asked = ("--gamma", "0.3", "--delta", "0.2", "--r", "0.4", "--near=0.5,-0.2,1.2,3,-1.4,0", "--cell", cell_file)
    done = run("ik", model_file, *asked, "--json", out)
    assert done.returncode == 0, done.stderr
    assert "the nearest posture is refused (sample stage" in " ".join(done.stdout.split())
    assert "the move is safe." in " ".join(done.stdout.split())
    data = json.loads(out.read_text(encoding="utf-8"))
    assert data["path"]["safe"] is True
    assert "sample stage" in data["refused"][0]["reasons"][0]
    done = run("ik", model_file, *asked, "--branch", "all", "--approach", "--json", out, "--verbose")
    assert done.returncode == 0, done.stderr
    solutions = json.loads(out.read_text(encoding="utf-8"))["solutions"]
    assert {s["path"]["safe"] for s in solutions} == {True, False}
    assert all(s["approach"]["gain_m"] > 0 for s in solutions)
    assert done.stdout.count("path: ") == len(solutions)


@pytest.mark.slow
def test_ik_without_a_cell_says_what_it_assumes(model_file: Path, run: Run) -> None:
    done = run("ik", model_file, *PLACE, "--json", "-")
    assert done.returncode == 0, done.stderr
    assert "assumed, because no cell file states it:\n" in done.stderr
    for what in ("sample: 1.432, 0, −0.017 m", "gravity: 0, 0, −9.81 m/s2", "links of 20 degC", "says: 12 kg"):
        assert f"{what}\n" in done.stderr
    assert "sample" in json.loads(done.stdout)["cell"]["assumed"]


@pytest.mark.parametrize(
    ("place", "says"),
    [
        (("--gamma", "30", "--delta", "0.2", "--r", "0.8"), "did you mean 30 degrees"),
        (("--gamma", "0.3", "--delta", "0.2", "--r", "800"), "did you mean 800 mm"),
        (("--gamma", "nan", "--delta", "0.2", "--r", "0.8"), "finite"),
        ((*PLACE, "--roll", "wide"), "--roll"),
        ((*PLACE, "--roll", "0.1,0.2"), "expected one angle"),
        ((*PLACE, "--near", "1,2,x"), "--near"),
        ((*PLACE, "--branch", "best"), "branch"),
        ((*PLACE, "--robot", "ur10"), "ur10"),
        ((*PLACE, "--cell", "no-such-cell.toml"), "no-such-cell.toml"),
    ],
)
def test_bad_input_is_one_clear_line_and_exit_2(model_file: Path, place: tuple[str, ...], says: str, run: Run) -> None:
    done = run("ik", model_file, *place, "--json", "-")
    assert done.returncode == 2, done.stderr
    assert says in done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr


def test_a_model_that_is_none_is_refused(tmp_path: Path, run: Run) -> None:
    path = tmp_path / "model.json"
    path.write_text("{}", encoding="utf-8")
    done = run("ik", path, *PLACE)
    assert done.returncode == 2
    assert str(path) in done.stderr


@pytest.mark.slow
def test_out_of_reach_is_said_with_the_nearest(model_file: Path, cell_file: Path, run: Run) -> None:
    done = run("ik", model_file, "--gamma", "0.3", "--delta", "0.2", "--r", "3", "--cell", cell_file)
    assert done.returncode == 0
    assert "The robot cannot put the detector there." in done.stdout
    assert "- out of reach by" in done.stdout
    assert "nearest  gamma" in done.stdout


@pytest.mark.slow
def test_serve_answers_until_interrupted(model_file: Path, cell_file: Path) -> None:
    command = [str(INSTALLED), "serve", str(model_file), "--cell", str(cell_file), "--listen", "127.0.0.1:0"]
    env = {**os.environ, "PYTHONUNBUFFERED": "1", "COLUMNS": "80"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env) as server:
        try:
            assert server.stdout is not None
            found = re.search(r"listening on (\S+):(\d+)", server.stdout.readline())
            assert found
            with socket.create_connection((found[1], int(found[2])), timeout=60) as client:
                client.sendall(b"where gamma=0.3 delta=0.2 r=0.8\nwhere gamma=30 delta=0.2 r=0.8\n")
                with client.makefile() as lines:
                    assert json.loads(lines.readline())["reachable"] is True
                    assert json.loads(lines.readline())["ok"] is False
        finally:
            server.send_signal(signal.SIGINT)
            try:
                _, errors = server.communicate(timeout=60)
            finally:
                server.kill()
    assert "Traceback" not in errors
    lines = errors.splitlines()
    assert len(lines) <= 8  # what is assumed is counted, not listed
    assert max(map(len, lines)) <= 80
    said = " ".join(errors.split())
    assert "nothing moves: there is no --link" in said
    assert re.search(r"[1-9]\d* quantit(y is|ies are) assumed.* because no cell file states", said)
    assert said.endswith("--verbose lists them.")


@pytest.mark.parametrize(
    ("assumed", "says"),
    [
        (("convention: thesis", "sample: 1, 0, 0 m", "tool at the flange"),
         "3 quantities are assumed, such as sample and tool, because no cell file states them."),
        (("no obstacles", "tool at the flange"),
         "2 quantities are assumed, such as tool, because no cell file states them."),
        (("no obstacles",), "1 quantity is assumed because no cell file states it."),
    ],
)  # fmt: skip
def test_what_is_assumed_is_counted_and_only_what_is_assumed_is_named(assumed: tuple[str, ...], says: str) -> None:
    assert assumed_in_words(assumed) == says


@pytest.mark.slow
@pytest.mark.parametrize(
    ("args", "says"),
    [
        (("--listen", "nowhere"), "HOST:PORT"),
        (("--link", "127.0.0.1:1"), "--link 127.0.0.1:1: "),
        (("--link", "abb://127.0.0.1:1"), "eki"),
    ],
)
def test_serve_refuses_what_it_cannot_do(model_file: Path, args: tuple[str, ...], says: str, run: Run) -> None:
    done = run("serve", model_file, *args)
    assert done.returncode == 2
    assert says in done.stderr


@pytest.mark.slow
def test_degrees_and_millimetres_are_the_same_position(
    model_file: Path, cell_file: Path, tmp_path: Path, run: Run
) -> None:
    """Given and printed in them; what programs get stays in radians and metres."""
    found = []
    near = np.array([0.1, -1.2, 1.2, 0.1, 0.4, 0.0])
    for options, factor, far in ((), 1.0, 0.8), (("--deg", "--mm"), 180.0 / np.pi, 800.0):
        out = tmp_path / f"{len(found)}.json"
        place = ("--gamma", 0.3 * factor, "--delta", 0.2 * factor, "--r", far, "--roll", 0.05 * factor)
        here = ",".join(map(str, (near * factor).tolist()))
        done = run(
            "ik", model_file, *place, "--cell", cell_file, f"--near={here}", "--json", out, *options, "--verbose"
        )
        assert done.returncode == 0, done.stderr
        found.append((json.loads(out.read_text(encoding="utf-8")), done.stdout))
    (radians, _), (degrees, said) = found
    assert np.allclose(degrees["solutions"][0]["q_rad"], radians["solutions"][0]["q_rad"], atol=1e-9)
    assert degrees["asked"]["roll_rad"] == pytest.approx(0.05)
    assert "r 800 mm" in said
    assert "joint / deg" in said
    first = np.degrees(radians["solutions"][0]["q_rad"][0])
    assert f"{first:.4f}" in said
    again = said[said.index("clampid ik") :]
    assert "--deg --mm" in " ".join(again.split())


@pytest.mark.slow
def test_out_of_reach_in_degrees_and_millimetres(model_file: Path, cell_file: Path, run: Run) -> None:
    done = run("ik", model_file, "--gamma", 17, "--delta", 11, "--r", 9000, "--deg", "--mm", "--cell", cell_file)
    assert re.search(r"nearest\s+gamma -?[\d.]+ deg, delta -?[\d.]+ deg, r [\d.]+ mm", " ".join(done.stdout.split()))
