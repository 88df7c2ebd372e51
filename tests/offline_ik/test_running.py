"""For how long the robot has been running, and which robot it is: used where said, and said where assumed."""

from __future__ import annotations

import asyncio
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ik_arms import CELL, drawn_model
from typer.testing import CliRunner

from clampid.cli import app
from clampid.models.model import save_model
from offline_ik.errors import CellError, DetectorError, TargetError
from offline_ik.inverse.assumed import SHIFT_SECONDS, moves_by, time_effects
from offline_ik.inverse.detector import Detector
from offline_ik.inverse.opening import open_detector
from offline_ik.server.protocol import Job, Session, Speaker
from offline_ik.server.server import Server
from offline_ik.verbs.options import seconds

HOUR = 3600.0
HERE = (0.3, 0.2, 0.8)
EFFECTS = ("geometry", "joint_compliance", "warm_up_expansion")
PLACE = ["--gamma", "0.3", "--delta", "0.2", "--r", "0.8"]


@pytest.fixture(scope="module")
def warming_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("warming") / "model.json"
    save_model(drawn_model(effects=EFFECTS), path)
    return path


@pytest.fixture(scope="module")
def warming(warming_file: Path, cell_file: Path) -> Detector:
    return open_detector(warming_file, cell_file)


@pytest.mark.slow
def test_the_answer_is_of_the_time_that_was_said(warming: Detector) -> None:
    """Every link of the drawn arm grows with a time constant of an hour."""
    q = warming.locate(*HERE).solutions[0].q
    at = {h: warming.at_running(h * HOUR).pose(q[None])[0][:3, 3] for h in (0.0, 1.0, 2.0, 1000.0)}
    assert np.allclose(at[0.0], warming.pose(q[None])[0][:3, 3], atol=1e-15)
    whole = np.linalg.norm(at[1000.0] - at[0.0])
    assert whole > 1e-5
    for hours in (1.0, 2.0):
        assert np.linalg.norm(at[hours] - at[0.0]) / whole == pytest.approx(1 - math.exp(-hours), rel=1e-3)
    later = warming.at_running(2 * HOUR)
    answer = later.locate(*HERE)
    assert np.abs(answer.solutions[0].q - q).max() > 1e-6
    assert np.allclose(later.pose(answer.solutions[0].q[None])[0], answer.target, atol=3e-9)
    assert answer.cell["running_s"] == 2 * HOUR
    assert moves_by(warming, q) == pytest.approx(
        np.linalg.norm(warming.at_running(SHIFT_SECONDS).pose(q[None])[0][:3, 3] - at[0.0])
    )
    # the uncertainty is that of the time as well: nothing has grown at the start
    grown = [
        k for k, slot in enumerate(warming.arm.slots) if (slot.effect, slot.parameter) == ("warm_up_expansion", "a")
    ]
    for detector, moves in ((warming, False), (later, True)):
        J, _ = detector.propagation.jacobian(q, detector.still)
        assert bool(np.abs(J[:, grown]).max() > 1e-3) is moves


def test_what_is_assumed_of_time_is_said(warming: Detector, detector: Detector) -> None:
    assert time_effects(warming.arm) == ("warm_up_expansion",)
    assert any(
        "no running time is stated: 0 s is assumed" in note and "warm_up_expansion" in note for note in warming.notes
    )
    assert not any("running time" in note for note in warming.at_running(0.0).notes)
    assert not any("running" in note for note in detector.notes)
    assert any("the running time is not used" in n for n in detector.at_running(60.0).notes)


