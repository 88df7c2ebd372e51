"""``clampid virtual-robot``: wrong calls end in one line, and edited config files are interpreted."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import numpy as np
import pytest
from controller_client import HOME, STEP, configs, inside, move, process

from clampid.cli import run
from clampid.verbs.errors import CallError
from clampid.verbs.virtual_robot import virtual_robot
from experiments.virtual_controller.config import read_config
from experiments.virtual_controller.errors import ControllerError
from experiments.virtual_controller.running import Asked, built
from experiments.virtual_controller.serving import Address
from kinematics.description import load_robot


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"listen": "here"}, "HOST:PORT"),
        ({"listen": "127.0.0.1:65536"}, "HOST:PORT"),
        ({"speed": 0.0}, "speed: expected above 0"),
        ({"speed": 2000.0}, "speed: expected above 0"),
        ({"hide": ["backlahs"]}, "did you mean 'backlash'"),
        ({"hide": ["backlash@joint9"]}, "joint9"),
        ({"faults": ["explode=1"]}, "expected NAME=VALUE"),
        ({"tracker": "x:y"}, "--tracker 'x:y': expected HOST:PORT"),
        ({"files": Path("/nowhere")}, "link-files"),
        ({"listen": "256.256.256.256:0"}, "cannot listen"),
    ],
)
def test_wrong_calls_are_refused_in_a_line(asked: dict[str, object], said: str) -> None:
    with pytest.raises(CallError) as error:
        virtual_robot(**({"listen": "127.0.0.1:0"} | asked))  # type: ignore[arg-type]
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_truth_of_another_robot_is_not_overwritten(tmp_path: Path) -> None:
    truth = tmp_path / "truth.json"
    robot = load_robot("kuka_kr20_r1810")
    built(Asked(robot, configs(), seed=1, truth=truth, hide=("backlash@joint2",))).journal.close()
    told = json.loads(truth.read_text())
    assert told["hidden"][0]["effect"] == "backlash"
    assert set(told["hidden"][0]["parameters"]) == {"gap_rad"}
    with pytest.raises(ControllerError, match="found that of"):
        built(Asked(robot, configs(), seed=2, truth=truth))
    truth.write_text("[]")
    with pytest.raises(ControllerError, match="found that of"):
        built(Asked(robot, configs(), seed=1, truth=truth))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("ETHERNETKRL", "RSI", "ETHERNETKRL"),
        ("<TYPE>Client</TYPE>", "<TYPE>Server</TYPE>", "Client"),
        ('Type="REAL"', 'Type="DOUBLE"', "expected Type"),
        ('Limit="64"', 'Limit="0"', "BUFFERING Limit"),
        ('Limit="64"', 'Limit="513"', "BUFFERING Limit"),
        ("<PROTOCOL>TCP", "<PROTOCOL>UDP", "TCP"),
        ("Move/Speed", "Move/Id", "every Tag of RECEIVE once"),
        ("<ETHERNETKRL>", '<!DOCTYPE a [<!ENTITY b "c">]><ETHERNETKRL>', "DOCTYPE"),
        ("</ETHERNETKRL>", "", "no XML"),
    ],
)
def test_config_that_is_none_is_refused(old: str, new: str, said: str) -> None:
    text = configs()[0][1]
    assert old in text
    with pytest.raises(ControllerError, match=said):
        read_config(text.replace(old, new), "ClampidMotion.xml")


def test_config_without_what_the_programs_read_is_refused() -> None:
    (name, text), state = configs()
    without = "\n".join(line for line in text.splitlines() if '"Move/Speed"' not in line)
    with pytest.raises(ControllerError, match="Move/Speed"):
        built(Asked(load_robot("kuka_kr20_r1810"), ((name, without), state)))
    strange = text.replace("Moved/Reason", "Moved/Mood")
    with pytest.raises(ControllerError, match="Moved/Mood"):
        built(Asked(load_robot("kuka_kr20_r1810"), ((name, strange), state)))


def test_edited_limits_are_what_counts(tmp_path: Path) -> None:
    for name, text in configs():
        (tmp_path / name).write_text(text.replace('Limit="64"', 'Limit="2"'))
    with process("--files", str(tmp_path), "--speed", "100", wants=()) as robot:
        with robot.motion() as link:
            link.send(b"".join(move(1, 1, [HOME, HOME + STEP, HOME])))  # three in one piece, for queues of two
            assert link.closed()
        assert robot.ask()["State.Accepted"] == 0
        assert robot.run(2, [HOME + STEP]) == [1, 2, 3]


def test_other_port_that_is_taken_is_said() -> None:
    with inside() as robot:
        host, port = robot.at["listening"]
        with pytest.raises(CallError, match="cannot listen"):
            virtual_robot(listen=f"{host}:{port}")
        with pytest.raises(CallError, match="cannot listen"):
            virtual_robot(listen=f"{host}:{port - 1}")


def test_robot_of_another_maker_moves_too() -> None:
    with inside(robot="abb_irb4600_40_255", speed=1000.0) as robot:
        q = np.degrees(robot.robot.controller.arm.track.target)
        assert robot.run(1, [q + 5, q]) == [1, 2, 2, 3]


def test_a_disk_that_is_full_ends_it_and_no_client_hears_of_what_is_not_kept(tmp_path: Path) -> None:
    """By the limit of a file's size: the journal takes some lines and a part of the next."""
    resource = pytest.importorskip("resource")

    async def play() -> None:
        robot = built(Asked(load_robot("kuka_kr20_r1810"), configs(), truth=tmp_path / "truth.json"))
        serving = asyncio.ensure_future(robot.run())
        host, port = await robot.listen(Address("127.0.0.1", 0))
        kept = (tmp_path / "truth.journal.jsonl").stat().st_size
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (kept + 500, before[1]))
        try:
            read, write = await asyncio.open_connection(host, port)
            write.write(b"".join(move(1, 1, [HOME + 0.01 * STEP])))
            told = await asyncio.wait_for(read.read(), 20)  # until it hangs up
            await asyncio.wait_for(serving, 20)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
            robot.close()
            lines = (tmp_path / "truth.journal.jsonl").read_bytes().split(b"\n")[:-1]
            heard = told.count(b"<Moved>")
            assert heard == len(lines) - 1 >= 1, (told, lines)  # the first line is the start
            write.close()

    with pytest.raises(ControllerError, match=r"truth.journal.jsonl: cannot be written: "):
        asyncio.run(play())


