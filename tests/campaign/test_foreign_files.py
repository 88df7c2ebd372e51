"""What instruments and controllers really write comes back as the campaign that it was, number by number."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from foreign_files import ANGLES, CAMPAIGN, HEAD, JOINTS, PLACE, POINT, XYZ, agree, imported, refused
from import_call import call

from experiments.campaign import Campaign, read_campaign


def test_a_tracker_export_with_a_preamble_comments_and_a_line_of_units(points: pd.DataFrame, tmp_path: Path) -> None:
    lines = points.to_csv(index=False, sep=";", decimal=",").splitlines()
    text = ["Laser Tracker Export", "Op\u00e9rateur: M\u00fcller", "", f"{lines[0]};", ";;deg;;;;;;mm;mm;mm;"]
    text += [f"{line};" + ("\n\n// beam was interrupted" if k == 4 else "") for k, line in enumerate(lines[1:])]
    file = tmp_path / "export.txt"
    file.write_bytes("\r\n".join("\n".join(text).split("\n")).encode("cp1252"))
    reading = 'delimiter = ";"\ndecimal = ","\nskip_lines = 3\nskip_after_names = 1\ncomment = "//"\n'
    found = imported(tmp_path, HEAD + reading + "[columns]\n" + POINT + JOINTS + PLACE + CAMPAIGN, file)
    agree(found, points)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "cp1252"])
def test_encodings(points: pd.DataFrame, tmp_path: Path, encoding: str) -> None:
    named = points.rename(columns={"X": "X [\u00b5m]"}).assign(**{"X [\u00b5m]": 1e3 * points["X"]})
    file = tmp_path / "points.csv"
    file.write_bytes(named.to_csv(index=False).encode(encoding))
    place = PLACE.replace('{from = "X"}', '{from = "X [\u00b5m]", unit = "um"}')
    agree(imported(tmp_path, HEAD + "[columns]\n" + POINT + JOINTS + place + CAMPAIGN, file), points)


def test_columns_of_spaces_and_tabs_without_a_line_of_names(points: pd.DataFrame, tmp_path: Path) -> None:
    file = tmp_path / "points.asc"
    body = [
        " \t".join(f"{v:>14.9f}" if isinstance(v, float) else str(v) for v in row) for row in points.values.tolist()
    ]
    file.write_text("# measured\n  " + "\n  ".join(body) + "\n# end\n")
    names = f"names = {list(points.columns)}\n".replace("'", '"')
    reading = 'delimiter = "space"\ncomment = ["#", "!"]\n' + names
    agree(imported(tmp_path, HEAD + reading + "[columns]\n" + POINT + JOINTS + PLACE + CAMPAIGN, file), points)


def test_nominal_and_measured_columns_of_one_name_are_taken_by_number(points: pd.DataFrame, tmp_path: Path) -> None:
    file = tmp_path / "points.csv"
    twice = pd.concat([points, points[["X", "Y", "Z"]] + 7.0], axis=1)
    file.write_text(twice.to_csv(index=False))
    mapping = HEAD + "[columns]\n" + POINT + JOINTS
    words = refused(tmp_path, mapping + PLACE + CAMPAIGN, file)
    assert "expected one column 'X', as m.toml says in columns.x, found columns 9, 12 of that name" in words
    agree(imported(tmp_path, mapping + PLACE.replace('"X"', "9").replace('"Y"', "10").replace('"Z"', "11") + CAMPAIGN,
                   file), points)  # fmt: skip


@pytest.mark.parametrize(
    ("zenith", "clockwise", "unit", "factor"), [(False, False, "deg", 180.0), (True, True, "gon", 200.0)]
)
def test_range_azimuth_and_elevation(
    points: pd.DataFrame, tmp_path: Path, zenith: bool, clockwise: bool, unit: str, factor: float
) -> None:
    x, y, z = points[["X", "Y", "Z"]].to_numpy().T
    azimuth, elevation = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    polar = points.drop(columns=["X", "Y", "Z"]).assign(
        R=np.sqrt(x**2 + y**2 + z**2),
        Hz=np.mod((-azimuth if clockwise else azimuth) * factor / np.pi, 2 * factor),
        V=(np.pi / 2 - elevation if zenith else elevation) * factor / np.pi,
    )
    file = tmp_path / "polar.csv"
    file.write_text(polar.to_csv(index=False))
    position = f'[position]\nkind = "spherical"\nfrom = ["R", "Hz", "V"]\nangle = "{unit}"\n'
    position += f'elevation = "{"zenith" if zenith else "horizon"}"\n'
    position += f'azimuth = "{"clockwise" if clockwise else "counterclockwise"}"\n'
    agree(imported(tmp_path, HEAD + "[columns]\n" + POINT + JOINTS + position + CAMPAIGN, file), points)


def test_points_and_angles_in_two_files_by_name_and_in_order(points: pd.DataFrame, tmp_path: Path) -> None:
    angles = points.drop_duplicates("Point")[["Point", *[f"A{i + 1}" for i in range(6)]]]
    (tmp_path / "points.csv").write_text(points[["Point", "SMR", "X", "Y", "Z"]].to_csv(index=False))
    shuffled = angles.sample(frac=1.0, random_state=0).rename(columns={"Point": "Name"})
    (tmp_path / "angles.txt").write_text(shuffled.to_csv(index=False, sep=";", decimal=","))
    mapping = HEAD + 'files = "points.csv"\n[columns]\n' + POINT + JOINTS + PLACE
    join = '[join]\nfiles = "angles.txt"\ndelimiter = ";"\ndecimal = ","\n'
    agree(imported(tmp_path, mapping + join + 'on = ["Point", "Name"]\n' + CAMPAIGN), points)

    (tmp_path / "ordered.txt").write_text(angles.drop(columns="Point").to_csv(index=False, sep=";", decimal=","))
    ordered = join.replace("angles", "ordered") + 'order = "Point"\n'
    (tmp_path / "two").mkdir()
    (tmp_path / "m2.toml").write_text(mapping + ordered + CAMPAIGN)
    ran = call(tmp_path / "m2.toml", "-o", tmp_path / "two" / "arm")
    assert ran.exit_code == 0, ran.exception
    agree(read_campaign(tmp_path / "two" / "arm"), points)


def test_a_point_without_angles_and_angles_too_few_are_refused(points: pd.DataFrame, tmp_path: Path) -> None:
    angles = points.drop_duplicates("Point")[["Point", *[f"A{i + 1}" for i in range(6)]]]
    (tmp_path / "points.csv").write_text(points[["Point", "SMR", "X", "Y", "Z"]].to_csv(index=False))
    (tmp_path / "angles.csv").write_text(angles[angles["Point"] != "P3"].to_csv(index=False))
    mapping = HEAD + 'files = "points.csv"\n[columns]\n' + POINT + JOINTS + PLACE + '[join]\nfiles = "angles.csv"\n'
    words = refused(tmp_path, mapping + 'on = "Point"\nprefix = "robot "\n' + CAMPAIGN)
    row = int(np.flatnonzero(points["Point"] == "P3")[0]) + 1
    assert f"points.csv, row {row} (line {row + 1}), column Point: expected a value that column Point of" in words
    assert "found 'P3'" in words
    count = points["Point"].nunique()
    words = refused(tmp_path, mapping + 'order = "Point"\n' + CAMPAIGN)
    assert f"angles.csv: expected {count} rows" in words
    assert f"found {count - 1}" in words
    double = pd.concat([angles, angles.iloc[[1]]])
    (tmp_path / "angles.csv").write_text(double.to_csv(index=False))
    words = refused(tmp_path, mapping + 'on = "Point"\nprefix = "robot "\n' + CAMPAIGN)
    assert f"angles.csv, row {count + 1} (line {count + 2}), column Point: expected every value once" in words


def test_several_tables_of_several_files_on_one_clock(original: Campaign, points: pd.DataFrame, tmp_path: Path) -> None:
    start = datetime(2026, 11, 23, 23, 50, 0, 500000)
    stamps = [start + timedelta(seconds=30.0 * k) for k in range(len(points))]
    half = len(points) // 2
    for name, rows in (("day1", slice(0, half)), ("day2", slice(half, None))):
        part = points.iloc[rows].assign(
            Date=[s.strftime("%d.%m.%Y") for s in stamps[rows]], Time=[s.strftime("%H:%M:%S.%f") for s in stamps[rows]]
        )
        (tmp_path / f"{name}.csv").write_text(part.to_csv(index=False))
    later = points.assign(When=[(s + timedelta(hours=5)).isoformat() for s in stamps])
    (tmp_path / "check.csv").write_text(later.to_csv(index=False))
    log = original.tables["free_air"]
    for run, rows in log.groupby("run"):
        out = pd.DataFrame({"t [ms]": 1e3 * rows["time_s"]})
        for i in range(6):
            out[f"A{i + 1}"], out[f"M{i + 1}"] = np.rad2deg(rows[ANGLES[i]]), rows[f"tau{i + 1}_Nm"]
        (tmp_path / f"log_{run}.csv").write_text(out.to_csv(index=False))
    torques = "\n".join(f'tau{i + 1} = {{from = "M{i + 1}"}}' for i in range(6)) + "\n"
    date = 'time = {from = ["Date", "Time"], unit = "date", pattern = "%d.%m.%Y %H:%M:%S.%f"}\n'
    mapping = HEAD + CAMPAIGN.replace("[campaign]", "[campaign]")
    mapping += '[[tables]]\ntable = "poses"\nfiles = ["day1.csv", "day2.csv"]\n[tables.columns]\n'
    mapping += POINT + JOINTS + PLACE + date
    mapping += '[[tables]]\ntable = "verification"\nfiles = "check.csv"\n[tables.columns]\n'
    mapping += POINT + JOINTS + PLACE + 'time = {from = "When", unit = "date"}\n'
    mapping += '[[tables]]\ntable = "free_air"\nfiles = "log_*.csv"\n[tables.columns]\n'
    mapping += JOINTS + torques + 'time = {from = "t [ms]", unit = "ms"}\n'
    found = imported(tmp_path, mapping)
    poses = agree(found, points)
    np.testing.assert_allclose(poses["time_s"], 30.0 * np.arange(len(points)), atol=1e-6)
    np.testing.assert_allclose(found.tables["verification"]["time_s"], poses["time_s"] + 18000.0, atol=1e-6)
    read = found.tables["free_air"]
    assert read["run"].nunique() == log["run"].nunique()
    for name in ("time_s", "q2_rad", "tau3_Nm"):
        np.testing.assert_allclose(read[name], log[name], atol=1e-9)


def test_clocks_without_a_date_must_not_pass_midnight(points: pd.DataFrame, tmp_path: Path) -> None:
    start = datetime(2026, 11, 23, 23, 59, 0)
    stamps = [(start + timedelta(seconds=30.0 * k)).strftime("%H:%M:%S") for k in range(len(points))]
    (tmp_path / "points.csv").write_text(points.assign(Time=stamps).to_csv(index=False))
    time = 'time = {from = "Time", unit = "date", pattern = "%H:%M:%S"}\n'
    words = refused(tmp_path, HEAD + "[columns]\n" + POINT + JOINTS + PLACE + time + CAMPAIGN, tmp_path / "points.csv")
    assert "row 3 (line 4), column Time: expected a date with the time of day, since the clock passes midnight" in words


def test_poses_numbered_by_posture_visits_by_return_and_directions_by_order(
    points: pd.DataFrame, tmp_path: Path
) -> None:
    one = points[points["SMR"] == "T1"].drop(columns="Point").reset_index(drop=True)
    back = pd.concat([one.iloc[:5], one.iloc[[3, 1]]]).reset_index(drop=True)
    (tmp_path / "points.csv").write_text(back.to_csv(index=False))
    mapping = 'directions = "previous"\n[columns]\npose = {number = "postures"}\nvisit = {number = "returns"}\n'
    mapping += 'target = {from = "SMR"}\n'
    found = imported(tmp_path, HEAD + mapping + JOINTS + PLACE + CAMPAIGN, tmp_path / "points.csv").tables["poses"]
    assert list(found["pose"]) == [1, 2, 3, 4, 5, 4, 2]
    assert list(found["visit"]) == [1, 1, 1, 1, 1, 2, 2]
    assert (found.loc[0, [f"dir{i + 1}" for i in range(6)]] == 0).all()
    assert found.loc[1, "dir2"] == np.sign(back["A2"][1] - back["A2"][0])


def test_lost_points_and_temperatures_in_fahrenheit_with_gaps(points: pd.DataFrame, tmp_path: Path) -> None:
    warm = points.assign(T=[f"{70.0 + 0.01 * k:.3f}" for k in range(len(points))])
    warm.loc[3, "T"] = "---"
    warm["X"] = warm["X"].map("{:.6f}".format)
    warm.loc[5, "X"] = "-9999"
    (tmp_path / "points.csv").write_text(warm.to_csv(index=False))
    mapping = 'lost = ["-9999", ""]\n[columns]\n' + POINT + JOINTS + PLACE
    mapping += 'temp_link1 = {from = "T", unit = "degF"}\n'
    found = imported(tmp_path, HEAD + mapping + CAMPAIGN, tmp_path / "points.csv").tables["poses"]
    assert len(found) == len(points) - 1
    assert np.flatnonzero(found["temp_link1_C"].isna()).tolist() == [3]
    np.testing.assert_allclose(found["temp_link1_C"][0], (70.0 - 32.0) * 5 / 9)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[0.0, 0.0, -9.81]", "[0.0, 0.0, -9810.0]", "m.toml, key campaign.gravity_m_s2: expected gravity"),
        ("mass_kg = 12.0", "mass_kg = 12000.0", "campaign.tool.mass_kg: .* of kg from 0 to 3000, .*grams"),
        ("T1 = [0.10, 0.00, 0.12], ", "", r"points.csv, row 1 \(line 2\), column SMR: expected a target"),
        ('x = {from = "X"}', 'X = {from = "X"}', r"key columns.X: expected x \(no unit in the name\), found 'X'"),
        ('x = {from = "X"}', 'x_mm = {from = "X"}', r"key columns.x_mm: expected x \(no unit in the name\)"),
        ('z = {from = "Z"}', 'z = {value = "up"}', "key columns.z.value: expected a finite number, found 'up'"),
        ('q1 = {from = "A1"}', 'q1 = {from = "A1", unit = "mm"}', "columns.q1: expected a unit of a revolute joint"),
        ('angle = "deg"', 'angle = "grad"', "key units.angle: expected a unit, one of rad, deg"),
        ("[columns]", 'encoding = "utf-9"\n[columns]', "key encoding: expected an encoding that Python knows"),
        (
            "[columns]",
            'delimiter = ";"\n[columns]',
            r"found the columns Point,SMR,.* \(one column: is the delimiter commas\?",
        ),
    ],
)
def test_wrong_mappings_are_refused(points: pd.DataFrame, tmp_path: Path, old: str, new: str, words: str) -> None:
    (tmp_path / "points.csv").write_text(points.to_csv(index=False))
    mapping = HEAD + "[columns]\n" + POINT + JOINTS + PLACE + CAMPAIGN
    assert old in mapping
    found = refused(tmp_path, mapping.replace(old, new), tmp_path / "points.csv")
    assert re.search(words, found), found


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda lines: [*lines[:5], lines[0], *lines[5:]],
            r"row 5 \(line 6\), column A1: .*found the line of names again",
        ),
        (lambda lines: [*lines[:3], lines[3] + ",1", *lines[4:]], r"row 3 \(line 4\): expected 11 cells, .*found 12"),
        (lambda lines: [*lines[:3], lines[3].replace(".", ",", 1), *lines[4:]], r"row 3 \(line 4\): expected 11 cells"),
        (lambda lines: lines[:1], "expected at least one row, found a line of names and no rows"),
        (lambda lines: [], "expected a line of names and rows"),
    ],
)
def test_wrong_files_are_refused(
    points: pd.DataFrame, tmp_path: Path, change: Callable[[list[str]], list[str]], words: str
) -> None:
    lines = change(points.to_csv(index=False).splitlines())
    (tmp_path / "points.csv").write_text("\n".join(lines) + "\n")
    found = refused(tmp_path, HEAD + "[columns]\n" + POINT + JOINTS + PLACE + CAMPAIGN, tmp_path / "points.csv")
    assert re.search(words, found), found


def test_a_point_with_thousands_of_a_decimal_comma_is_refused_unless_said(points: pd.DataFrame, tmp_path: Path) -> None:
    text = points.to_csv(index=False, sep=";", decimal=",")
    swiss = points.assign(**{c: [f"{v:_.6f}".replace(".", ",").replace("_", ".") for v in points[c]] for c in "XYZ"})
    (tmp_path / "points.csv").write_text(swiss.to_csv(index=False, sep=";", decimal=","))
    assert text != (tmp_path / "points.csv").read_text()
    reading = 'delimiter = ";"\ndecimal = ","\n'
    mapping = "[columns]\n" + POINT + JOINTS + PLACE + CAMPAIGN
    words = refused(tmp_path, HEAD + reading + mapping, tmp_path / "points.csv")
    assert "expected a number with a decimal comma, found" in words
    found = imported(tmp_path, HEAD + reading + 'thousands = "."\n' + mapping, tmp_path / "points.csv")
    np.testing.assert_allclose(found.tables["poses"][XYZ], points[["X", "Y", "Z"]] / 1e3, atol=1e-8)


def test_a_workbook_is_refused(tmp_path: Path) -> None:
    (tmp_path / "points.xlsx").write_bytes(b"PK\x03\x04rest")
    words = refused(tmp_path, HEAD + "[columns]\n" + POINT + JOINTS + PLACE + CAMPAIGN, tmp_path / "points.xlsx")
    assert "save it as CSV" in words
