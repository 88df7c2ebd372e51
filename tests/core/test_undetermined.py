"""Numbers that the data do not determine are neither printed as values nor offered as alternatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.diagnosis.candidate_scores import DICTIONARY_FALSE_ALARMS, FEWEST_FLIPS, refuse_few_flips
from clampid.diagnosis.diagnose import diagnose
from clampid.diagnosis.entries import entry_of
from clampid.diagnosis.headline import equally_good
from clampid.display import compact, scale_for, with_error
from clampid.effect import EffectError
from clampid.evidence.candidates import named_candidates
from clampid.evidence.flips import Flips
from clampid.evidence.score import Scored, score
from clampid.evidence.space import space_of
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.loop.add import add
from clampid.slots import fixed_slots


@pytest.fixture(scope="module")
def gravity(simulated) -> tuple[Scored, float]:
    """Masses of all links as poses alone score them: most of the combinations bend nothing."""
    campaign = simulated(seed=3, poses=60, tables=("poses",), robot="ur10")
    estimate = (
        on_campaign(identify([campaign], {"poses": ["geometry", "joint_compliance"]}), campaign).refit("poses").estimate
    )
    space = space_of(estimate)
    scored = score(space, named_candidates(estimate, {"gravity": catalogue()["gravity"]}))
    best = next(s for s in scored if s.freedom)
    # A fit with large residuals: every direction that is hardly determined then has a huge value.
    return replace(best, amplitude=np.full(best.freedom, 50.0 * space.scale)), space.scale


def test_a_candidate_that_was_not_fitted_has_no_value_beyond_what_is_reasonable(gravity):
    best, scale = gravity
    assert np.abs(best.value).max() < 1e6  # columns of rounding are no directions
    entry = entry_of(best, Flips(np.zeros(19)), dict(catalogue()), (1.0, None), scale=scale)
    size = dict(zip([s.label for s in best.candidate.slots], best.candidate.reasonable, strict=True))
    assert all(p["identified"] == (p["std"] < size[p["name"]]) for p in entry["parameters"])
    assert not all(p["identified"] for p in entry["parameters"])
    assert max(abs(p["value"]) / size[p["name"]] for p in entry["parameters"]) < 1e3


def test_an_alternative_of_undetermined_parameters_is_not_offered_as_equally_good(gravity):
    """Nor is one with a larger held-out error: that of gravity on the real UR10 was 1.33 mm beside 108 µm."""
    best, scale = gravity
    vague = entry_of(best, Flips(np.zeros(19)), dict(catalogue()), (4e-4, 1.33e-3), scale=scale)
    clear = {**vague, "effect": "backlash", "heldout_rms_after": 1.08e-4, "parameters": [{"identified": True}]}
    both = [{**entry, "alternative": True, "group": 1} for entry in (clear, vague)]
    assert any(p["identified"] for p in both[1]["parameters"])  # so that the error alone decides
    assert equally_good(both) == both[:1]
    unknown = [{**p, "identified": False} for p in both[1]["parameters"]]
    assert equally_good([both[0], {**both[1], "heldout_rms_after": 1.08e-4, "parameters": unknown}]) == both[:1]


@pytest.mark.parametrize("flips", [1, 19, 98])
def test_fewer_flips_than_the_level_needs_are_refused(flips: int):
    with pytest.raises(EffectError, match=f"expected at least 99, found {flips}: .*p cannot fall below 1/{flips + 1},"):
        refuse_few_flips(flips)
    refuse_few_flips(99)
    assert 1 / (FEWEST_FLIPS + 1) <= DICTIONARY_FALSE_ALARMS < 1 / FEWEST_FLIPS


def test_a_diagnosis_with_too_few_flips_is_refused_before_any_work(simulated):
    campaign = simulated(seed=3, poses=60, tables=("poses",), robot="ur10")
    with pytest.raises(EffectError, match="expected at least 99, found 19"):
        diagnose(identify([campaign]), campaign, flips=19)


def test_constants_that_a_fit_holds_have_no_standard_error(simulated):
    campaign = simulated(seed=3, poses=60, tables=("poses",), robot="ur10")
    first = identify([campaign])
    model, _ = add(first, campaign, ["joint_angle_curve@joint2"])
    effects = catalogue()
    slots = model.stages["poses"].slots
    fixed = {slot.label for slot, held in zip(slots, fixed_slots(slots, effects), strict=True) if held}
    assert fixed == {"joint_angle_curve.rms@robot"}
    without, fitted = (on_campaign(m, campaign).refit("poses").estimate for m in (first, model))
    candidates = named_candidates(without, {"joint_angle_curve": effects["joint_angle_curve"]})
    curve = score(space_of(without), candidates)[0]
    entry = entry_of(curve, Flips(np.zeros(19)), dict(effects), (1.0, 1.0), fitted)
    assert {p["name"] for p in entry["parameters"] if p["std"] is None} == fixed
    assert with_error(3e-4, 3e-13, "rad") == "300.0 ± – µrad"
    assert compact(3e-4, 3e-13, scale_for("rad", [3e-4])) == "300.0"
