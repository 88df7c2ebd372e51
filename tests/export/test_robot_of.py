"""A robot that is described in a file: found again from the model, or asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import resources
from pathlib import Path

import pytest

from clampid.exports.dh_export import dh_table
from clampid.identification.identify import identify
from clampid.models.described import robot_of
from clampid.models.model import Model, ModelError, load_model, save_model
from clampid.report import write_report
from experiments.campaign import read_campaign
from experiments.simulate import simulate
from kinematics.description import load_robot

Make = Callable[..., Model]


@pytest.fixture
def own_robot(tmp_path: Path) -> Path:
    text = resources.files("appendix_data").joinpath("robots", "ur10.toml").read_text(encoding="utf-8")
    path = tmp_path / "robots" / "arm7.toml"
    path.parent.mkdir()
    path.write_text(text.replace('name = "ur10"', 'name = "arm7"', 1), encoding="utf-8")
    return path


def test_the_models_file_is_enough(own_robot: Path, tmp_path: Path) -> None:
    folder = simulate(tmp_path / "c", str(own_robot), seed=3, poses=30, tables=("poses",))
    campaign = read_campaign(folder)
    assert campaign.robot_file == str(own_robot.resolve())
    save_model(identify(campaign, {"poses": ["geometry"]}), tmp_path / "models" / "m.json")
    model = load_model(tmp_path / "models" / "m.json")
    assert model.robot_file == campaign.robot_file
    table = dh_table(model, "hayati")
    assert table.equals(dh_table(model, "hayati", robot=campaign.robot))
    write_report(tmp_path / "r.html", model, campaign)
    assert "Compensated DH table" in (tmp_path / "r.html").read_text()

    # Moved beside the model, it is found there; moved away, it is asked for.
    beside = own_robot.rename(tmp_path / "models" / "arm7.toml")
    assert load_model(tmp_path / "models" / "m.json").robot_file == str(beside)
    beside.rename(tmp_path / "other.toml")
    model = load_model(tmp_path / "models" / "m.json")
    with pytest.raises(ModelError, match=r"robot 'arm7', described in a file: .*arm7.toml: expected .*--robot FILE"):
        dh_table(model, "hayati")
    assert table.equals(dh_table(model, "hayati", robot=load_robot(tmp_path / "other.toml")))


def test_a_bundled_robot_has_no_file(make_model: Make, tmp_path: Path) -> None:
    folder = simulate(tmp_path / "c", "ur10", seed=3, poses=20, tables=("poses",))
    assert read_campaign(folder).robot_file is None
    assert robot_of(make_model("ur10")).name == "ur10"


def test_what_to_do_is_said(make_model: Make, own_robot: Path) -> None:
    model = replace(make_model("ur10"), robot="arm7")
    with pytest.raises(ModelError, match=r"'arm7', which is not a bundled one, .*--robot FILE"):
        robot_of(model)
    assert robot_of(model, load_robot(own_robot)).name == "arm7"
    with pytest.raises(ModelError, match="the model is of the robot arm7, the description of ur10"):
        robot_of(model, load_robot("ur10"))
