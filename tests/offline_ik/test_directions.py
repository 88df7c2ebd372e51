"""From which side joints come, where the user says so: what is solved, through which point, and what is said of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from clampid.cli import app
from offline_ik.cell.checks import check_directions
from offline_ik.errors import TargetError
from offline_ik.inverse.detector import Detector
from offline_ik.motion.approach import BACK, approach_through
from offline_ik.motion.ways import ways_to
from offline_ik.server.protocol import Session, Speaker

HERE = (0.3, 0.2, 0.8)
NEAR = np.array([0.1, -1.2, 1.2, 0.1, 0.4, 0.0])
SIDES = np.array([1.0, -1.0, 1.0, 1.0, -1.0, -1.0])


def off(detector: Detector, q: np.ndarray, direction: np.ndarray) -> float:
    """How far the detector is from where it was asked to be, if the joints come from these sides, m."""
    wanted = detector.locate(*HERE, near=NEAR).target
    there = detector.pose(q[None], replace(detector.still, direction=direction))[0]
    return float(np.linalg.norm(there[:3, 3] - wanted[:3, 3]))


def test_the_posture_is_that_of_the_asked_sides(detector: Detector) -> None:
    for sides in (SIDES, -SIDES):
        solution = detector.locate(*HERE, near=NEAR, direction=sides).solutions[0]
        assert solution.direction.tolist() == sides.tolist()
        assert off(detector, solution.q, sides) < 1e-8
        assert off(detector, solution.q, -sides) > 1e-6  # the wrist's friction: gravity holds the rest
        assert solution.uncertainty.approach_m == 0.0


def test_the_approach_comes_from_the_asked_sides_and_leaves_the_rest_to_gravity(detector: Detector) -> None:
    answer = detector.locate(*HERE, near=NEAR)
    usual = approach_through(detector, answer)
    half = np.where(np.arange(6) < 3, -usual.direction, 0.0)
    way = approach_through(detector, answer, direction=half)
    assert way.direction.tolist() == [*(-usual.direction[:3]), *usual.direction[3:]]
    end = way.answer.solutions[0]
    assert np.allclose(end.q - way.through, BACK * way.direction, atol=1e-12)
    assert end.direction.tolist() == way.direction.tolist()
    assert off(detector, end.q, way.direction) < 1e-8
    assert way.to_json()["direction_asked"] == half.tolist()


def test_a_limit_in_the_way_of_an_asked_side_is_said(detector: Detector) -> None:
    answer = detector.locate(*HERE, near=NEAR)
    narrow = detector.within(replace(detector.cell, running=1.0))
    narrow.lower = np.where(np.arange(6) == 1, answer.solutions[0].q[1] - 0.01, detector.lower)
    assert approach_through(narrow, answer).direction[1] == -1.0  # chosen, it gives way
    with pytest.raises(TargetError, match=r"A2 cannot come from below: it is 0\.01 rad from its limit"):
        approach_through(narrow, answer, direction=[0, 1, 0, 0, 0, 0])


def test_what_is_against_a_straight_move_is_said(detector: Detector) -> None:
    q = detector.locate(*HERE, near=NEAR).solutions[0].q
    sides = np.sign(q - NEAR)
    sides[[0, 3]] *= -1
    answer = detector.locate(*HERE, near=NEAR, direction=sides)
    ways = ways_to(detector, answer, start=NEAR, direction=sides)
    assert ways.against == ("A1", "A4")
    assert "A1, A4: a straight move" in ways.to_json()["notes"][-1]
    assert ways.to_json()["direction_from"] == "asked"
    through = ways_to(detector, answer, start=NEAR, direction=sides, approach=True)
    assert through.against == ()
    assert through.to_json()["direction_from"] == "approach"
    assert through.to_json()["approach"]["direction"] == sides.tolist()
    moved = ways_to(detector, detector.locate(*HERE, near=NEAR, direction="moved"), start=NEAR)
    assert (moved.came, moved.against) == ("moved", ())
    assert ways_to(detector, detector.locate(*HERE)).came == "unknown"


def test_another_posture_in_place_of_a_refused_one_comes_from_the_asked_sides(detector: Detector) -> None:
    near = np.array([0.5, -0.2, 1.2, 3.0, -1.4, 0.0])  # from here the nearest way is through the sample stage
    answer = detector.locate(0.3, 0.2, 0.4, near=near, direction=SIDES)
    ways = ways_to(detector, answer, start=near, direction=SIDES)
    assert ways.refused
    assert ways.chosen[0].solution.direction.tolist() == SIDES.tolist()


@pytest.mark.parametrize("wrong", [[1, 1], [1, 2, 1, 1, 1, 1], [0.5] * 6, [np.nan] * 6])
def test_directions_that_are_none_are_refused(wrong: list[float]) -> None:
    with pytest.raises(TargetError, match="expected 6 numbers 1, -1 or 0"):
        check_directions(6, wrong)


def test_the_server_takes_directions(detector: Detector) -> None:
    def say(line: str) -> dict:
        return dict(json.loads(Speaker(detector).answer(line.encode(), Session(greeted=True))))

    sides, near = ",".join(f"{s:.0f}" for s in SIDES), ",".join(map(str, NEAR))
    place = "gamma=0.3 delta=0.2 r=0.8"
    for line in (f"where {place} near={near} direction={sides}", f"path {place} from={near} direction={sides}"):
        found = say(line)
        assert found["solutions"][0]["approach_direction"] == SIDES.tolist()
        assert found["direction_from"] == "asked"
    found = say(f"where {place} near={near} direction=0,0,0,1,0,0 approach=yes")
    assert found["approach"]["direction"][3] == 1.0
    assert found["direction_from"] == "approach"
    assert say(f"where {place} near={near}")["direction_from"] == "moved"
    assert say(f"where {place}")["direction_from"] == "unknown"
    found = say(f"where {place} near={near} direction={sides} roll=free")
    assert found["solutions"][0]["approach_direction"] == SIDES.tolist()
    assert found["direction_from"] == "asked"
    refused = say(f"where {place} direction=1,1")
    assert refused["ok"] is False
    assert "expected 6 numbers 1, -1 or 0" in refused["error"]


@pytest.mark.slow
def test_the_command_says_from_which_side(model_file: Path, cell_file: Path, tmp_path: Path) -> None:
    out, sides = tmp_path / "ik.json", ",".join(f"{s:.0f}" for s in SIDES)
    given = ["ik", str(model_file), "--cell", str(cell_file), "--gamma", "0.3", "--delta", "0.2", "--r", "0.8"]
    done = CliRunner().invoke(app(), [*given, "--direction", sides, "--json", str(out), "--verbose"])
    assert done.exit_code == 0, done.output
    assert "joints come + - + + - - (as asked)" in " ".join(done.output.split())
    data = json.loads(out.read_text(encoding="utf-8"))
    assert data["solutions"][0]["approach_direction"] == SIDES.tolist()
    assert data["direction_from"] == "asked"
    done = CliRunner().invoke(app(), [*given, "--verbose"])
    assert "joints come from unknown sides" in done.output
    assert isinstance(CliRunner().invoke(app(), [*given, "--direction", "1,2"]).exception, TargetError)
