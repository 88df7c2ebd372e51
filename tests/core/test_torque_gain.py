"""A gain of a motor's torque reading: found, with its size, beside masses that are not those described."""

from __future__ import annotations

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.diagnosis.diagnose import diagnose
from clampid.identification.fitted_stage import fit_stage
from clampid.identification.identify import identify, stage_rows, standard_effects
from clampid.models.model import StageModel
from clampid.slots import Slot, Term
from clampid.stages.layout import layout_of
from clampid.standard_sets import STANDARD
from experiments.campaign import Campaign
from experiments.simulate import measured_campaign
from experiments.virtual_robot import Hidden, measure
from kinematics.description import load_robot

GAIN = Term("torque_gain", "joint3")


@pytest.fixture(scope="module")
def reported() -> tuple[Campaign, float]:
    """Torques of a robot whose drive 3 reports too much, and by what share."""
    robot = load_robot("kuka_kr20_r1810")
    measured = measure(robot, seed=41, tables=("free_air", "wrist"), hidden=[Hidden("torque_gain", "joint3")])
    gain = measured.truth.plant.friction.gain
    assert np.flatnonzero(gain).tolist() == [2]
    return measured_campaign(measured, robot), float(gain[2])


def gain_of(stage: StageModel, place: str) -> tuple[float, float]:
    """A gain and its standard error."""
    slot = Slot("torque_gain", "g", place)
    return stage.values()[slot], float(stage.std[stage.slots.index(slot)])


@pytest.mark.slow
def test_a_gain_has_its_size_beside_masses_that_differ(reported: tuple[Campaign, float]):
    campaign, true = reported
    names = [t.label for t in standard_effects([campaign])["free_air"]]
    stage = identify(campaign, {"free_air": [*names, GAIN.label]}).stages["free_air"]
    value, error = gain_of(stage, "joint3")
    assert abs(value - true) < 3.0 * error
    assert error < 0.25 * true


def test_a_log_held_in_memory_gives_the_gain_of_one_read_by_windows(reported: tuple[Campaign, float]):
    campaign, _ = reported
    standard = [Term(name) for name in STANDARD["free_air"]]
    rows = stage_rows([campaign], layout_of([campaign]), "free_air")
    whole = fit_stage(rows, catalogue(), (*standard, GAIN), {}).model
    windows = identify(campaign, {"free_air": [t.label for t in (*standard, GAIN)]}).stages["free_air"]
    (one, error), (other, _) = gain_of(whole, "joint3"), gain_of(windows, "joint3")
    assert one == pytest.approx(other, abs=0.1 * error)


@pytest.mark.slow
def test_a_gain_is_named(reported: tuple[Campaign, float]):
    campaign, _ = reported
    found = diagnose(identify(campaign), campaign).stages["free_air"]
    assert ("torque_gain", ["joint3"]) in [(c["name"], c["where"]) for c in found.candidates[:2]]


def test_the_gain_of_a_motor_without_load_is_hardly_known(reported: tuple[Campaign, float]):
    """Motor 1 turns about the vertical. Its reading scales friction, too, but friction is unknown itself."""
    campaign, _ = reported
    names = [t.label for t in standard_effects([campaign])["free_air"]]
    stage = identify(campaign, {"free_air": [*names, "torque_gain@joint1"]}).stages["free_air"]
    value, error = gain_of(stage, "joint1")
    assert error > 0.1
    assert abs(value) < 3.0 * error
