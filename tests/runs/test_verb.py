"""The verb: exit codes, what it prints, and calls that cannot be meant."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import typer
from run_controller import Controller, poses_plan
from typer.testing import CliRunner

from clampid.loop.until import parse_until
from clampid.verbs.run import run as run_verb
from experiments.campaign import read_campaign
from experiments.plans import Cell, Limits, Plan, PlanError, write_plan
from experiments.runs.dry import hours_or_minutes, motions
from experiments.runs.folder import check_folder_for
from experiments.runs.picture import picture


@pytest.fixture(scope="module")
def app() -> typer.Typer:
    made = typer.Typer(pretty_exceptions_enable=False)
    made.command()(run_verb)
    return made


def call(app: typer.Typer, *words: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, list(words))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


def test_a_plan_becomes_a_campaign_with_a_fit_on_the_way(
    app: typer.Typer, controller: Controller, cell: Cell, limits: Limits, tmp_path: Path
) -> None:
    file = write_plan(poses_plan(cell, limits, 12), tmp_path / "plan.toml")
    folder, said = tmp_path / "C", tmp_path / "said.json"
    code, text = call(
        app, str(file), "-o", str(folder), "--link", controller.link, "--instrument", controller.tracker, "--yes",
        "--json", str(said),
    )  # fmt: skip
    assert code == 0
    assert len(read_campaign(folder).tables["poses"]) == 39
    assert "clampid identify" in text
    assert "parameters of poses are known" in text
    assert json.loads(said.read_text())["rows"] == {"poses": 39, "verification": 3}


def test_until_ends_it_when_enough_is_known_and_not_before_a_fit_can_be_made(
    app: typer.Typer, controller: Controller, cell: Cell, limits: Limits, tmp_path: Path
) -> None:
    """Ten poses are the fewest for three targets; the first fits of fewer would only return what was assumed."""
    file, folder = write_plan(poses_plan(cell, limits, 16), tmp_path / "plan.toml"), tmp_path / "C"
    code, text = call(
        app, str(file), "-o", str(folder), "--link", controller.link, "--instrument", controller.tracker, "--yes",
        "--until", "std(joint_compliance@joint2) < 5 rad/Nm",
    )  # fmt: skip
    assert code == 0
    assert "Stopped early, as asked" in text
    assert 30 <= len(read_campaign(folder).tables["poses"]) < 51
    assert "no fit yet: poses: 1 pose is fewer than" in " ".join(text.split())


def test_no_answer_is_no_and_exit_code_3(app: typer.Typer, controller: Controller, poses: Plan, tmp_path: Path) -> None:
    file, folder = write_plan(poses, tmp_path / "plan.toml"), tmp_path / "C"
    before = len(controller.executions())
    code, text = call(
        app, str(file), "-o", str(folder), "--link", controller.link, "--instrument", controller.tracker
    )  # fmt: skip
    assert code == 3
    assert "Nobody is there to answer" in " ".join(text.split())
    assert "--resume" not in text  # nothing has moved: the same call again is right
    assert len(controller.executions()) == before
    assert not folder.exists()
    assert not list(tmp_path.glob(".C*"))


def test_a_dry_run_lists_every_motion_and_draws_it(
    app: typer.Typer, clamping: Plan, poses: Plan, tmp_path: Path
) -> None:
    for name, plan, count in (("clamping", clamping, 129), ("poses", poses, 16)):
        file = write_plan(plan, tmp_path / f"{name}.toml")
        code, text = call(app, str(file), "-o", str(tmp_path / name), "--dry-run", "--json", str(tmp_path / "j.json"))
        assert code == 0
        assert "nothing has moved" in " ".join(text.split())
        data = json.loads((tmp_path / "j.json").read_text())
        assert len(data["motions"]) == count
        starts = [m["start_s"] for m in data["motions"]]
        assert starts == sorted(starts)
        svg = (tmp_path / f"{name}.dry-run.svg").read_text()
        assert svg.count("<circle") == 2 * len({tuple(m["to_rad"]) for m in data["motions"] if m["measured"]})


def test_calls_that_cannot_be_meant(app: typer.Typer, poses: Plan, tmp_path: Path) -> None:
    file = str(write_plan(poses, tmp_path / "plan.toml"))
    for words, said in (
        (["-o", "C"], "--link: expected the robot's address"),
        (["-o", "C", "--link", "eki://a:1"], "--instrument: expected"),
        (["-o", "C", "--link", "eki://a:1", "--instrument", "http://x"], "--instrument: expected tcp://HOST:PORT or"),
        (["-o", "C", "--link", "eki://a:1", "--instrument", "folder:D?unit=inch"], "--instrument: unit: expected m,"),
        (["-o", "C", "--link", "nonsense", "--instrument", "tcp://a:1"], "expected SCHEME://HOST:PORT"),
        (["-o", "C", "--link", "eki://a:1", "--instrument", "tcp://a:1", "--operator", "a"], "--operator: expected"),
        (["-o", "C", "--link", "eki://a:1", "--until", "much"], "--until: expected std"),
    ):
        with pytest.raises(ValueError, match=said):
            call(app, file, *words)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("std(gremlins@joint2) < 5 arcsec", "expected an effect"),
        ("std(backlash@joint2) < 5 parsec", "expected a unit of"),
        ("std(backlash@joint2) < 5 mm", "expected a unit of rad"),
        ("std(backlash.size@joint2) < 5 arcsec", "expected one of gap"),
        ("std(backlash@joint2) < -5 arcsec", "expected a number above 0"),
        ("backlash@joint2 < 5 arcsec", "expected std"),
    ],
)
def test_conditions_that_are_none(text: str, said: str) -> None:
    with pytest.raises(PlanError, match=said):
        parse_until(text)


def test_conditions_in_si() -> None:
    one, two = parse_until("std(backlash@joint2) < 5 arcsec and std(joint_compliance.c@joint3) < 2 mrad/Nm")
    assert one.below == pytest.approx(5 * 4.848137e-6)
    assert (two.parameter, two.below) == ("c", 0.002)


@pytest.mark.parametrize(
    "text",
    [b"x = [", b"x = " + b"[" * 3000, b"\xff\xfe\x00", b"x = " + b"9" * 6000],
    ids=["cut", "deep", "bytes", "digits"],
)
def test_a_folder_whose_header_is_no_toml_is_refused_before_anything_moves(
    poses: Plan, tmp_path: Path, text: bytes
) -> None:
    (tmp_path / "C").mkdir()
    (tmp_path / "C" / "campaign.toml").write_bytes(text)
    with pytest.raises(PlanError, match=r"campaign\.toml: expected a campaign's TOML"):
        check_folder_for(poses, tmp_path / "C")
    assert (tmp_path / "C" / "campaign.toml").read_bytes() == text


def test_a_picture_of_many_cycles_draws_each_way_once(poses: Plan) -> None:
    sizes = []
    for cycles in (2, 20):
        plan = replace(poses, visits=poses.visits * cycles)
        svg = picture(plan, list(motions(plan)))
        sizes.append((svg.count("<polyline"), svg.count("<circle")))
        assert f"{len(poses.visits) * cycles} of them measured" in svg
    assert sizes[0] == sizes[1]
    assert sizes[0][1] == 2 * len({visit.q.tobytes() for visit in poses.visits})
    assert (hours_or_minutes(90.0), hours_or_minutes(32216.0)) == ("1.5 min", "8.9 h")
