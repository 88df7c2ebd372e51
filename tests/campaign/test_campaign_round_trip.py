"""What is written is read back, to the last digit, in both formats, with the same fingerprint."""

from __future__ import annotations

import tomllib
from datetime import date, datetime
from importlib import resources
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from campaign_maker import HEADER, TARGETS, make_tables, write
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.campaign import CampaignError, read_campaign, target_points, write_campaign
from experiments.toml_text import toml_text


@pytest.mark.parametrize("file_format", ["csv", "parquet"])
def test_values_types_and_order_survive(tmp_path: Path, file_format: str) -> None:
    tables = make_tables()
    campaign = read_campaign(write(tmp_path / "cell 3", tables, file_format=file_format))
    assert campaign.name == "cell 3"
    assert campaign.robot.name == "kuka_kr20_r1810"
    assert campaign.tool.mass == 12.0
    assert campaign.instrument.position_std == 2e-5
    np.testing.assert_array_equal(campaign.targets["T2"], TARGETS["T2"])
    assert list(campaign.tables) == list(tables)
    for name, table in tables.items():
        read = campaign.tables[name]
        assert list(read.columns) == list(table.columns)
        for column in table:
            assert list(read[column]) == list(table[column])
    assert campaign.tables["poses"]["dir1"].dtype == np.int64
    assert campaign.tables["clamped"]["time_s"].dtype == np.float64


def test_fingerprint_is_of_the_numbers(tmp_path: Path) -> None:
    tables = make_tables()
    csv = read_campaign(write(tmp_path / "a", tables))
    parquet = read_campaign(write(tmp_path / "b", tables, file_format="parquet"))
    assert csv.fingerprint == parquet.fingerprint
    again = {name: table[sorted(table.columns)] for name, table in tables.items()}
    assert read_campaign(write(tmp_path / "c", again)).fingerprint == csv.fingerprint
    tables["poses"].loc[3, "x_m"] = np.nextafter(tables["poses"].loc[3, "x_m"], 10.0)
    assert read_campaign(write(tmp_path / "d", tables)).fingerprint != csv.fingerprint
    header = HEADER | {"gravity_m_s2": [0.0, 0.01, -9.81]}
    assert read_campaign(write(tmp_path / "e", make_tables(), header)).fingerprint != csv.fingerprint


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(-1e6, 1e6), min_size=8, max_size=8))
def test_floats_survive_csv(tmp_path_factory: pytest.TempPathFactory, values: list[float]) -> None:
    table = make_tables()["clamped"].iloc[:8].assign(tau1_Nm=values)
    folder = tmp_path_factory.mktemp("floats") / "c"
    read = read_campaign(write_campaign(folder, HEADER, {"clamped": table}, "csv"))
    assert list(read.tables["clamped"]["tau1_Nm"]) == values


_text = st.text(st.characters(codec="utf-8"), max_size=8)
_scalar = st.one_of(
    st.dates(date(1900, 1, 1)),
    st.datetimes(datetime(1900, 1, 1)),
    _text,
    st.integers(-(2**62), 2**62),
    st.floats(allow_nan=False),
    st.booleans(),
)


@pytest.mark.slow
@given(st.dictionaries(_text, st.one_of(_scalar, st.lists(_scalar, max_size=3), st.dictionaries(_text, _scalar))))
def test_toml_survives(raw: dict[str, object]) -> None:
    assert tomllib.loads(toml_text(raw)) == raw


def test_defaults_of_a_bare_header(tmp_path: Path) -> None:
    header = {"robot": "kuka_kr20_r1810", "gravity_m_s2": np.array([0.0, 0.0, -9.81])}
    campaign = read_campaign(write(tmp_path / "c", {"free_air": make_tables()["free_air"]}, header))
    assert campaign.tool.mass == 0.0
    assert not campaign.tool.com.any()
    assert campaign.instrument.position_std is None
    assert not campaign.targets


