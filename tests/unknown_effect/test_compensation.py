"""The thesis' own mistakes, as campaigns: compare and diagnose point at each, and at nothing where there is none."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from compensated_arms import compensated

from clampid.comparison.compare import compare
from clampid.comparison.compensation import compensation_of, with_actual_joint_values
from clampid.diagnosis.diagnose import diagnose
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.models.model import Model
from clampid.screen import laid_out
from clampid.slots import Slot
from clampid.verbs.screens import comparison_screen, diagnosis_screen
from experiments.campaign import Campaign

SEED = 1


@pytest.fixture(scope="module")
def calibration(simulated) -> Campaign:
    """The robot as it is, nothing compensated."""
    return simulated(seed=SEED)


@pytest.fixture(scope="module")
def model(calibration: Campaign) -> Model:
    return identify(calibration)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """Give a later campaign of the same robot, with a compensation that has a mistake."""
    folder = tmp_path_factory.mktemp("compensated")
    return cache(lambda mistake: compensated(folder / mistake, mistake, SEED, 100))


CASES = {
    "none": (1.0, 1.0, None),
    "right": (0.0, 0.0, None),
    "degrees": (1 - np.degrees(1.0), 1 - np.degrees(1.0), "multiplied by 180/pi"),
    "own weight": (1.0, 0.0, "the arm's own weight is left out"),
    "sign": (2.0, 2.0, "wrong sign"),
}


@pytest.mark.parametrize("mistake", CASES)
def test_compare_points_at_the_mistake(mistake: str, model: Model, arm):
    own, tool, words = CASES[mistake]
    data = compare(model, arm(mistake), refit=("base", "tool")).to_json()["compensation"]
    for part, wanted in (("own_weight", own), ("tool", tool)):
        assert abs(data[part]["factor"] - wanted) < 5 * data[part]["std"]
        assert data[part]["std"] < 0.1 * max(1.0, abs(wanted))
    assert (data["mistake"] is None) == (words is None)
    if words is not None:
        assert words in data["mistake"]
        assert data["mistake"] in data["summary"]
    if mistake == "none":
        assert data["summary"] == ""
    if mistake == "right":
        assert "compensated in full" in data["summary"]


@pytest.mark.parametrize("mistake", ["none", "right", "sign", "degrees"])
def test_the_screen_of_compare_says_what_to_correct(mistake: str, model: Model, arm):
    data = compare(model, arm(mistake), refit=("base", "tool")).to_json()
    made = comparison_screen(data, {}, Path("model.json"), Path("later"), None, None)
    said = " ".join(made.notes)
    assert (CASES[mistake][2] or "compensated in full") in said or mistake == "none"
    assert ("Correct the controller's compensation" in said) == (mistake in ("sign", "degrees"))
    if mistake == "degrees":  # centimetres: a thousand times the noise floor, in digits
        assert re.search(r"is \d{3,4} times the noise floor", made.verdict)


@pytest.mark.slow
@pytest.mark.parametrize("mistake", ["degrees", "own weight", "sign", "right"])
def test_diagnose_points_at_the_mistake(mistake: str, model: Model, arm):
    found = diagnose(model, arm(mistake)).to_json()
    screen = " ".join(line.text for line in laid_out(diagnosis_screen(found, "Diagnosed.", [], [])))
    assert (CASES[mistake][2] or "compensated in full") in " ".join(screen.split())
    words, poses = CASES[mistake][2], found["stages"]["poses"]
    assert (found["compensation"]["mistake"] is None) == (words is None)
    assert (words or "compensated in full") in poses["summary"]
    assert "With the joint values that the compensation commanded: " in poses["summary"]
    if mistake == "degrees":  # springs and weights are known to some parts in a thousand, times 57
        assert "The mistake multiplies errors of springs and weights by 57" in poses["summary"]
    else:  # what it did to the points is called nothing else
        assert poses["verdict"] == "adequate"
        assert poses["heldout_rms_before"] < 1.2 * poses["noise_floor"]


@pytest.mark.slow
@pytest.mark.parametrize(("mistake", "left"), [("sign", 1.1), ("degrees", 4.0)])
def test_a_campaign_is_put_right(mistake: str, left: float, model: Model, arm):
    """The robot was sent there, within what its springs and weights are known to."""
    asked, sent = on_campaign(model, arm("none")), on_campaign(model, arm(mistake))
    found, nothing = compensation_of(sent), compensation_of(asked)
    assert found is not None
    assert nothing is not None
    assert with_actual_joint_values(asked, nothing) is None
    right = with_actual_joint_values(sent, found)
    assert right is not None
    clean, raw, mended = (
        np.sqrt(np.mean(np.sum(opened.refit("poses").estimate.residual[:, :3] ** 2, axis=1)))
        for opened in (asked, sent, right)
    )
    assert mended < left * clean
    assert raw > 5 * mended if mistake == "degrees" else raw > mended


@pytest.mark.slow
def test_a_base_biased_by_deflection(model: Model, calibration: Campaign):
    """The base of a model without springs, put beside the springs: it stands where the sag put it."""
    rigid = identify(calibration, {"poses": ["geometry"]}).stages["poses"]
    good = model.stages["poses"]
    theta = good.theta.copy()
    for axis in ("x", "y", "z", "rx", "ry", "rz"):
        slot = Slot("geometry", f"base_{axis}", "session1")
        theta[good.slots.index(slot)] = rigid.values()[slot]
    biased = model.with_stage(replace(good, theta=theta))
    for found in (compare(biased, calibration).to_json(), diagnose(biased, calibration).to_json()):
        assert found["compensation"]["mistake"] == "the base frame is biased by deflection"
        assert "as if it had absorbed the deflections" in found["compensation"]["summary"]
    assert "biased by deflection" in diagnose(biased, calibration).stages["poses"].summary


def test_a_good_model_has_no_mistake(model: Model, calibration: Campaign):
    found = compare(model, calibration).to_json()["compensation"]
    assert found["mistake"] is None
    assert found["summary"] == ""
    assert len(found["base"]) == 6


@pytest.mark.slow
def test_a_model_without_springs_has_nothing_to_compensate(calibration: Campaign):
    rigid = identify(calibration, {"poses": ["geometry"]})
    assert compensation_of(on_campaign(rigid, calibration)) is None
    assert "compensation" not in compare(rigid, calibration).to_json()
