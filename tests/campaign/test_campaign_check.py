"""What follows the contract but cannot be right, or cannot identify something, is found and said in words."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from campaign_maker import HEADER, ROBOT, Tables, change, columns, make_tables, write

from experiments.campaign import read_campaign
from experiments.checks.check import Finding, check_campaign, holdings

SHARED = Path(__file__).parents[2].parent / "shared"
POINTS = ("poses", "verification")
Q, QD, TAU, MOTOR, DIR = map(columns, ("q{}_rad", "qd{}_rad_s", "tau{}_Nm", "motor{}_rad", "dir{}"))
XYZ = ["x_m", "y_m", "z_m"]


def findings(folder: Path, tables: Tables, **header: object) -> tuple[Finding, ...]:
    return check_campaign(read_campaign(write(folder / "c", tables, HEADER | header, "parquet")))


def found(all_found: tuple[Finding, ...], severity: str, table: str, words: str) -> Finding:
    for finding in all_found:
        if (finding.severity, finding.table) == (severity, table) and words in finding.message:
            return finding
    raise AssertionError(f"no {severity} on {table} with {words!r} among:\n" + "\n".join(map(str, all_found)))


def scaled(names: list[str], factor: float) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda frame: frame.assign(**{name: frame[name] * factor for name in names})


def held(names: list[str]) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda frame: frame.assign(**{name: frame[name].iloc[0] for name in names})


FEW = "few for the geometry"  # twelve poses, which is all that is said of the campaign as it is made


def blamed(all_found: tuple[Finding, ...]) -> list[str]:
    return [f.table for f in all_found if f.severity != "note" and FEW not in f.message]


def test_a_good_campaign_has_nothing_but_notes_and_few_poses(tmp_path: Path) -> None:
    all_found = findings(tmp_path, make_tables())
    assert [f.severity for f in all_found if FEW in f.message] == ["warning"]
    assert blamed(all_found) == []


@pytest.mark.parametrize("table", ["free_air", "wrist", "poses", "verification"])
def test_degrees(tmp_path: Path, table: str) -> None:
    all_found = findings(tmp_path, change(table, scaled(Q, 180 / np.pi)))
    finding = found(all_found, "error", table, "joint angles look like degrees, radians are expected")
    assert finding.column in Q
    assert blamed(all_found) == [table]  # nothing else is blamed


def test_motor_degrees(tmp_path: Path) -> None:
    found(findings(tmp_path, change("clamped", scaled(MOTOR, 180 / np.pi))), "error", "clamped", "look like degrees")


def test_one_column_in_degrees(tmp_path: Path) -> None:
    finding = found(findings(tmp_path, change("poses", scaled(["q3_rad"], 180 / np.pi))), "error", "poses", "degrees")
    assert finding.column == "q3_rad"


@pytest.mark.parametrize("table", ["free_air", "wrist", "poses"])
def test_motor_angles_for_joint_angles(tmp_path: Path, table: str) -> None:
    def edit(frame: pd.DataFrame) -> pd.DataFrame:
        frame[Q] = np.linalg.solve(ROBOT.transmission.T, 1.5 * frame[Q].to_numpy().T).T
        return frame.drop(columns=QD, errors="ignore")

    found(findings(tmp_path, change(table, edit)), "error", table, "look like motor angles")


def test_joint_angles_for_motor_angles(tmp_path: Path) -> None:
    def edit(frame: pd.DataFrame) -> pd.DataFrame:
        frame[MOTOR] = frame[MOTOR].to_numpy() @ ROBOT.transmission
        return frame

    found(findings(tmp_path, change("clamped", edit)), "error", "clamped", "look like joint angles")


def test_beyond_limits(tmp_path: Path) -> None:
    def edit(frame: pd.DataFrame) -> pd.DataFrame:
        frame.loc[[7, 9], "q5_rad"] = 2.4
        return frame

    finding = found(findings(tmp_path, change("free_air", edit)), "warning", "free_air", "joint 5 is beyond its limits")
    assert finding.row == 8
    assert "in 2 of 24 rows" in finding.message


@pytest.mark.parametrize("table", POINTS)
@pytest.mark.parametrize(("factor", "unit"), [(1e3, "millimetres"), (100, "centimetres"), (39.37, "inches")])
def test_lengths(tmp_path: Path, table: str, factor: float, unit: str) -> None:
    all_found = findings(tmp_path, change(table, scaled(XYZ, factor)))
    found(all_found, "error", table, f"positions look like {unit}, metres are expected")
    assert blamed(all_found) == [table]


def test_millimetres_of_a_single_posture(tmp_path: Path) -> None:
    def edit(frame: pd.DataFrame) -> pd.DataFrame:
        return frame[(frame["pose"] == 1) & (frame["target"] == "T1")].assign(x_m=2500.0)

    found(findings(tmp_path, change("poses", edit)), "error", "poses", "look like millimetres")


@pytest.mark.parametrize("table", POINTS)
def test_mirrored_frame(tmp_path: Path, table: str) -> None:
    found(findings(tmp_path, change(table, scaled(["y_m"], -1.0))), "error", table, "fit when mirrored")


@pytest.mark.parametrize("table", POINTS)
def test_wrong_joint_sign(tmp_path: Path, table: str) -> None:
    found(findings(tmp_path, change(table, scaled(["q3_rad"], -1.0))), "error", table, "the sign of joint 3 turned")


@pytest.mark.parametrize("table", POINTS)
def test_swapped_targets(tmp_path: Path, table: str) -> None:
    swap = {"T1": "T3", "T3": "T1", "T2": "T2"}
    all_found = findings(tmp_path, change(table, lambda f: f.assign(target=f["target"].map(swap))))
    found(all_found, "error", table, "fit with targets T1 and T3 swapped")
    found(all_found, "warning", table, "apart in [targets_m]")


def test_one_bad_row(tmp_path: Path) -> None:
    def edit(frame: pd.DataFrame) -> pd.DataFrame:
        frame.loc[10, "z_m"] += 0.2
        return frame

    finding = found(findings(tmp_path, change("poses", edit)), "warning", "poses", "1 of 39 positions")
    assert finding.row == 11


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["qx", "qy", "qz", "qw"], "scalar last"),
        (None, "fit when inverted"),
        (["qw", "qy", "qx", "qz"], "order or sign"),
    ],
)
def test_quaternions(tmp_path: Path, names: list[str] | None, words: str) -> None:
    def edit(frame: pd.DataFrame) -> pd.DataFrame:
        if names is None:
            return frame.assign(qw=-frame["qw"])
        return frame.assign(**dict(zip(["qw", "qx", "qy", "qz"], frame[names].to_numpy().T, strict=True)))

    all_found = findings(tmp_path, change("poses", edit))
    assert any(words in f.message and f.column == "qw" for f in all_found), all_found


@pytest.mark.parametrize(
    ("table", "joint", "words"),
    [("free_air", 3, "friction"), ("wrist", 5, "wrist"), ("poses", 6, "zero offset")],
)
def test_still_joint(tmp_path: Path, table: str, joint: int, words: str) -> None:
    tables = change(table, held([f"q{joint}_rad"]))
    if "qd1_rad_s" in tables[table]:
        tables[table][f"qd{joint}_rad_s"] = 0.0
    finding = found(findings(tmp_path, tables), "warning", table, f"joint {joint} never moves")
    assert words in finding.message
    assert finding.column == f"q{joint}_rad"


class TestClamped:
    def test_a_joint_never_driven(self, tmp_path: Path) -> None:
        tables = change("clamped", lambda f: f[f["joint"] != 2])
        found(findings(tmp_path, tables), "warning", "clamped", "joint 2 is never driven")

    def test_two_joints_in_one_sweep(self, tmp_path: Path) -> None:
        def edit(frame: pd.DataFrame) -> pd.DataFrame:
            frame.loc[2, "joint"] = 4
            return frame

        found(findings(tmp_path, change("clamped", edit)), "warning", "clamped", "sweep 1 drives joints 1, 4")

    def test_the_driven_motor_stands(self, tmp_path: Path) -> None:
        tables = change("clamped", held(["motor3_rad"]))
        found(findings(tmp_path, tables), "warning", "clamped", "joint 3 is driven but its motor never moves")

    def test_the_flange_is_free(self, tmp_path: Path) -> None:
        def edit(frame: pd.DataFrame) -> pd.DataFrame:
            frame.loc[3, "motor1_rad"] += 20.0
            return frame

        found(findings(tmp_path, change("clamped", edit)), "warning", "clamped", "was the flange clamped?")

    def test_unknown_transmission(self, tmp_path: Path) -> None:
        all_found = findings(tmp_path, {"clamped": make_tables()["clamped"]}, robot="ur10")
        found(all_found, "warning", "clamped", "the transmission of ur10 is not known")


@pytest.mark.parametrize("table", POINTS)
def test_unknown_directions(tmp_path: Path, table: str) -> None:
    tables = change(table, lambda f: f.assign(**dict.fromkeys(DIR, 0)))
    found(findings(tmp_path, tables), "note", table, "approach directions of all joints are unknown (0)")


def test_one_approach_direction(tmp_path: Path) -> None:
    finding = found(
        findings(tmp_path, change("poses", lambda f: f.assign(dir4=-1))), "warning", "poses", "one side (-1)"
    )
    assert finding.column == "dir4"


@pytest.mark.parametrize("table", ["free_air", "wrist", "clamped"])
class TestTorques:
    @pytest.mark.parametrize(("value", "words"), [(0.0, "is zero"), (1.5, "is 1.5 Nm")])
    def test_constant(self, tmp_path: Path, table: str, value: float, words: str) -> None:
        finding = found(findings(tmp_path, change(table, lambda f: f.assign(tau2_Nm=value))), "warning", table, words)
        assert finding.column == "tau2_Nm"

    def test_joint_side(self, tmp_path: Path, table: str) -> None:
        def edit(frame: pd.DataFrame) -> pd.DataFrame:
            frame[TAU] = np.linalg.solve(ROBOT.transmission, frame[TAU].to_numpy().T).T
            return frame

        found(findings(tmp_path, change(table, edit)), "warning", table, "far above what the motors can give")


@pytest.mark.parametrize("table", ["free_air", "wrist", "clamped", "poses", "verification"])
class TestTemperatures:
    def test_kelvin(self, tmp_path: Path, table: str) -> None:
        def edit(frame: pd.DataFrame) -> pd.DataFrame:
            names = [name for name in frame if name.startswith("temp_")]
            return frame.assign(**{name: frame[name] + 273.15 for name in names})

        found(findings(tmp_path, change(table, edit)), "error", table, "look like kelvin")

    def test_open_sensor(self, tmp_path: Path, table: str) -> None:
        def edit(frame: pd.DataFrame) -> pd.DataFrame:
            name = next(name for name in frame if name.startswith("temp_"))
            frame.loc[4, name] = 850.0
            return frame

        assert found(findings(tmp_path, change(table, edit)), "error", table, "implausible").row == 5


@pytest.mark.parametrize("table", ["free_air", "wrist"])
class TestVelocities:
    @pytest.mark.parametrize(
        ("names", "factor", "severity", "words"),
        [
            (QD, 180 / np.pi, "error", "velocities look like deg/s"),
            (["time_s"], 1e3, "error", "times look like milliseconds"),
            (QD, -1.0, "warning", "opposite sign"),
            (QD, 0.0, "warning", "all zero while positions change"),
            (["time_s"], 10.0, "warning", "count rows"),
        ],
    )
    def test_factors(
        self, tmp_path: Path, table: str, names: list[str], factor: float, severity: str, words: str
    ) -> None:
        found(findings(tmp_path, change(table, scaled(names, factor))), severity, table, words)

    def test_other_columns(self, tmp_path: Path, table: str) -> None:
        rng = np.random.default_rng(1)
        tables = change(table, lambda f: f.assign(**{name: rng.normal(size=len(f)) for name in QD}))
        found(findings(tmp_path, tables), "warning", table, "velocities follow positions")

    def test_shifted_in_time(self, tmp_path: Path, table: str) -> None:
        tables = change(
            table, lambda f: f.assign(**{name: f.groupby("run")[name].shift(6, fill_value=0.0) for name in QD})
        )
        found(findings(tmp_path, tables), "warning", table, "only in part (shifted in time")

    def test_unread_unit(self, tmp_path: Path, table: str) -> None:
        names = {name: name.replace("rad", "deg") for name in QD}
        tables = change(table, lambda f: f.rename(columns=names))
        found(findings(tmp_path, tables), "warning", table, "qd1_deg_s is not read")


class TestStops:
    def test_returns(self, tmp_path: Path) -> None:
        found(findings(tmp_path, change("poses", lambda f: f)), "note", "poses", "3 repeated points")
        tables = change("poses", lambda f: f[f["visit"] == 1])
        found(findings(tmp_path / "b", tables), "note", "poses", "0 repeated points")

    def test_returns_at_another_temperature_are_not_replicates(self, tmp_path: Path) -> None:
        tables = change("poses", lambda f: f.assign(temp_link1_C=f["temp_link1_C"] + f["visit"]))
        found(findings(tmp_path, tables), "note", "poses", "0 repeated points")

    def test_visits_not_counted(self, tmp_path: Path) -> None:
        found(findings(tmp_path, change("poses", lambda f: f.assign(visit=1))), "warning", "poses", "within one visit")

    def test_one_number_for_several_postures(self, tmp_path: Path) -> None:
        tables = change("poses", lambda f: f.assign(pose=f["pose"].replace(3, 2), visit=f["pose"] * 10 + f["visit"]))
        found(findings(tmp_path, tables), "warning", "poses", "stand for several postures, first pose 2")

    def test_copied_return(self, tmp_path: Path) -> None:
        def edit(frame: pd.DataFrame) -> pd.DataFrame:
            frame.loc[36:, XYZ] = frame.loc[:2, XYZ].to_numpy()
            return frame

        found(findings(tmp_path, change("poses", edit)), "warning", "poses", "3 returns have exactly the position")

    def test_order_and_clock(self, tmp_path: Path) -> None:
        tables = change("verification", lambda f: f.iloc[::-1].assign(time_s=f["time_s"].iloc[::-1] - 1000.0))
        tables["poses"] = make_tables()["poses"]
        all_found = findings(tmp_path, tables)
        found(all_found, "note", "verification", "not in order of time")
        found(all_found, "note", "verification", "starts before poses ends")


def test_instrument(tmp_path: Path) -> None:
    all_found = findings(tmp_path, change("poses", lambda f: f), instrument={"position_std_m": 2e-3})
    found(all_found, "warning", "campaign.toml", "can hardly see a robot's errors")


def test_angles_of_another_robot_are_not_called_degrees(tmp_path: Path) -> None:
    tables = change("poses", lambda f: f.assign(q3_rad=f["q3_rad"] + 7.0))
    said = found(findings(tmp_path, tables), "error", "poses", "is it another robot's data, or are they degrees?")
    assert "look like degrees" not in said.message


def test_columns_of_another_robot(tmp_path: Path) -> None:
    tables = change("free_air", lambda f: f.assign(q7_rad=0.0, temp_motor1_K=290.0))
    all_found = findings(tmp_path, tables)
    found(all_found, "warning", "free_air", "q7_rad is not read")
    found(all_found, "warning", "free_air", "temp_motor1_K is not read")


@pytest.mark.parametrize("table", ["free_air", "wrist", "clamped", "poses", "verification"])
@pytest.mark.parametrize("rows", [1, 2, 3, 4, 5])
def test_a_few_rows_are_looked_at_too(tmp_path: Path, table: str, rows: int) -> None:
    all_found = findings(tmp_path, change(table, lambda f: f.iloc[:rows]))
    assert not [f for f in all_found if f.severity == "error"]


def test_holdings(tmp_path: Path) -> None:
    held = holdings(read_campaign(write(tmp_path / "cell", make_tables())))
    assert json.loads(json.dumps(held)) == held
    assert held["campaign"] == "cell"
    assert held["tables"]["free_air"]["joints_moved"] == [1, 2, 3, 4, 5, 6]
    assert held["tables"]["wrist"]["joints_moved"] == [4, 5, 6]
    assert held["tables"]["clamped"] == {
        "rows": 24, "duration_s": 53.0, "joints_moved": [1, 2, 3, 4, 5, 6], "temperatures": ["temp_ambient_C"],
        "sweeps": 6, "fixture": True,
    }  # fmt: skip
    poses = held["tables"]["poses"]
    assert (poses["poses"], poses["visits"], poses["replicates"], poses["orientation"]) == (12, 13, 3, True)


CAMPAIGNS = sorted(p.parent for p in SHARED.glob("*/*/campaign.toml")) if SHARED.is_dir() else []


@pytest.mark.skipif(not CAMPAIGNS, reason=f"the shared campaigns are not at {SHARED}")
@pytest.mark.parametrize("folder", CAMPAIGNS, ids=lambda p: p.name)
def test_shared_campaigns(folder: Path) -> None:
    campaign = read_campaign(folder)
    assert [f for f in check_campaign(campaign) if f.severity == "error"] == []
    assert set(holdings(campaign)["tables"]) == set(campaign.tables)
