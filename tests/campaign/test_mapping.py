"""Readers for what instruments write: units, medians, and what a mapping cannot mean."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from foreign_files import CAMPAIGN
from import_call import call

from clampid.verbs.errors import is_wrong_input
from experiments.campaign import Campaign, read_campaign, write_campaign
from experiments.foreign.medians import medians
from experiments.simulate import simulate
from experiments.tables import TableFile

MAPPING = (
    """format = "clampid-mapping/1"
table = "poses"
delimiter = ";"
decimal = ","
skip_lines = 2
repeats = "median"

[columns]
pose = {from = "Point"}
target = {from = "SMR"}
time = {from = "t", unit = "ms"}
q1 = {from = "A1", unit = "deg", scale = -1}
q2 = {from = "A2", unit = "deg"}
q3 = {from = "A3", unit = "deg"}
q4 = {from = "A4", unit = "deg"}
q5 = {from = "A5", unit = "deg"}
q6 = {from = "A6", unit = "deg"}
x = {from = "X [mm]", unit = "mm"}
y = {from = "Y [mm]", unit = "mm"}
z = {from = "Z [mm]", unit = "mm"}
temp_ambient = {from = "T", unit = "K"}
"""
    + CAMPAIGN
)


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    folder = tmp_path_factory.mktemp("import") / "arm"
    simulate(folder, robot="kuka_kr20_r1810", poses=20, seed=1, tables=("poses",))
    return read_campaign(folder)


def written(original: Campaign, folder: Path, samples: int = 5) -> Path:
    """Write the poses as a tracker's own software would, each point sampled several times, one sample far off."""
    table = original.tables["poses"]
    table = table[table["visit"] == 1].reset_index(drop=True)
    rng = np.random.default_rng(0)
    rows = table.loc[np.repeat(np.arange(len(table)), samples)].reset_index(drop=True)
    xyz = 1e3 * rows[["x_m", "y_m", "z_m"]].to_numpy() + 0.01 * rng.standard_normal((len(rows), 3))
    xyz[::samples] += 50.0
    out = pd.DataFrame({"Point": "P" + rows["pose"].astype(str), "SMR": rows["target"], "t": 1e3 * rows["time_s"]})
    for i in range(6):
        out[f"A{i + 1}"] = np.rad2deg(rows[f"q{i + 1}_rad"]) * (-1 if i == 0 else 1)
    out[["X [mm]", "Y [mm]", "Z [mm]"]] = xyz
    out["T"] = 294.15
    file = folder / "points.txt"
    body = out.to_csv(index=False, sep=";", decimal=",")
    file.write_text("Tracker 3\nmeasured today\n" + body, encoding="utf-8")
    return file


def test_a_trackers_table_becomes_the_campaign_that_it_is(original: Campaign, tmp_path: Path) -> None:
    file, mapping = written(original, tmp_path), tmp_path / "m.toml"
    mapping.write_text(MAPPING)
    ran = call(mapping, file, "-o", tmp_path / "arm")
    assert ran.exit_code == 0, ran.output
    table, source = read_campaign(tmp_path / "arm").tables["poses"], original.tables["poses"]
    source = source[source["visit"] == 1].reset_index(drop=True)
    assert len(table) == len(source)
    for i in range(6):
        np.testing.assert_allclose(table[f"q{i + 1}_rad"], source[f"q{i + 1}_rad"], atol=1e-12)
        assert (table[f"dir{i + 1}"] == 0).all()
    off = (table[["x_m", "y_m", "z_m"]] - source[["x_m", "y_m", "z_m"]]).abs().to_numpy()
    assert off.max() < 4e-5  # a median of five with one that is 50 mm off
    assert (table["samples"] == 5).all()
    assert 4e-6 < np.median(table["scatter_x_m"]) < 2e-5
    np.testing.assert_allclose(table["temp_ambient_C"], 21.0, atol=1e-9)
    np.testing.assert_allclose(table["time_s"], source["time_s"], atol=1e-9)


