"""Steps that were confirmed: earlier ones that a later one makes needless, and effects that need more numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from benches import bench_of, refits

from clampid.diagnosis.confirmed import Confirmed, with_needed_only
from clampid.diagnosis.pruning import bic_gap
from clampid.diagnosis.trial import Bench
from clampid.diagnosis.tried import Tried
from clampid.identification.fitted_stage import FittedStage
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import ModelOnCampaign, on_campaign
from clampid.search_policy import Search
from clampid.slots import Term
from experiments.campaign import Campaign

Simulated = Callable[..., Campaign]
GEAR, CABLE, OTHER = "gear_eccentricity@joint5", "dress_pack@joint5", "gear_eccentricity@joint2"


@pytest.fixture(scope="module")
def opened(simulated: Simulated) -> ModelOnCampaign:
    hidden = ("gear_eccentricity@joint2:3", "gear_eccentricity@joint5:3")
    campaign = simulated(seed=3, poses=120, tables=("poses",), hidden=hidden)
    return on_campaign(identify(campaign, {"poses": ("geometry", "joint_compliance")}), campaign)


@pytest.fixture(scope="module")
def start(opened: ModelOnCampaign) -> FittedStage:
    return opened.refit("poses")


@pytest.fixture(scope="module")
def bench(opened: ModelOnCampaign, start: FittedStage) -> Bench:
    return bench_of(opened, start, refits(opened))


def in_turn(bench: Bench, start: FittedStage, labels: Sequence[str]) -> list[Confirmed]:
    """Steps as if these had been confirmed one after the other."""
    scores, steps, base, held_out = bench.scores(start, 0), list[Confirmed](), start, bench.held_out(start)
    for label in labels:
        best = next(s for s in scores.named if s.candidate.label == label and s.freedom)
        terms = list(best.candidate.terms)
        fitted = bench.refit([*base.model.terms, *terms], base, best.candidate.shapes)
        tried = Tried(best, scores, fitted, terms, bench.held_out(fitted), 0.001, 1.0, "")
        steps.append(Confirmed(tried, base, held_out))
        base, held_out = fitted, tried.held_out
    return steps


def test_a_step_explained_by_a_later_effect_with_fewer_parameters_is_dropped(bench: Bench, start: FittedStage) -> None:
    steps, again = in_turn(bench, start, [CABLE, GEAR]), set[str]()
    kept = with_needed_only(bench, steps, again)
    assert [s.label for s in kept] == [GEAR]
    assert again == {CABLE}
    assert kept[0].before.rms == steps[0].before.rms
    assert {t.effect for t in kept[0].tried.fitted.model.terms} == {"geometry", "joint_compliance", "gear_eccentricity"}
    (gone,) = kept[0].refused
    assert gone["name"] == "dress_pack"
    assert gone["reason"] == f"it does not lower the held-out error once {GEAR} is in the model"
    assert kept[0].tried.held_out.rms < 1.05 * steps[-1].tried.held_out.rms


def test_steps_after_a_dropped_one_are_fitted_again(bench: Bench, start: FittedStage) -> None:
    steps = in_turn(bench, start, [CABLE, OTHER, GEAR])
    kept = with_needed_only(bench, steps, set())
    assert [s.label for s in kept] == [OTHER, GEAR]
    assert kept[0].before.rms == steps[0].before.rms
    assert kept[1].before.rms == kept[0].tried.held_out.rms  # each on top of those before it
    assert not any(t.effect == "dress_pack" for t in kept[0].tried.fitted.model.terms)
    assert kept[1].tried.held_out.rms < kept[0].tried.held_out.rms < kept[0].before.rms


def test_what_is_needed_stays(bench: Bench, start: FittedStage) -> None:
    steps = in_turn(bench, start, [OTHER, GEAR])
    assert with_needed_only(bench, steps, set()) == steps


def test_what_was_dropped_and_confirmed_again_stays(bench: Bench, start: FittedStage) -> None:
    steps = in_turn(bench, start, [CABLE, GEAR])
    assert with_needed_only(bench, steps, {CABLE}) == steps


def test_what_another_refines_stays(bench: Bench, start: FittedStage) -> None:
    """A law beyond another has no meaning without that."""
    steps = in_turn(bench, start, [CABLE, GEAR])
    beyond = replace(bench.effects["gear_eccentricity"], search=Search(refines="dress_pack"))
    tied = replace(bench, effects={**bench.effects, "gear_eccentricity": beyond})
    assert [s.label for s in with_needed_only(tied, steps, set())] == [CABLE, GEAR]


def test_more_parameters_for_the_same_fit_are_less_likely(bench: Bench, start: FittedStage) -> None:
    terms = [Term("gear_eccentricity", "joint2"), Term("gear_eccentricity", "joint5")]
    few = bench.refit([*start.model.terms, *terms], start, {})
    more = [*terms, Term("gear_eccentricity", "joint6")]
    many = bench.refit([*start.model.terms, *more], few, {})
    less = bic_gap([(few.estimate, terms), (many.estimate, more), (start.estimate, [])], few.estimate.noise)
    numbers = sum(s.place == "joint6" and s.effect == "gear_eccentricity" for s in many.estimate.slots)
    assert less[0] == 0.0
    # By chance, numbers that are not there explain as much as there are of them, on average.
    price = numbers * np.log(len(few.estimate.whitened.residual))
    assert price - 4 * numbers < less[1] <= price
    assert less[2] > 100.0
