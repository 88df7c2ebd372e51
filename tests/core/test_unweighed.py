"""Poses of an arm whose masses nobody says: it yields as arms do, and its springs are known as well as its masses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from virtual_arms import arm

from clampid.comparison.compare import compare
from clampid.diagnosis.diagnose import diagnose
from clampid.identification.identify import identify, standard_effects
from clampid.loop.add import add
from clampid.models.model import Model
from clampid.slots import Slot
from experiments.campaign import Campaign
from experiments.simulate import measured_campaign
from experiments.virtual_robot import Measured, Plant, measure
from kinematics.description import load_robot

Simulated = Callable[..., Campaign]

NAME = "abb_irb1200_5_09"


@pytest.fixture(scope="module")
def measured() -> Measured:
    return measure(arm(NAME), seed=3, poses=120, tables=("poses", "verification"))


@pytest.fixture(scope="module")
def campaign(measured: Measured) -> Campaign:
    robot = load_robot(NAME)
    assert not robot.has_masses
    return measured_campaign(measured, robot)


@pytest.fixture(scope="module")
def model(campaign: Campaign) -> Model:
    return identify([campaign])


def heldout(model: Model, campaign: Campaign) -> float:
    return float(compare(model, campaign).tables["poses"]["heldout"]["rms"])


def test_the_arm_yields_under_a_weight_that_nobody_said(model: Model, campaign: Campaign):
    assert [t.effect for t in standard_effects([campaign])["poses"]] == ["geometry", "joint_compliance", "backlash"]
    stiff = identify([campaign], {"poses": ("geometry", "backlash")})
    assert heldout(model, campaign) < heldout(stiff, campaign) / 4.0


def test_errors_of_springs_say_that_masses_are_unknown(model: Model, measured: Measured):
    stage, springs = model.stages["poses"], 1.0 / measured.truth.plant.drive.spring
    for j in (2, 3, 5):
        k = stage.slots.index(Slot("joint_compliance", "c", f"joint{j}"))
        assert abs(stage.theta[k] - springs[j - 1]) < 3.0 * stage.std[k]
        assert stage.std[k] > 0.05 * stage.theta[k]  # the points alone would tell it to a hundredth


def test_a_described_arm_has_no_such_error(measured: Measured):
    """The same arm, its nominal masses described: errors are those of the points."""
    stage = identify([measured_campaign(measured, arm(NAME))]).stages["poses"]
    k = stage.slots.index(Slot("joint_compliance", "c", "joint2"))
    assert stage.std[k] < 0.05 * stage.theta[k]


@pytest.mark.slow
@pytest.mark.parametrize("gap", [pytest.param(1e-4, marks=pytest.mark.study), 2e-4])
def test_clearances_that_follow_the_approach_alone_are_named(gap: float):
    """Loads that nobody said decide on no flank: the fit takes those of a usual arm, and both sides stand apart."""
    robot = load_robot("kuka_kr16_2")
    measured = measure(
        robot, seed=1, poses=60, tables=("poses", "verification"), alter=partial(_with_gaps, gap)
    )  # its weight is not known to the virtual robot either: friction holds every joint on the side that it came from
    campaign = measured_campaign(measured, robot)
    model = identify(campaign)
    verdict = diagnose(model, campaign).stages["poses"]
    (found,) = verdict.candidates
    assert (verdict.verdict, found["effect"], found["name"]) == ("missing", "backlash", "lost_motion")
    assert {"joint2", "joint3"} <= set(found["where"])
    mended, _ = add(model, campaign, [f"poses=lost_motion@{place}" for place in found["where"]])
    stage, drive = mended.stages["poses"], measured.truth.plant.drive
    friction = measured.truth.plant.friction.arm  # winds up the springs, and is part of what both sides stand apart
    for j in (2, 3):
        k = stage.slots.index(Slot("lost_motion", "width", f"joint{j}"))
        assert abs(stage.theta[k] - gap - 2.0 * friction[j - 1] / drive.spring[j - 1]) < 3.0 * stage.std[k]
        assert stage.std[k] < 0.2 * gap
    assert heldout(mended, campaign) < 0.7 * heldout(model, campaign)
    assert diagnose(mended, campaign).stages["poses"].verdict == "adequate"


@pytest.mark.slow
def test_friction_that_winds_up_springs_is_named_as_the_cause(simulated: Simulated):
    """Where loads are known, what both sides stand apart is told as well by arm-side friction, which says why."""
    campaign = simulated(seed=3, poses=120, tables=("poses", "verification"))
    model = identify(campaign, {"poses": ("geometry", "joint_compliance", "backlash", "gravity")})
    (found,) = diagnose(model, campaign).stages["poses"].candidates
    assert found["effect"] == "wrist_coupling_friction"
    assert sorted(found["where"]) == ["joint4", "joint5", "joint6"]  # joint 6's is hardly known, and decides on flanks
    assert "backlash" in [c["effect"] for c in found["confusable_with"]]


def _with_gaps(gap: float, plant: Plant) -> Plant:
    return replace(plant, drive=replace(plant.drive, gap=np.full(plant.n, gap)))


@pytest.mark.study
def test_several_tools_weigh_the_arm():
    """Three known tools part springs from masses: gravity is named, and the springs are then known."""
    robot, bare = arm(NAME), load_robot(NAME)
    plant = measure(robot, seed=3, poses=2, tables=("poses",)).truth.plant
    campaigns = []
    for k, mass in enumerate((0.0, 2.0, 6.0)):
        loaded = np.array([0.0, 0.0, 0.08])
        one = measure(robot, seed=20 + k, poses=60, tables=("poses",), alter=partial(_with_tool, plant, mass, loaded))
        one.header["tool"] = {"mass_kg": mass, "com_m": loaded.tolist()}
        campaigns.append(measured_campaign(one, bare, f"load{k}"))
    verdict = diagnose(identify(campaigns), campaigns).stages["poses"]
    assert "gravity" in [c["effect"] for c in verdict.candidates]  # a balancer at joint 2 may be like it
    effects = ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction")
    stage = identify(campaigns, {"poses": effects}).stages["poses"]
    for j in (2, 3):
        k = stage.slots.index(Slot("joint_compliance", "c", f"joint{j}"))
        assert abs(stage.theta[k] - 1.0 / plant.drive.spring[j - 1]) < 3.0 * stage.std[k]
        assert stage.std[k] < 0.1 * stage.theta[k]


def _with_tool(plant: Plant, mass: float, com: np.ndarray, _: Plant) -> Plant:
    return replace(plant, masses=replace(plant.masses, tool=mass, tool_com=com))
