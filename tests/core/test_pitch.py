"""An advance along a joint's axis by its angle: it is the other screw, and is found on an arm that has one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from virtual_arms import arm

from clampid.catalogue import catalogue
from clampid.diagnosis.diagnose import diagnose
from clampid.effect import AT_A_SLIDE, UNITS
from clampid.evidence.candidates import named_candidates
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.slots import Layout, Slot, unit_of
from clampid.stages import poses
from clampid.stages.fit_problem import fit_problem, parameter_of
from clampid.stages.pose_kernel import link_points
from clampid.stages.pose_rows import pose_rows
from experiments.campaign import Campaign, Instrument, Tool
from experiments.simulate import measured_campaign
from experiments.virtual_robot import Plant, measure
from kinematics.description import RobotDescription, load_robot
from kinematics.robot import Joint
from kinematics.screws import cayley, exp_se3, transform

STANDARD = ("geometry", "joint_compliance", "backlash")
EXCESS = 2e-5  # m/rad


def spindle() -> RobotDescription:
    """A SCARA whose third joint is a screw of 30 mm a turn."""
    robot = arm("scara")
    slide = robot.joints[2]
    screw = Joint(
        "J3", "helical", slide.axis, slide.point, 0.03 / (2 * np.pi), -30.0, 30.0, max_speed=20.0, rated_torque=2.0
    )
    return replace(robot, name="spindle", joints=(*robot.joints[:2], screw, robot.joints[3]))


@cache
def measured(seed: int) -> Campaign:
    """What the spindle measures whose lead is longer than its maker says; its physics is the virtual robot's own."""

    def longer(plant: Plant) -> Plant:
        pitch = plant.geometry.pitch + np.array([0.0, 0.0, EXCESS, 0.0])
        return replace(plant, geometry=replace(plant.geometry, pitch=pitch))

    return measured_campaign(measure(spindle(), seed=seed, poses=60, tables=("poses",), alter=longer), spindle())


@pytest.mark.parametrize("name", ["spindle", "abb_irb2400_12_155", "ur10"])
def test_it_is_exactly_the_screw_of_another_pitch(name: str):
    robot = spindle() if name == "spindle" else load_robot(name)
    rng, n, count = np.random.default_rng(3), robot.n, 20
    h, moved = rng.uniform(-0.01, 0.01, n), rng.uniform(-0.05, 0.05, (n, 6))
    q = rng.uniform(-3.0, 3.0, (count, n))
    table = {"pose": np.arange(count), "visit": 1, "time_s": np.arange(count), "target": "flange"}
    table |= {f"q{i + 1}_rad": q[:, i] for i in range(n)} | {f"dir{i + 1}": 0 for i in range(n)}
    data = pd.DataFrame(table | dict.fromkeys(("x_m", "y_m", "z_m"), 0.0))
    nothing, instrument = Tool(0.0, np.zeros(3)), Instrument("none", None, None)
    campaign = Campaign("made", None, robot, np.zeros(3), nothing, {}, instrument, {"poses": data}, "")
    axes = ("rx", "ry", "rz", "x", "y", "z")
    slots = [Slot("pitch_error", "h", f"joint{i + 1}") for i in range(n)]
    slots += [Slot("geometry", axis, f"link{i + 1}") for i in range(n) for axis in axes]
    trial = fit_problem(pose_rows([campaign], Layout(n), "poses", {0: np.eye(4)}), catalogue(), slots)
    theta = np.r_[h, moved.ravel()]
    position, rotation, _ = poses.predict(trial.rows, poses.evaluate(trial.rows, trial.chain, theta))
    for row, angles in enumerate(q @ np.asarray(robot.linkage).T):
        T = np.eye(4)
        for i, pivot in enumerate(link_points(robot)):
            other = robot.screws[i] + np.r_[np.zeros(3), h[i] * robot.screws[i, :3]]
            C = cayley(moved[i, :3])
            T = T @ exp_se3(other * angles[i]) @ transform(C, pivot + moved[i, 3:] - C @ pivot)
        T = T @ robot.flange
        np.testing.assert_allclose(position[row], T[:3, 3], atol=1e-12)
        np.testing.assert_allclose(rotation[row], T[:3, :3], atol=1e-12)


def test_it_is_found_within_its_stated_error():
    z = []
    for seed in range(8):
        stage = identify(measured(seed), (*STANDARD, "pitch_error@joint3")).stages["poses"]
        k = stage.slots.index(Slot("pitch_error", "h", "joint3"))
        assert stage.std[k] < 0.1 * EXCESS
        z.append((stage.theta[k] - EXCESS) / stage.std[k])
    # Eight independent ones: outside of these bounds in one case of some thousands.
    assert np.max(np.abs(z)) < 3.5
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < 1.9


def test_diagnosis_finds_it_at_the_joint_that_is_a_screw():
    found = diagnose(identify(measured(1), STANDARD), measured(1)).stages["poses"].to_json()
    best = found["candidates"][0]
    assert (found["verdict"], best["name"], best["where"]) == ("missing", "pitch_error", ["joint3"])
    assert found["heldout_rms_after"] < 1.1 * found["noise_floor"]


def test_diagnosis_looks_for_it_at_screws_only():
    turning = measured_campaign(measure(arm("scara"), seed=0, poses=30, tables=("poses",)), arm("scara"))
    for campaign, places in ((measured(0), [("joint3",)]), (turning, [])):
        opened = on_campaign(identify(campaign, STANDARD), campaign)
        offered = named_candidates(opened.refit("poses").estimate, catalogue())
        assert [c.places for c in offered if c.name == "pitch_error"] == places


def test_a_joint_that_slides_has_none():
    robot = arm("scara")
    campaign = measured_campaign(measure(robot, seed=0, poses=30, tables=("poses",)), robot)
    stage = identify(campaign, (*STANDARD, "pitch_error")).stages["poses"]
    assert any("pitch_error.h at joint3: these rows do not depend on it" in line for line in stage.null_directions)


def test_where_a_joint_slides_angles_are_lengths_and_torques_forces():
    robot, effects = arm("scara"), catalogue()
    assert [joint.kind for joint in robot.joints][2:] == ["prismatic", "revolute"]
    for effect, name, slides, turns in (
        ("backlash", "gap", "m", "rad"), ("joint_compliance", "c", "m/N", "rad/Nm"), ("dress_pack", "t", "N", "Nm"),
    ):  # fmt: skip
        units = [unit_of(Slot(effect, name, f"joint{j}"), effects, robot) for j in (3, 4)]
        assert units == [slides, turns]
        assert parameter_of(Slot(effect, name, "joint3"), effects, robot).unit == slides
    assert unit_of(Slot("geometry", "rx", "link3"), effects, robot) == "rad"
    assert set(AT_A_SLIDE) | set(AT_A_SLIDE.values()) <= UNITS
