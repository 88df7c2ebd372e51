"""What `clampid check` must not say of campaigns in which nothing is wrong."""

from pathlib import Path

import numpy as np
import pytest

from experiments.campaign import read_campaign
from experiments.checks.check import check_campaign
from experiments.second_world import draw_robot, measure
from experiments.signals import stale_rows


def said(folder: Path, severities: tuple[str, ...] = ("error", "warning")) -> list[str]:
    return [f.message for f in check_campaign(read_campaign(folder)) if f.severity in severities]


@pytest.mark.parametrize(
    ("name", "individual", "mounting", "noise", "seed"),
    [("small6", 23, "wall", "white", 13), ("seven7", 20, "floor", "student", 10)],
)
def test_on_a_line_the_description_is_not_called_a_mistake(tmp_path, name, individual, mounting, noise, seed):
    robot = draw_robot(name, individual, mounting=mounting)
    measure(robot, tmp_path / "c", program="line24", noise=noise, seed=seed, tables=("poses", "verification"))
    few, line = said(tmp_path / "c")
    assert "on a line" in line
    assert "are few for" in few


def test_on_a_line_exchanged_joints_are_still_seen(tmp_path):
    measure(draw_robot("small6", 23), tmp_path / "c", program="line24", noise="white", seed=13, tables=("poses",))
    file = tmp_path / "c" / "poses.csv"
    text = file.read_text()
    file.write_text(text.replace("q2_rad", "q9_rad", 1).replace("q3_rad", "q2_rad", 1).replace("q9_rad", "q3_rad", 1))
    assert any("mm (median) from the nominal ones" in message for message in said(tmp_path / "c"))


@pytest.mark.parametrize("seed", [13, 41])
def test_stops_of_a_slow_log_are_no_repeated_rows(tmp_path, seed):
    measure(
        draw_robot("small6", 23), tmp_path / "c", log="trapezoids_10hz", noise="white", seed=seed, tables=("free_air",)
    )
    assert not [m for m in said(tmp_path / "c") if "repeat" in m]


def test_a_source_slower_than_the_log_is_still_seen(tmp_path):
    robot = draw_robot("small6", 23)
    measure(robot, tmp_path / "c", log="trapezoids_250hz", noise="white", seed=13, tables=("free_air",))
    frame = read_campaign(tmp_path / "c").tables["free_air"]
    q = frame[[f"q{j}_rad" for j in range(1, 7)]].to_numpy()
    held = q[(np.arange(len(q)) // 2) * 2]
    assert stale_rows(held, frame["run"].to_numpy(dtype=np.int64)).mean() > 0.25


def test_readings_on_coarse_steps_are_not_copied(tmp_path):
    robot = draw_robot("uncoupled6", 3)
    measure(robot, tmp_path / "c", program="slow", noise="quantised", seed=4, tables=("poses",))
    assert not [m for m in said(tmp_path / "c") if "copied" in m]


def test_copies_among_readings_on_coarse_steps_are_seen(tmp_path):
    robot = draw_robot("uncoupled6", 3)
    measure(robot, tmp_path / "c", program="slow", noise="quantised", seed=4, tables=("poses",))
    file = tmp_path / "c" / "poses.csv"
    frame = read_campaign(tmp_path / "c").tables["poses"].copy()
    first = frame[frame["visit"] == 0].set_index(["pose", "target"])
    again = frame.index[frame["visit"] == 1][:30]
    for row in again:
        frame.loc[row, ["x_m", "y_m", "z_m"]] = first.loc[
            (frame.loc[row, "pose"], frame.loc[row, "target"]), ["x_m", "y_m", "z_m"]
        ].to_numpy()
    frame.to_csv(file, index=False)
    assert [m for m in said(tmp_path / "c") if "copied" in m]