def test_a_cell_file_says_it_too(warming_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(CELL.replace("[temperature]", "[temperature]\nrunning_s = 5400"), encoding="utf-8")
    assert open_detector(warming_file, path).still.elapsed == 5400.0
    path.write_text(CELL.replace("[temperature]", "[temperature]\nrunning_s = -1"), encoding="utf-8")
    with pytest.raises(CellError, match="running_s"):
        open_detector(warming_file, path)


@pytest.mark.parametrize("wrong", [-1.0, math.nan, math.inf, 1e12])
def test_a_time_that_is_none_is_refused(warming: Detector, wrong: float) -> None:
    with pytest.raises(TargetError, match="running: expected seconds"):
        warming.at_running(wrong)


def test_times_have_units() -> None:
    assert (seconds("t", "2.5h"), seconds("t", "90min"), seconds("t", "5400 s"), seconds("t", None)) == (
        9e3,
        5400,
        5400,
        None,
    )
    for wrong in ("2.5", "h", "2.5d", "two h", "1e", "--1s"):
        with pytest.raises(DetectorError, match="with its unit"):
            seconds("--running", wrong)


def test_the_servers_clock_goes_on(warming: Detector) -> None:
    now = [1000.0]
    speaker = Speaker(warming, clock=lambda: now[0])

    def say(line: str) -> dict:
        return dict(json.loads(speaker.answer(line.encode(), Session(greeted=True))))

    now[0] += 500.0
    assert say("state")["running_s"] == 0.0  # nobody said that it runs
    assert any("no running time is stated" in note for note in say("state")["notes"])
    first = say("where gamma=0.3 delta=0.2 r=0.8")["solutions"][0]["q_rad"]
    assert say("temperature running=3600")["running_s"] == 3600.0
    now[0] += 1800.0
    assert say("state")["running_s"] == 5400.0
    direct = warming.at_running(5400.0).locate(*HERE).solutions[0].q
    assert np.allclose(say("where gamma=0.3 delta=0.2 r=0.8")["solutions"][0]["q_rad"], direct, atol=1e-12)
    assert np.abs(np.subtract(first, direct)).max() > 1e-6
    refused = say("temperature running=-3")
    assert refused["ok"] is False
    assert say("state")["running_s"] == 5400.0
    started = Speaker(warming.at_running(60.0), clock=lambda: now[0])
    now[0] += 30.0
    assert json.loads(started.answer(b"state", Session(greeted=True)))["running_s"] == 90.0


@pytest.mark.slow
def test_the_servers_second_detector_is_at_the_same_time(warming: Detector) -> None:
    now = [1000.0]

    async def run() -> None:
        speaker = Speaker(warming, clock=lambda: now[0])
        server = Server(speaker)

        async def apart(line: bytes) -> list[float]:
            job = server.reply(line, Session(greeted=True))
            assert isinstance(job, Job)
            done = server.compute(job)
            await asyncio.wait([done])
            return list(json.loads(server.finish(job, done))["solutions"][0]["q_rad"])

        line = b"where gamma=0.3 delta=0.2 r=0.8 branch=axis5"
        try:
            found = speaker.answer(line[:-13], Session(greeted=True))
            sign = b"+" if json.loads(found)["solutions"][0]["q_rad"][4] > 0 else b"-"
            first = await apart(line + sign)
            assert json.loads(speaker.answer(b"temperature running=1800", Session(greeted=True)))["ok"]
            for seconds in (1800.0, 5400.0):  # said, and gone by
                found = await apart(line + sign)
                assert np.allclose(found, warming.at_running(seconds).locate(*HERE).solutions[0].q, atol=1e-9)
                assert np.abs(np.subtract(found, first)).max() > 1e-6
                now[0] += 3600.0
        finally:
            await server.close()

    asyncio.run(run())
    assert warming.at_running(HOUR).twin.still.elapsed == HOUR


def test_a_request_for_another_robot_is_refused(detector: Detector) -> None:
    speaker = Speaker(detector)
    here = ",".join(map(str, detector.locate(*HERE).solutions[0].q))
    for line, ok in (
        ("where gamma=0.3 delta=0.2 r=0.8 robot=kuka_kr20_r1810", True),
        (f"path from={here} to={here} robot=kuka_kr20_r1810 id=1", True),
        ("state robot=ur10", False),
    ):
        answer = json.loads(speaker.answer(line.encode(), Session(greeted=True)))
        assert answer["ok"] is ok
    assert "the model is of the robot kuka_kr20_r1810, the request is for 'ur10'" in answer["error"]


def test_a_linked_robot_that_is_another_is_refused(detector: Detector) -> None:
    class Arm:
        def posture(self) -> np.ndarray:
            return np.zeros(6)

        def move(self, postures: np.ndarray, speed: float) -> None: ...

        def stop(self) -> None: ...

        def state(self) -> dict:
            return {"robot": "abb_irb4600_40_255"}

    with pytest.raises(TargetError, match="the linked one is 'abb_irb4600_40_255'"):
        Speaker(detector, Arm())


@pytest.mark.slow
def test_the_command_takes_the_time_and_names_the_robot(warming_file: Path, cell_file: Path, tmp_path: Path) -> None:
    out, ik = tmp_path / "ik.json", ["ik", str(warming_file), *PLACE]
    done = CliRunner().invoke(
        app(), [*ik, "--cell", str(cell_file), "--running", "90min", "--json", str(out), "--verbose"]
    )
    assert done.exit_code == 0, done.output
    assert "robot: kuka_kr20_r1810, running for 1.5 h" in done.output
    data = json.loads(out.read_text(encoding="utf-8"))
    assert data["cell"]["running_s"] == 5400.0
    assert not any("8 h later" in note for note in data["notes"])
    assert "robot" not in " ".join(data["cell"]["assumed"]).split(",")[0]
    done = CliRunner().invoke(app(), [*ik, "--json", str(out)])
    data = json.loads(out.read_text(encoding="utf-8"))
    assert "robot kuka_kr20_r1810, the model's" in data["cell"]["assumed"]
    assert any("8 h later the detector would stand" in note for note in data["notes"])
    done = CliRunner().invoke(app(), [*ik, "--robot", "kuka_kr20_r1810", "--json", str(out)])
    assert "robot kuka_kr20_r1810, the model's" not in json.loads(out.read_text(encoding="utf-8"))["cell"]["assumed"]
    assert isinstance(CliRunner().invoke(app(), [*ik, "--running", "90"]).exception, DetectorError)


def test_detectors_at_other_times_leave_the_first_alone(warming: Detector) -> None:
    before = warming.still.vector.copy()
    later = replace(warming.at_running(HOUR).cell)
    assert later.running == HOUR
    assert np.array_equal(warming.still.vector, before)
