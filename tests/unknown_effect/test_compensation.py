"""The thesis' own mistakes, as campaigns: compare and diagnose point at each, and at nothing where there is none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from compensated_arms import compensated

from clampid.comparison.compare import compare
from clampid.comparison.compensation import compensation_of
from clampid.diagnosis.diagnose import diagnose
from clampid.identification.identify import identify
from clampid.identification.reopen import reopen
from clampid.models.model import Model
from clampid.slots import Slot
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


@pytest.mark.parametrize("mistake", ["degrees", "own weight"])
def test_diagnose_points_at_the_mistake(mistake: str, model: Model, arm):
    found = diagnose(model, arm(mistake)).to_json()
    words = CASES[mistake][2]
    assert words in found["compensation"]["mistake"]
    assert words in found["stages"]["poses"]["summary"]


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
        assert "takes up of the deflections" in found["compensation"]["summary"]
    assert "biased by deflection" in diagnose(biased, calibration).stages["poses"].summary


def test_a_good_model_has_no_mistake(model: Model, calibration: Campaign):
    found = compare(model, calibration).to_json()["compensation"]
    assert found["mistake"] is None
    assert found["summary"] == ""
    assert len(found["base"]) == 6


def test_a_model_without_springs_has_nothing_to_compensate(calibration: Campaign):
    rigid = identify(calibration, {"poses": ["geometry"]})
    assert compensation_of(reopen(rigid, calibration)) is None
    assert "compensation" not in compare(rigid, calibration).to_json()
