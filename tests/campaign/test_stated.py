"""What a campaign states beforehand is read, written, reported by ``check`` and refused where it cannot be meant."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from campaign_maker import HEADER, Tables, make_tables, write

from clampid.stages.layout import layout_of
from clampid.stages.pose_rows import pose_rows
from experiments.campaign import Campaign, CampaignError, read_campaign, write_campaign
from experiments.checks.check import holdings
from experiments.sensors import placed
from experiments.stated import Sensor

BASE = {
    "position_m": [2.5, -1.0, 0.3],
    "rpy_rad": [0.0, 0.02, 0.4],
    "position_std_m": 2e-4,
    "rpy_std_rad": [1e-4, 1e-4, float("inf")],
}
APART = 0.1733
STATED: dict[str, Any] = {
    "base": BASE,
    "targets_std_m": {"T1": 1e-4, "T2": [1e-4, 2e-4, 3e-4]},
    "distance": [
        {"between": ["T1", "T2"], "value_m": APART, "std_m": 2e-6},
        {"between": ["T3", "T2"], "value_m": 0.19, "std_m": 3e-6},
    ],
    "sensors": {"link1": {"at": "link3"}},
}


def poses() -> Tables:
    return {"poses": make_tables()["poses"]}


def read(folder: Path, **changed: Any) -> Campaign:
    header = {k: v for k, v in (HEADER | changed).items() if v is not None}
    return read_campaign(write(folder / "c", poses(), header))


Clampid = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def clampid(program: Path) -> Clampid:
    def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, check=False)

    return run


def test_statements_are_read_and_survive_writing(tmp_path: Path) -> None:
    campaign = read(tmp_path, **STATED)
    again = read_campaign(write_campaign(tmp_path / "again", campaign.header, campaign.tables, "parquet"))
    assert again.fingerprint == campaign.fingerprint
    for stated in (campaign.stated, again.stated):
        assert stated.base is not None
        assert stated.base.position.tolist() == BASE["position_m"]
        assert stated.base.position_std.tolist() == [2e-4] * 3
        assert stated.base.rpy_std.tolist() == [1e-4, 1e-4, np.inf]
        assert {k: v.tolist() for k, v in stated.targets_std.items()} == {"T1": [1e-4] * 3, "T2": [1e-4, 2e-4, 3e-4]}
        assert [(d.between, d.value, d.std) for d in stated.distances] == [
            (("T1", "T2"), APART, 2e-6),
            (("T3", "T2"), 0.19, 3e-6),
        ]
        assert stated.sensors == {"link1": Sensor("link3")}


def test_nothing_stated_is_nothing_known(tmp_path: Path) -> None:
    stated = read(tmp_path).stated
    assert stated.base is None
    assert not stated.targets_std
    assert not stated.distances
    assert stated.to_json() == {}


@pytest.mark.slow
def test_what_was_stated_is_reported(tmp_path: Path, clampid: Clampid) -> None:
    campaign = read(tmp_path, **STATED)
    found = holdings(campaign)["stated"]
    assert found["base"]["rpy_std_rad"] == [1e-4, 1e-4, None]
    assert found["distance"][0] == {"between": ["T1", "T2"], "value_m": APART, "std_m": 2e-6}
    said = clampid("check", tmp_path / "c").stdout
    for words in (
        "base in the instrument's frame, x to 200 µm",
        "yaw not known",
        "T1 to T2: 173.3 mm",
        "link1: at link3",
    ):
        assert words in said, said


INF = float("inf")
FAULTS: list[tuple[dict[str, Any], str, str]] = [
    ({"bases": BASE}, "key bases", "did you mean 'base'?"),
    ({"operator": "AB"}, "key operator", "one of format, robot, gravity_m_s2"),
    ({"tool": HEADER["tool"] | {"inertia": 3}}, "key tool.inertia", "one of mass_kg, com_m"),
    ({"base": BASE | {"position_mm": [2500, 0, 0]}}, "key base.position_mm", "did you mean 'position_m'?"),
    ({"base": BASE | {"position_m": [2500.0, -1000.0, 300.0]}}, "key base.position_m", "millimetres"),
    ({"base": BASE | {"rpy_rad": [0.0, 1.0, 45.0]}}, "key base.rpy_rad", "degrees"),
    ({"base": BASE | {"position_std_m": 200.0}}, "key base.position_std_m", "millimetres"),
    ({"base": BASE | {"position_std_m": 0.0}}, "key base.position_std_m", "above 0 and not above 1, or inf"),
    ({"base": BASE | {"rpy_std_rad": [1e-4, 1e-4]}}, "key base.rpy_std_rad", "one number or three"),
    ({"base": BASE | {"rpy_std_rad": float("nan")}}, "key base.rpy_std_rad", "one number or three"),
    ({"base": BASE | {"position_std_m": INF, "rpy_std_rad": INF}}, "key base", "nothing that is known"),
    ({"base": {"position_m": [0, 0, 0]}}, "key base.position_std_m", "base.position_std_m with base.position_m"),
    ({"base": {}}, "key base", "nothing that is known"),
    ({"targets_std_m": {"T9": 1e-4}}, "key targets_std_m.T9", "T1, T2, T3"),
    ({"targets_std_m": {"T1": 0.1}}, "key targets_std_m.T1", "millimetres"),
    ({"targets_std_m": {"T1": INF}}, "key targets_std_m.T1", "above 0"),
    ({"distance": {"between": ["T1", "T2"]}}, "key distance", "[[distance]]"),
    ({"distance": [{"between": ["T1", "T9"], "value_m": 1, "std_m": 1e-6}]}, "key distance[1].between", "T1, T2, T3"),
    ({"distance": [{"between": ["T1", "T1"], "value_m": 1, "std_m": 1e-6}]}, "key distance[1].between", "two targets"),
    ({"distance": [{"between": ["T1", "T2"], "value_m": 173.3, "std_m": 1e-6}]}, "distance[1].value_m", "millimetres"),
    ({"distance": [{"between": ["T1", "T2"], "value_m": 0.3, "std_m": 1e-6}]}, "distance[1].value_m", "0.173204"),
    ({"distance": [{"between": ["T1", "T2"], "value_m": APART, "std_m": 2.0}]}, "distance[1].std_m", "millimetres"),
    ({"distance": [{"between": ["T1", "T2"], "value": APART}]}, "key distance[1].value_m", "no such key, but 'value'"),
    ({"sensors": {"link1": "link2"}}, "key sensors.link1", '{at = "link2"}'),
    ({"sensors": {"link1": {"at": "link7"}}}, "key sensors.link1.at", "link1 … link6"),
    ({"sensors": {"link1": {"at": "link2", "weight": 0}}}, "key sensors.link1.weight", "above 0"),
    ({"sensors": {"link9": {"at": "link2"}}}, "key sensors.link9", "temp_link1_C"),
    ({"targets_m": {"T1": {"at": "base", "position_m": [0, 0, 0]}}}, "key targets_m.T1.at", "not supported yet"),
    (
        {"targets_m": {"T1": {"at": "flange", "position": [0, 0, 0]}}},
        "targets_m.T1.position_m",
        "no such key, but 'position'",
    ),
    ({"flange_sensor": {"std_m": 1e-5}}, "key flange_sensor", "not supported yet"),
]


@pytest.mark.parametrize(("wrong", "key", "words"), FAULTS)
def test_what_cannot_be_meant_is_refused(tmp_path: Path, wrong: dict[str, Any], key: str, words: str) -> None:
    with pytest.raises(CampaignError) as caught:
        read(tmp_path, **wrong)
    for part in ("campaign.toml", "expected", "found", key, words):
        assert part in str(caught.value), str(caught.value)


@pytest.mark.slow
def test_an_unknown_section_ends_the_program_with_2(tmp_path: Path, clampid: Clampid) -> None:
    found = clampid("check", write(tmp_path / "c", poses(), HEADER | {"bases": BASE}))
    assert found.returncode == 2
    assert "did you mean 'base'?" in found.stderr


def test_a_target_on_the_flange_may_be_a_table(tmp_path: Path) -> None:
    targets = {**HEADER["targets_m"], "T1": {"at": "flange", "position_m": HEADER["targets_m"]["T1"]}}
    assert read(tmp_path, targets_m=targets).targets["T1"].tolist() == HEADER["targets_m"]["T1"]


def test_sensors_of_one_place_are_a_weighted_mean() -> None:
    frame = pd.DataFrame(
        {
            "time_s": [0.0, 1e4],
            "temp_link2_C": [20.0, 30.0],
            "temp_arm_C": [24.0, 31.0],
            "temp_motor1_C": [50.0, np.nan],
        }
    )
    found = placed(frame, {"arm": Sensor("link2", 3.0), "motor1": Sensor("none")})
    assert [c for c in found if c.startswith("temp_")] == ["temp_link2_C"]
    np.testing.assert_allclose(found["temp_link2_C"], [23.0, 30.75])
    lost = placed(frame, {"arm": Sensor("motor1")})  # one of two has no reading: the mean would jump
    assert lost["temp_motor1_C"].isna().tolist() == [False, True]
    assert placed(frame, {"elsewhere": Sensor("link1")}) is frame


def test_effects_see_a_sensor_where_it_is_said_to_sit(tmp_path: Path) -> None:
    campaign = read(tmp_path, sensors={"link1": {"at": "link3"}})
    warm = pose_rows([campaign], layout_of([campaign]), "poses").signals["link_temperature"]
    assert not warm[:, :2].any()
    np.testing.assert_allclose(warm[:, 2], campaign.tables["poses"]["temp_link1_C"] - 20.0)
