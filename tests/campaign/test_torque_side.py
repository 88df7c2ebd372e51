"""Torques that were measured behind the gears: stated, they are taken to the motors; not stated, check says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from clampid.identification.identify import identify
from clampid.identification.identify_folder import identify_folder
from experiments.campaign import read_campaign
from experiments.checks.check import check_campaign
from experiments.errors import CampaignError
from experiments.simulate import simulate

N = 6
TAU = [f"tau{i + 1}_Nm" for i in range(N)]
STATED = 'free_air = { file = "free_air.csv", side = "joint" }'


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log as a sensor behind the gears would give it, nothing stated."""
    path = tmp_path_factory.mktemp("side") / "arm"
    simulate(path, "kuka_kr20_r1810", seed=4, tables=("free_air",), file_format="csv")
    robot, frame = read_campaign(path).robot, pd.read_csv(path / "free_air.csv")
    frame[TAU] = frame[TAU].to_numpy() @ np.linalg.inv(np.asarray(robot.transmission)).T
    frame.to_csv(path / "free_air.csv", index=False)
    return path


def stated(folder: Path, tmp_path: Path, entry: str) -> Path:
    """The same campaign with another entry of its table."""
    path = tmp_path / "arm"
    path.mkdir()
    header = (folder / "campaign.toml").read_text(encoding="utf-8")
    assert 'free_air = "free_air.csv"' in header
    (path / "campaign.toml").write_text(header.replace('free_air = "free_air.csv"', entry), encoding="utf-8")
    (path / "free_air.csv").write_bytes((folder / "free_air.csv").read_bytes())
    return path


def test_check_says_what_to_state(folder: Path) -> None:
    errors = [f for f in check_campaign(read_campaign(folder)) if f.severity == "error"]
    assert any("behind the gears" in f.message and 'side = "joint"' in f.message for f in errors), errors


def test_stated_they_are_those_of_the_motors(folder: Path, tmp_path: Path) -> None:
    """The coupled wrist's, too: what joint 6 bears reaches motors 4 and 5."""
    campaign = read_campaign(stated(folder, tmp_path, STATED))
    T, sensor = np.asarray(campaign.robot.transmission), pd.read_csv(folder / "free_air.csv")[TAU].to_numpy()
    np.testing.assert_allclose(campaign.tables["free_air"][TAU], sensor @ T.T, rtol=1e-12)
    assert not [f for f in check_campaign(campaign) if f.severity == "error"]
    model = identify(campaign).stages["free_air"]
    friction = {s.label: (v, e) for s, v, e in zip(model.slots, model.theta, model.std, strict=True)
                if s.effect == "coulomb_friction"}  # fmt: skip
    assert all(v > -2.0 * e for v, e in friction.values()), friction  # without wrist runs, that of the wrist is unknown
    assert sum(v > 3.0 * e for v, e in friction.values()) >= 4, friction


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ('free_air = { file = "free_air.csv", side = "arm" }', "one of motor, joint"),
        ('free_air = { file = "free_air.csv", sid = "joint" }', "did you mean 'side'"),
        ('free_air = { side = "joint" }', "a file name"),
        ('poses = { file = "poses.csv", side = "joint" }', "of free_air or wrist only"),
    ],
)
def test_what_is_wrong_is_named(folder: Path, tmp_path: Path, entry: str, expected: str) -> None:
    with pytest.raises(CampaignError, match=expected):
        read_campaign(stated(folder, tmp_path, entry))


def test_a_folder_that_is_read_in_pieces_refuses_them(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="side joint"):
        identify_folder(stated(folder, tmp_path, STATED))
