"""The thesis' worked example and its table of springs, from a campaign simulated with its printed constants."""

from __future__ import annotations

import csv
import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from clampid.loop.worked_example import worked_example
from clampid.verbs.worked_example import worked_example as verb
from experiments.campaign import CampaignError, read_campaign


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("example") / "arm"
    app = typer.Typer()
    app.command()(verb)
    result = CliRunner().invoke(
        app, ["--out", str(folder), "--seed", "3", "--json", str(folder) + ".json", "--verbose"]
    )
    assert result.exit_code == 0, result.output
    return result.stdout, json.loads(Path(str(folder) + ".json").read_text()), folder


def test_the_example_comes_out_in_its_units(ran):
    shown, data, folder = ran
    assert data["printed"]["alone_m"] == pytest.approx(183.12e-6, abs=5e-9)
    assert data["printed"]["full_m"] == pytest.approx(183.15e-6, abs=5e-9)
    assert "183.12" in shown
    assert "183.15" in shown
    for name in ("alone", "full"):
        std = data["found"][f"{name}_std_m"]
        assert 0 < std < 3e-6
        assert abs(data["found"][f"{name}_m"] - data["printed"][f"{name}_m"]) < 3 * std
    # What motor 4's spring adds is known far better than the rest.
    more = 8.03 * 0.153 * (37 / 162540) ** 2 / 2.07
    assert data["found"]["full_m"] - data["found"]["alone_m"] == pytest.approx(more, rel=0.02)
    assert set(read_campaign(folder).tables) == {"clamped"}


def test_the_table_of_springs_comes_out(ran):
    shown, data, _ = ran
    text = resources.files("appendix_data").joinpath("motor_springs_printed.csv").read_text(encoding="utf-8")
    printed = [float(row["k_Nm_rad_at_the_motor"]) for row in csv.DictReader(text.splitlines())]
    assert data["printed"]["stiffness_Nm_rad"] == printed
    found, std = (np.array(data["found"]["drives"][f"stiffness{s}_Nm_rad"]) for s in ("", "_std"))
    assert np.all(np.abs(found - printed) < 4 * std)
    assert np.all(std < 0.015 * found)
    joint = np.array(data["found"]["drives"]["joint_stiffness_Nm_rad"]) / 1e3
    np.testing.assert_allclose(joint, [157, 396, 255, 13.1, 6.7, 1.3], rtol=0.05)
    assert all(f"{k:g}" in shown for k in printed)


def test_a_folder_that_holds_something_is_left_alone(tmp_path: Path):
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(CampaignError):
        worked_example(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]