def test_a_truth_that_is_there_is_gone_on_with(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The truth is an output: the call that names it again is no call that writes onto what it reads."""
    truth = tmp_path / "truth.json"
    built(Asked(load_robot("kuka_kr20_r1810"), configs(), truth=truth)).journal.close()
    with process("--truth", str(truth)):
        pass
    assert [json.loads(line)["boot"] for line in (tmp_path / "truth.journal.jsonl").read_text().splitlines()] == [1, 2]
    assert run(["virtual-robot", "--listen", "127.0.0.1:0", "--seed", "3", "--truth", str(truth)]) == 2
    assert "expected the truth of" in capsys.readouterr().err


@pytest.mark.parametrize(
    "line", ['{"boot": "x"}', '{"boot": 0}', '{"boot": 1, "at": ["a"]}', '{"boot": 1, "at": [1e99, 0, 0, 0, 0, 0]}']
)
def test_a_journal_that_is_none_is_refused(line: str, tmp_path: Path) -> None:
    truth = tmp_path / "truth.json"
    robot = load_robot("kuka_kr20_r1810")
    built(Asked(robot, configs(), truth=truth)).journal.close()
    with (tmp_path / "truth.journal.jsonl").open("a") as journal:
        journal.write(f"{'[' * 100_000}\n{line}\n")  # the nested line is one that was cut
    with pytest.raises(ControllerError, match=r"truth\.journal\.jsonl, line 3: expected an event"):
        built(Asked(robot, configs(), truth=truth))


@pytest.mark.parametrize("held", ["[" * 100_000, "\udcff", "[1e999]"])
def test_a_truth_that_is_none_is_refused(held: str, tmp_path: Path) -> None:
    (tmp_path / "truth.json").write_bytes(held.encode("utf-8", "surrogateescape"))
    with pytest.raises(ControllerError, match=r"truth\.json: expected the truth"):
        built(Asked(load_robot("kuka_kr20_r1810"), configs(), truth=tmp_path / "truth.json"))


@pytest.mark.parametrize("to", ["/dev/zero", "/"])
def test_a_device_is_no_config_file(to: str, tmp_path: Path) -> None:
    (tmp_path / "ClampidMotion.xml").symlink_to(to)
    with pytest.raises(CallError, match=r"ClampidMotion\.xml: expected a config file"):
        virtual_robot(listen="127.0.0.1:0", files=tmp_path)
