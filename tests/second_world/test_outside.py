"""What no library has is called unknown, with the variables that it depends on: two of them, too, and time."""

from __future__ import annotations

from pathlib import Path

import pytest
from hidden_trial import hidden_trial
from hidden_worlds import WORLDS

from clampid.diagnosis.diagnose import diagnose
from clampid.identification.identify import identify
from experiments.campaign import read_campaign
from experiments.second_world import draw_robot, measure

POSES = ("free_air", "poses", "verification")


@pytest.mark.parametrize(
    ("name", "where", "magnitude", "robot", "program", "noise", "depends_on"),
    [
        ("time_of_day", "instrument", 0.94, "seven7", "many", "white", {"time"}),
        ("layered_air", "instrument", 1.5, "seven7", "many", "white", {"z"}),
    ],
)
@pytest.mark.slow
def test_what_the_instrument_does_depends_on_time_or_on_a_square(
    name: str, where: str, magnitude: float, robot: str, program: str, noise: str, depends_on: set[str], tmp_path: Path
) -> None:
    """Nothing of it is a joint's error, and the swing takes five turns over the campaign."""
    arm = draw_robot(robot, 11, mounting="wall")
    measure(arm, tmp_path, hidden=[(name, where, magnitude)], tables=POSES, program=program, noise=noise, seed=11)
    campaign = read_campaign(tmp_path)
    poses = diagnose(identify(campaign), campaign, stages=["poses"]).stages["poses"]
    assert poses.verdict == "unknown"
    assert depends_on <= set(poses.depends_on)


@pytest.mark.slow
def test_friction_by_another_joints_load_is_found_at_its_motor(tmp_path: Path) -> None:
    """As of a bearing that two joints share: by one motor's speed times another's load."""
    arm = draw_robot("seven7", 11, mounting="wall")
    hidden = [("friction_of_both", "joint1+joint2", 0.4)]
    measure(arm, tmp_path, hidden=hidden, tables=("free_air",), log="trapezoids_10hz", noise="white", seed=11)
    campaign = read_campaign(tmp_path)
    log = diagnose(identify(campaign), campaign).stages["free_air"]
    assert log.verdict == "unknown"
    assert set(log.depends_on) == {"qd1", "tau2"}
    assert log.scores is not None
    assert log.scores.probe is not None
    assert log.scores.probe.candidate.places == ("motor1",)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed"),
    [
        pytest.param("friction_of_both", 173, marks=pytest.mark.study),
        ("friction_of_both", 3700),  # beside readings that wander
        pytest.param("friction_of_both", 3712, marks=pytest.mark.study),  # by a load of more than the described weight
        ("dragged_cable", 173),
        ("torque_surface", 174),
        ("resonance", 174),
    ],
)
def test_an_unknown_torque_is_not_taken_for_noise(name: str, seed: int) -> None:
    """Filtered as noise, 23 and 2 % of the first two's squares were left. One was `adequate`, and two were ties."""
    case = next(c for c in WORLDS["second"].cases["outside"] if c.label == f"{name}/free_air")
    found = hidden_trial(WORLDS["second"], case, 0.8, seed, 200, best=False)
    assert found["verdict"] == "unknown"
    assert found["right"], found["depends_on"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed"),
    [
        # The best probe, a curve of 215 numbers, predicts nothing; the next one does.
        pytest.param("directed_sag", 3707, marks=pytest.mark.study),
        ("directed_sag", 3716),  # along the weight, whatever the posture: the base's shift shows it, no joint's error
        ("pose_surface", 3702),  # any smooth function of two angles
        ("pose_surface", 4071),  # a table beyond the poses does not test how a smooth function goes on there
        ("time_of_day", 4072),  # a link's temperature changes as slowly
        ("time_of_day", 4068),  # the room's temperature explains it as well
        ("time_of_day", 4100),  # beside a random walk
        pytest.param("time_of_day", 4065, marks=pytest.mark.study),  # beside pink noise
        ("time_of_day", 4105),  # what makes visits alike is what is missing
        pytest.param("time_of_day", 4112, marks=pytest.mark.study),  # less than a turn in all
        ("leaning_link", 3710),  # as slow as the room's temperature, from which time is not separable
    ],
)
def test_an_unknown_error_of_poses_is_not_adequate_and_has_its_variable(name: str, seed: int) -> None:
    case = next(c for c in WORLDS["second"].cases["outside"] if c.label == f"{name}/poses")
    found = hidden_trial(WORLDS["second"], case, 0.8, seed, 200, best=False)
    assert found["verdict"] == "unknown"
    assert found["right"], found["depends_on"]
