"""A folder that does not follow the contract gets an error that names file, row, column, expected and found."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from campaign_maker import HEADER, Tables, change, columns, make_tables, write

from experiments.campaign import CampaignError, read_campaign

TABLES = ("free_air", "wrist", "clamped", "poses", "verification")
LOGS = TABLES[:3]
POINTS = TABLES[3:]
FORMATS = ("csv", "parquet")
NUMBER = {"free_air": "q2_rad", "wrist": "tau4_Nm", "clamped": "motor3_rad", "poses": "x_m", "verification": "q6_rad"}
COUNT = {"free_air": "run", "wrist": "run", "clamped": "sweep", "poses": "visit", "verification": "pose"}


def refused(folder: Path, tables: Tables, file_format: str = "csv") -> str:
    write(folder / "c", tables, file_format=file_format)
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder / "c")
    return str(caught.value)


def with_cell(table: str, row: int, column: str, value: object) -> Tables:
    def edit(frame: pd.DataFrame) -> pd.DataFrame:
        frame[column] = frame[column].astype(object if isinstance(value, str) else float)
        frame.loc[row - 1, column] = value
        return frame

    return change(table, edit)


def says(message: str, *parts: str) -> None:
    for part in ("expected", "found", *parts):
        assert part in message, message


@pytest.mark.parametrize("file_format", FORMATS)
@pytest.mark.parametrize("table", TABLES)
class TestEveryTable:
    def test_missing_column(self, tmp_path: Path, table: str, file_format: str) -> None:
        column = NUMBER[table]
        message = refused(tmp_path, change(table, lambda f: f.drop(columns=column)), file_format)
        says(message, f"{table}.{file_format}", f"column {column}", "no such column")

    def test_other_unit_in_the_name(self, tmp_path: Path, table: str, file_format: str) -> None:
        column = NUMBER[table]
        wrong = column.replace("_rad", "_deg").replace("_Nm", "_Nmm").replace("x_m", "x_mm")
        message = refused(tmp_path, change(table, lambda f: f.rename(columns={column: wrong})), file_format)
        says(message, f"{table}.{file_format}", repr(wrong), f"in place of {column!r}")
        assert message.count("expected") == 1

    @pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
    def test_not_finite(self, tmp_path: Path, table: str, file_format: str, value: float) -> None:
        message = refused(tmp_path, with_cell(table, 5, NUMBER[table], value), file_format)
        says(message, f"{table}.{file_format}, row 5", f"column {NUMBER[table]}", "a finite number")
        assert ("(line 6)" in message) == (file_format == "csv")

    def test_many_nans_are_counted(self, tmp_path: Path, table: str, file_format: str) -> None:
        def edit(frame: pd.DataFrame) -> pd.DataFrame:
            frame.loc[3:9, NUMBER[table]] = np.nan
            return frame

        says(refused(tmp_path, change(table, edit), file_format), "row 4", "6 more such rows", "the last in row 10")

    def test_text_for_a_number(self, tmp_path: Path, table: str, file_format: str) -> None:
        tables = with_cell(table, 4, NUMBER[table], "broken")
        if file_format == "parquet":
            tables[table][NUMBER[table]] = tables[table][NUMBER[table]].astype(str)
            says(refused(tmp_path, tables, file_format), f"{table}.parquet, row 1", f"column {NUMBER[table]}")
        else:
            says(refused(tmp_path, tables), f"{table}.csv, row 4 (line 5)", f"column {NUMBER[table]}", "'broken'")

    def test_only_temperatures_may_miss_readings(self, tmp_path: Path, table: str, file_format: str) -> None:
        column = next(name for name in make_tables()[table].columns if name.startswith("temp_"))
        folder = write(tmp_path / "c", with_cell(table, 7, column, np.nan), file_format=file_format)
        assert np.flatnonzero(read_campaign(folder).tables[table][column].isna()).tolist() == [6]
        says(refused(tmp_path / "inf", with_cell(table, 7, column, np.inf), file_format), "row 7", f"column {column}")

    @pytest.mark.parametrize("value", [1.5, -1.0])
    def test_counts_are_integers(self, tmp_path: Path, table: str, file_format: str, value: float) -> None:
        message = refused(tmp_path, with_cell(table, 3, COUNT[table], value), file_format)
        says(message, f"{table}.{file_format}, row 3", f"column {COUNT[table]}", "an integer", f"{value:g}")

    def test_header_only(self, tmp_path: Path, table: str, file_format: str) -> None:
        message = refused(tmp_path, change(table, lambda f: f.iloc[:0]), file_format)
        says(message, f"{table}.{file_format}", "at least one row", "a header and no rows")

    def test_empty_file(self, tmp_path: Path, table: str, file_format: str) -> None:
        folder = write(tmp_path / "c", make_tables(), file_format=file_format)
        (folder / f"{table}.{file_format}").write_bytes(b"")
        with pytest.raises(CampaignError, match=rf"{table}\.{file_format}: expected .* found an empty file"):
            read_campaign(folder)

    def test_missing_file(self, tmp_path: Path, table: str, file_format: str) -> None:
        folder = write(tmp_path / "c", make_tables(), file_format=file_format)
        (folder / f"{table}.{file_format}").unlink()
        with pytest.raises(CampaignError, match=rf"{table}\.{file_format}: expected .* found no such file"):
            read_campaign(folder)

    def test_truncated_file(self, tmp_path: Path, table: str, file_format: str) -> None:
        folder = write(tmp_path / "c", make_tables(), file_format=file_format)
        file = folder / f"{table}.{file_format}"
        lines = file.read_bytes()
        cut = lines.rstrip().rindex(b"\n") + 20 if file_format == "csv" else len(lines) // 2
        file.write_bytes(lines[:cut])
        with pytest.raises(CampaignError) as caught:
            read_campaign(folder)
        says(str(caught.value), file.name)
        assert ("row" in str(caught.value)) if file_format == "csv" else ("truncated or damaged" in str(caught.value))

    def test_repeated_row(self, tmp_path: Path, table: str, file_format: str) -> None:
        tables = change(table, lambda f: pd.concat([f.iloc[:6], f.iloc[4:]], ignore_index=True))
        message = refused(tmp_path, tables, file_format)
        says(message, f"{table}.{file_format}, row 7", "row 5", "again")


@pytest.mark.parametrize("file_format", FORMATS)
@pytest.mark.parametrize("table", LOGS)
def test_time_goes_back_within_a_run(tmp_path: Path, table: str, file_format: str) -> None:
    says(
        refused(tmp_path, with_cell(table, 3, "time_s", 0.0), file_format),
        "row 3",
        "column time_s",
        "increasing",
        "row 2",
    )


@pytest.mark.parametrize("table", LOGS)
def test_time_may_start_again_in_another_run(tmp_path: Path, table: str) -> None:
    def edit(frame: pd.DataFrame) -> pd.DataFrame:
        run = "sweep" if table == "clamped" else "run"
        frame["time_s"] -= frame.groupby(run)["time_s"].transform("min")
        return frame

    assert len(read_campaign(write(tmp_path / "c", change(table, edit))).tables[table]) > 20


@pytest.mark.parametrize("joint", [0, 7])
def test_driven_joint_exists(tmp_path: Path, joint: int) -> None:
    message = refused(tmp_path, with_cell("clamped", 2, "joint", joint))
    says(message, "clamped.csv, row 2 (line 3)", "column joint", "an integer from 1 to 6", f"'{joint}")


@pytest.mark.parametrize("file_format", FORMATS)
@pytest.mark.parametrize("table", POINTS)
class TestPoints:
    @pytest.mark.parametrize("value", [2, 0.5, -3])
    def test_direction(self, tmp_path: Path, table: str, file_format: str, value: float) -> None:
        message = refused(tmp_path, with_cell(table, 9, "dir3", value), file_format)
        says(message, f"{table}.{file_format}, row 9", "column dir3", "an integer from -1 to 1")

    def test_quaternion_not_unit(self, tmp_path: Path, table: str, file_format: str) -> None:
        def edit(frame: pd.DataFrame) -> pd.DataFrame:
            frame.loc[6, ["qw", "qx", "qy", "qz"]] *= 1.01
            return frame

        message = refused(tmp_path, change(table, edit), file_format)
        says(message, f"{table}.{file_format}, row 7", "qw, qx, qy, qz", "a unit quaternion", "norm 1.01")

    def test_half_a_quaternion(self, tmp_path: Path, table: str, file_format: str) -> None:
        message = refused(tmp_path, change(table, lambda f: f.drop(columns="qz")), file_format)
        says(message, f"{table}.{file_format}", "column qz", "all of qw … qz, or none")

    def test_unknown_target(self, tmp_path: Path, table: str, file_format: str) -> None:
        message = refused(tmp_path, with_cell(table, 2, "target", "T9"), file_format)
        says(message, f"{table}.{file_format}, row 2", "column target", "T1, T2, T3", "'T9'")

    def test_flange_needs_orientation(self, tmp_path: Path, table: str, file_format: str) -> None:
        tables = with_cell(table, 2, "target", "flange")
        read_campaign(write(tmp_path / "oriented", tables, file_format=file_format))
        tables[table] = tables[table].drop(columns=["qw", "qx", "qy", "qz"])
        says(refused(tmp_path, tables, file_format), "row 2", "flange only with columns qw, qx, qy, qz")

    def test_time_may_be_in_any_order(self, tmp_path: Path, table: str, file_format: str) -> None:
        tables = change(table, lambda f: f.iloc[::-1].reset_index(drop=True))
        read_campaign(write(tmp_path / "c", tables, file_format=file_format))


@pytest.mark.parametrize("table", TABLES)
class TestTextFiles:
    def spoil(self, folder: Path, table: str, old: str, new: bytes, count: int = 1) -> str:
        write(folder / "c", make_tables())
        file = folder / "c" / f"{table}.csv"
        file.write_bytes(file.read_bytes().replace(old.encode(), new, count))
        with pytest.raises(CampaignError) as caught:
            read_campaign(folder / "c")
        says(str(caught.value), file.name)
        return str(caught.value)

    def test_semicolons(self, tmp_path: Path, table: str) -> None:
        assert "semicolons" in self.spoil(tmp_path, table, ",", b";", -1)

    def test_not_utf8(self, tmp_path: Path, table: str) -> None:
        assert "line 1: expected UTF-8 text, found byte 0xb0" in self.spoil(tmp_path, table, "_rad", b"_\xb0")

    def test_duplicate_column(self, tmp_path: Path, table: str) -> None:
        message = self.spoil(tmp_path, table, ",tau2_Nm" if table in LOGS else ",y_m", b",time_s")
        assert "every column name once" in message

    def test_line_with_a_cell_too_many(self, tmp_path: Path, table: str) -> None:
        assert re.search(r"row 1 \(line 2\): expected \d+ cells", self.spoil(tmp_path, table, "\n1,", b"\n1,1,"))

    def test_line_numbers_count_blank_lines(self, tmp_path: Path, table: str) -> None:
        assert "row 1 (line 4)" in self.spoil(tmp_path, table, "\n1,", b"\n\n\nx,")

    def test_byte_order_mark_is_fine(self, tmp_path: Path, table: str) -> None:
        file = write(tmp_path / "c", make_tables()) / f"{table}.csv"
        file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n"))
        read_campaign(tmp_path / "c")


@pytest.mark.parametrize("table", ["free_air", "wrist"])
def test_half_the_velocities(tmp_path: Path, table: str) -> None:
    says(refused(tmp_path, change(table, lambda f: f.drop(columns="qd4_rad_s"))), "column qd4_rad_s", "or none")


HEADER_FAULTS = [
    ({"format": "clampid-campaign/2"}, "key format", "clampid-campaign/1"),
    ({"robot": "kuka_kr20"}, "key robot", "kuka_kr20_r1810"),
    ({"robot": "no_such.urdf"}, "key robot", "no_such.urdf"),
    ({"robot": 20}, "key robot", "20"),
    ({"gravity_m_s2": [0, 0, -9810]}, "key gravity_m_s2", "9810"),
    ({"gravity_m_s2": [0, 0]}, "key gravity_m_s2", "3 finite numbers"),
    ({"gravity_m_s2": [0, 0, "down"]}, "key gravity_m_s2", "3 finite numbers"),
    ({"tool": {"mass_kg": 12000, "com_m": [0, 0, 0.08]}}, "key tool.mass_kg", "12000"),
    ({"tool": {"mass_kg": 12, "com_m": [0, 0, 80]}}, "key tool.com_m", "millimetres"),
    ({"tool": {"mass_kg": 12, "com_mm": [0, 0, 80]}}, "key tool.com_m", "no such key, but 'com_mm'"),
    ({"tool": {"mass_kg": 12}}, "key tool.com_m", "no such key"),
    ({"targets_m": {"T1": [100, 0, 120]}}, "key targets_m.T1", "millimetres"),
    ({"instrument": {"position_std_m": 0.06}}, "key instrument.position_std_m", "millimetres"),
    ({"instrument": {"position_std_m": 0}}, "key instrument.position_std_m", "above 0"),
    ({"instrument": {"position_std": 6e-5}}, "key instrument.position_std", "position_std_m"),
    ({"targets": {"T1": [0, 0, 0]}, "targets_m": None}, "key targets", "targets_m"),
]


@pytest.mark.parametrize(("wrong", "key", "words"), HEADER_FAULTS)
def test_header_faults(tmp_path: Path, wrong: dict[str, object], key: str, words: str) -> None:
    header = {name: value for name, value in (HEADER | wrong).items() if value is not None}
    folder = write(tmp_path / "c", make_tables(), header)
    if "format" in wrong:
        text = (folder / "campaign.toml").read_text()
        (folder / "campaign.toml").write_text(text.replace("campaign/1", "campaign/2"))
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    says(str(caught.value), "campaign.toml", key, words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('poses = "poses.csv"', 'pose = "poses.csv"', "the unknown key 'pose'; did you mean 'poses'?"),
        ('poses = "poses.csv"', 'poses = "poses.xlsx"', "found no such file"),
        ('poses = "poses.csv"', 'poses = "campaign.toml"', "ending in .csv or .parquet"),
        ('format = "clampid-campaign/1"', "", "key format: expected"),
        ('robot = "kuka_kr20_r1810"', "", "key robot: expected a bundled robot"),
        ("[tables]", "[tables", "expected TOML"),
        ("[tables]", "[other]", "the unknown key 'other'"),
    ],
)
def test_header_text_faults(tmp_path: Path, old: str, new: str, words: str) -> None:
    file = write(tmp_path / "c", make_tables()) / "campaign.toml"
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(CampaignError, match=r"campaign\.toml|poses\.xlsx") as caught:
        read_campaign(tmp_path / "c")
    says(str(caught.value), words)


def test_no_folder_or_no_header(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="expected a campaign folder, found no such folder"):
        read_campaign(tmp_path / "absent")
    with pytest.raises(CampaignError, match=r"campaign\.toml: expected .* found no such file"):
        read_campaign(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(CampaignError, match="expected a campaign folder, found a file"):
        read_campaign(tmp_path / "file")


def test_columns_of_the_maker_are_the_contracts() -> None:
    assert columns("q{}_rad")[-1] == "q6_rad"