@pytest.mark.parametrize("samples", [2, 3, 4, 5, 8, 9, 10, 25])
def test_the_scatter_of_a_sample_does_not_depend_on_how_many_there_are(tmp_path: Path, samples: int) -> None:
    rng, points = np.random.default_rng(samples), 500
    rows = np.repeat(np.arange(points), samples)
    frame = pd.DataFrame({"pose": rows, "visit": 1, "target": "T1", "time_s": 0.0})
    frame[[f"q{i + 1}_rad" for i in range(6)]] = 0.0
    frame[["x_m", "y_m", "z_m"]] = 2e-5 * rng.standard_normal((len(rows), 3))
    source = TableFile(tmp_path / "points.txt", 0)
    table, scatter, _ = medians(frame, source, 6)
    np.testing.assert_allclose(scatter, 2e-5, rtol=0.12)
    np.testing.assert_allclose(table[["scatter_x_m", "scatter_y_m", "scatter_z_m"]].median(), scatter)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('unit = "deg", scale = -1', 'unit = "rad", scale = -1', r"key columns.q1: .*turns, found 'rad'; 'deg'"),
        (
            'from = "A2", unit = "deg"',
            'from = "A2"',
            "columns.q2: expected a unit, one of rad, deg, mrad, .*, found ''",
        ),
        ('unit = "mm"}', 'unit = "furlong"}', "columns.x: expected a unit, one of m, mm, um, inch, found 'furlong'"),
        (
            'from = "A3"',
            'from = "J3"',
            "points.txt: expected a column 'J3', as m.toml says in columns.q3, found the columns Point",
        ),
        (
            'repeats = "median"\n',
            "",
            r"row 2 \(line 5\): expected one row of pose 1, visit 1, target T1 \(in m.toml, repeats.*found 5",
        ),
        ('repeats = "median"', 'repeats = "mean"', "key repeats: expected one of median, found 'mean'"),
        ("skip_lines = 2", "skip_lines = 0", "expected"),
        ('decimal = ","', 'decimal = "."', r"points.txt, row 1 \(line 4\), column t: expected a number, found '"),
        ('x = {from = "X [mm]", unit = "mm"}', "", "expected columns to say where x comes from"),
        ("delimiter", "delimeter", "key delimeter: .*, found the unknown key .* did you mean 'delimiter'"),
        ('"kuka_kr20_r1810"', '"kuka_kr20"', "key campaign.robot: "),
        ('unit = "mm"}', 'unit = "m"}', "poses"),  # what a check of the campaign finds
    ],
)
def test_what_a_mapping_cannot_mean_is_refused(
    original: Campaign, tmp_path: Path, old: str, new: str, words: str
) -> None:
    file, mapping = written(original, tmp_path), tmp_path / "m.toml"
    assert old in MAPPING
    mapping.write_text(MAPPING.replace(old, new))
    ran = call(mapping, file, "-o", tmp_path / "arm")
    assert ran.exception is not None
    with pytest.raises(type(ran.exception), match=words):
        raise ran.exception
    assert is_wrong_input(ran.exception)
    assert not (tmp_path / "arm").exists()


def test_radians_called_degrees_are_refused(original: Campaign, tmp_path: Path) -> None:
    write_campaign(tmp_path / "plain", dict(original.header), {"poses": original.tables["poses"]}, "csv")
    lines = [f'q{i + 1} = {{from = "q{i + 1}_rad", unit = "deg"}}' for i in range(6)]
    lines += [f'{axis} = {{from = "{axis}_m", unit = "m"}}' for axis in "xyz"]
    lines += ['pose = {from = "pose"}', 'visit = {from = "visit"}', 'target = {from = "target"}']
    head = 'format = "clampid-mapping/1"\n[columns]\n' + "\n".join(lines)
    (tmp_path / "m.toml").write_text(head + "\n" + MAPPING[MAPPING.index("[campaign]") :])
    ran = call(tmp_path / "m.toml", tmp_path / "plain" / "poses.csv", "-o", tmp_path / "arm")
    assert "found 'deg'; 'rad' is probably meant" in str(ran.exception)
    (tmp_path / "m.toml").write_text((head + "\n" + MAPPING[MAPPING.index("[campaign]") :]).replace('"deg"', '"rad"'))
    assert call(tmp_path / "m.toml", tmp_path / "plain" / "poses.csv", "-o", tmp_path / "arm").exit_code == 0
