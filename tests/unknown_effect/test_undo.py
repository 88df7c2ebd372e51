"""One step back, and what the omission had done to the exported table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.diagnosis.effect_new import effect_new
from clampid.diagnosis.headline import notes
from clampid.diagnosis.omission import exported_shift, shift_in_words
from clampid.diagnosis.words import omission_of
from clampid.exports.dh_export import dh_table
from clampid.fitting.descent import NEGLIGIBLE
from clampid.identification.identify import identify
from clampid.loop.add import add
from clampid.loop.undo import undo
from clampid.models.model import Model, ModelError, load_model, save_model
from clampid.report.limits import exported
from clampid.slots import Slot
from experiments.campaign import Campaign

POSES = ("poses", "verification")


@pytest.fixture(scope="module")
def arm(simulated) -> Campaign:
    return simulated("gear_eccentricity@joint2:3", seed=3, poses=80, tables=POSES, robot="ur10")


@pytest.fixture(scope="module")
def first(arm: Campaign) -> Model:
    return identify(arm)


def assert_same(found: Model, wanted: Model) -> None:
    """The same slots and ledger, values as far as a search goes: where no step promises a gain worth its error."""
    assert found.ledger == wanted.ledger
    assert found.layout == wanted.layout
    assert found.user_effects == wanted.user_effects
    assert set(found.stages) == set(wanted.stages)
    for stage, model in wanted.stages.items():
        assert found.stages[stage].slots == model.slots
        assert found.stages[stage].terms == model.terms
        off = (found.stages[stage].theta - model.theta) / model.std
        np.testing.assert_allclose(off, 0.0, atol=np.sqrt(NEGLIGIBLE))


def test_undo_gives_the_model_before(arm: Campaign, first: Model, tmp_path: Path):
    once, _ = add(first, arm, ["gear_eccentricity@joint2"])
    own = effect_new("mine", ["q3"], "joint3", orders=2, path=tmp_path / "mine.py")
    twice, _ = add(once, arm, ["mine"], user_effects=own)
    save_model(twice, tmp_path / "model.json")
    back, gone = undo(load_model(tmp_path / "model.json"), arm)
    assert gone.added == ("mine@joint3",)
    assert_same(back, once)
    assert_same(undo(back, arm)[0], first)


def test_there_is_a_first_round(arm: Campaign, first: Model):
    with pytest.raises(ModelError, match="nothing to undo"):
        undo(first, arm)
    with pytest.raises(ModelError, match="nothing to undo"):
        undo(replace(first, ledger=()), arm)


def test_undo_needs_the_campaign_of_the_model(arm: Campaign, first: Model, simulated):
    once, _ = add(first, arm, ["gear_eccentricity@joint2"])
    other = simulated(seed=8, poses=40, tables=POSES, robot="ur10")
    with pytest.raises(ModelError, match="expected a campaign that the model was fitted on"):
        undo(once, other)


@pytest.mark.slow
def test_undo_of_torques_fits_the_poses_again(simulated):
    campaign = simulated("torque_offset@joint3", seed=4, poses=60, tables=("free_air", "wrist", "poses"))
    first = identify(campaign)
    mended, _ = add(first, campaign, ["free_air=torque_offset"])
    assert_same(undo(mended, campaign)[0], first)


def test_the_shift_of_the_exported_table_is_the_difference_of_two_exports(arm: Campaign, first: Model):
    mended, addition = add(first, arm, ["gear_eccentricity@joint2"])
    shifts = addition.to_json()["stages"]["poses"]["exported_shift"]
    again = exported_shift(first, mended, arm.robot)
    assert [(e["row"], e["parameter"]) for e in shifts] == [(e["row"], e["parameter"]) for e in again]
    old, new = (dh_table(model, "hayati", fit="static") for model in (first, mended))
    assert shifts
    sizes = [entry["at_flange_m"] for entry in shifts]
    assert sizes == sorted(sizes, reverse=True)
    for entry in shifts:
        assert abs(entry["shift"]) > 2 * entry["std"] > 0
        if entry["row"].isdigit() and entry["unit"] == "m":  # a length moves the flange by as much, in every posture
            assert entry["at_flange_m"] == pytest.approx(abs(entry["shift"]), rel=1e-6)
        column = f"{entry['parameter']}_{entry['unit']}"
        values = [float(t.loc[t["row"] == entry["row"], column].iloc[0]) for t in (old, new)]
        assert entry["shift"] == pytest.approx(values[0] - values[1], abs=1e-12)
    # A wave of the second joint's angle is taken for its offset and for the links about it.
    assert any(entry["row"] in ("1", "2", "3") for entry in shifts[:3])
    assert exported_shift(first, first, arm.robot) == []


def test_the_sentence_has_units_and_errors():
    shifts = [
        {"row": "3", "parameter": "d", "shift": 4.53e-5, "std": 3.1e-6, "unit": "m", "at_flange_m": 4.53e-5},
        {"row": "base", "parameter": "rx", "shift": -2.2e-4, "std": 2.7e-5, "unit": "rad", "at_flange_m": 1.9e-4},
    ]
    said = (
        "Without it the exported DH table was biased: rx of base by −220 ± 27 µrad (190 µm at the flange), "
        "d of row 3 by 45.3 ± 3.1 µm (45.3 µm at the flange)."
    )
    assert shift_in_words(shifts) == said
    assert shift_in_words([]) == ""


def test_what_cannot_be_measured_at_the_flange_is_not_named():
    """However significant: 0.15 µm with a standard error of 0.01 µm."""
    tiny = {"row": "6", "parameter": "d", "shift": 1.5e-7, "std": 1e-8, "unit": "m", "at_flange_m": 1.5e-7}
    large = {"row": "2", "parameter": "theta_offset", "shift": 2e-4, "std": 5e-5, "unit": "rad", "at_flange_m": 1.8e-4}
    assert shift_in_words([tiny]) == ""
    assert "row 6" not in shift_in_words([tiny, large])
    part = {"verdict": "adequate", "candidates": [], "exported_shift": [tiny]}
    assert not [text for text in notes("poses", part) if "DH table" in text]
    said = [text for text in notes("poses", part | {"exported_shift": [tiny, large]}) if "DH table" in text]
    assert said == [
        "poses: Without it the DH table is biased in 1 number: theta_offset of row 2 by 200 ± 50 µrad; 180 µm at the "
        "flange."
    ]


def test_a_diagnosis_of_an_earlier_version_names_no_shift_and_is_reported():
    old = {"row": "2", "parameter": "theta_offset", "shift": 2e-4, "std": 5e-5, "unit": "rad"}
    assert shift_in_words([old]) == ""
    assert exported([old])[0].rows == (("2", "theta_offset", "200 ± 50 µrad", "not known"),)


def test_no_shift_of_a_parameter_undetermined_in_one_fit(arm: Campaign):
    slots = [Slot("geometry", name, "base") for name in ("base_x", "base_y", "base_z")]
    problem = SimpleNamespace(effects=catalogue(), rows=SimpleNamespace(robot=arm.robot))

    def fit(theta: list[float], identified: list[bool]) -> Any:
        std = np.full(3, 1e-6)
        return SimpleNamespace(
            slots=slots, theta=np.array(theta), std=std, identified=np.array(identified), problem=problem
        )

    before, after = fit([0.0, 0.0, 0.0], [True, False, True]), fit([1e-4, 5e-2, 5e-2], [True, True, False])
    assert [entry["name"] for entry in omission_of(before, after)] == [slots[0].label]