def test_tables_of_both_kinds_and_names(tmp_path: Path) -> None:
    tables = make_tables()
    folder = write(tmp_path / "c", {"poses": tables["poses"]})
    tables["wrist"].to_parquet(folder / "log of the wrist.parquet", index=False)
    with (folder / "campaign.toml").open("a") as file:
        file.write('wrist = "log of the wrist.parquet"\n')
    assert set(read_campaign(folder).tables) == {"wrist", "poses"}


def test_robot_and_tables_are_relative_to_the_folder(tmp_path: Path) -> None:
    described = resources.files("appendix_data") / "robots" / "kuka_kr20_r1810.toml"
    (tmp_path / "my robot.toml").write_bytes(described.read_bytes())
    header = HEADER | {"robot": "../my robot.toml"}
    assert read_campaign(write(tmp_path / "c", make_tables(), header)).robot.n == 6


def test_target_points(tmp_path: Path) -> None:
    tables = make_tables()
    tables["poses"].loc[0, "target"] = "flange"
    points = target_points(read_campaign(write(tmp_path / "c", tables)), "poses")
    np.testing.assert_array_equal(points[:3], [[0.0, 0.0, 0.0], TARGETS["T2"], TARGETS["T3"]])


class TestWriting:
    def test_an_empty_folder_is_used_and_parents_are_made(self, tmp_path: Path) -> None:
        (tmp_path / "a").mkdir()
        write(tmp_path / "a", make_tables())
        write(tmp_path / "b" / "c", make_tables())
        assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b"]

    def test_other_folders_and_files_are_left_alone(self, tmp_path: Path) -> None:
        (tmp_path / "precious.txt").write_text("x")
        with pytest.raises(CampaignError, match="found files that are not a campaign"):
            write_campaign(tmp_path, HEADER, make_tables(), overwrite=True)
        with pytest.raises(CampaignError, match="found a file"):
            write_campaign(tmp_path / "precious.txt", HEADER, make_tables(), overwrite=True)
        assert [p.name for p in tmp_path.iterdir()] == ["precious.txt"]

    def test_overwriting_is_asked_for_and_keeps_other_files(self, tmp_path: Path) -> None:
        folder = write(tmp_path / "c", make_tables())
        (folder / "photo.jpg").write_bytes(b"x")
        with pytest.raises(CampaignError, match="overwrite=True"):
            write(tmp_path / "c", make_tables())
        write_campaign(folder, HEADER, {"wrist": make_tables()["wrist"]}, "parquet", overwrite=True)
        assert sorted(p.name for p in folder.iterdir()) == ["campaign.toml", "photo.jpg", "wrist.parquet"]
        assert [p.name for p in tmp_path.iterdir()] == ["c"]

    def test_nothing_half_written(self, tmp_path: Path) -> None:
        folder = write(tmp_path / "c", make_tables())
        before = {p.name: p.read_bytes() for p in folder.iterdir()}
        broken = {"free_air": make_tables()["free_air"], "poses": pd.DataFrame({"x_m": [1, object()]})}
        with pytest.raises(Exception, match="object"):
            write_campaign(folder, HEADER, broken, "parquet", overwrite=True)
        assert {p.name: p.read_bytes() for p in folder.iterdir()} == before
        assert [p.name for p in tmp_path.iterdir()] == ["c"]

    @pytest.mark.parametrize(
        ("header", "tables", "file_format", "words"),
        [
            (HEADER, {"pose": pd.DataFrame()}, "csv", "'pose'"),
            (HEADER, {}, "csv", "none"),
            (HEADER, {"poses": pd.DataFrame()}, "xlsx", "'xlsx'"),
            (HEADER | {"when": object()}, {"poses": pd.DataFrame()}, "csv", "key when"),
        ],
    )
    def test_wrong_calls(self, tmp_path: Path, header, tables, file_format, words) -> None:
        with pytest.raises(CampaignError, match=words):
            write_campaign(tmp_path / "c", header, tables, file_format)
        assert not list(tmp_path.iterdir())
