"""Ripples of unknown order: found by their spectrum over the motor's angle, and no order where there is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.diagnosis.diagnose import diagnose
from clampid.effect import EffectError
from clampid.evidence.orders import order_scores
from clampid.evidence.space import space_of
from clampid.fitting.solve import Estimate
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.loop.add import add
from clampid.standard_sets import STANDARD
from experiments.campaign import Campaign

JOINT = 3
ORDER = 0.371
"""Periods per revolution of the motor: 43.4 per revolution of the joint, as of no gear that the description has."""
AMPLITUDE, PHASE = 0.03, 0.7  # Nm, rad


def estimate_of(campaign: Campaign) -> Estimate:
    model = identify(campaign, {"free_air": STANDARD["free_air"]})
    return on_campaign(model, campaign).refit("free_air").estimate


def motor_angle(campaign: Campaign, joint: int) -> np.ndarray:
    table, n = campaign.tables["free_air"], campaign.robot.n
    q = table[[f"q{i + 1}_rad" for i in range(n)]].to_numpy(float)
    return np.asarray(np.linalg.solve(np.asarray(campaign.robot.transmission).T, q.T))[joint - 1]


@pytest.fixture(scope="module")
def plain(simulated: Callable[..., Campaign]) -> Campaign:
    return simulated(seed=7, tables=("free_air",))


@pytest.fixture(scope="module")
def rippled(plain: Campaign) -> Campaign:
    """The same log, with a ripple of joint 3 whose order nothing states."""
    table = plain.tables["free_air"].copy()
    table[f"tau{JOINT}_Nm"] += AMPLITUDE * np.sin(ORDER * motor_angle(plain, JOINT) + PHASE)
    return replace(plain, tables=MappingProxyType({"free_air": table}), fingerprint="with a ripple")


def test_the_spectrum_is_what_scores_say_of_the_order_that_is_best(rippled: Campaign) -> None:
    """The spectrum knows neither gaps nor what the fit absorbs; where a ripple is, that hardly matters."""
    estimate, effects = estimate_of(rippled), catalogue()
    (found,) = (s for s in order_scores(estimate, space_of(estimate), effects) if s.candidate.places == ("joint3",))
    (order,) = found.candidate.shapes.values()
    width = 2.0 * np.pi / float(np.ptp(motor_angle(rippled, JOINT)))
    assert abs(order - ORDER) < 0.5 * width
    a, b = AMPLITUDE * np.cos(PHASE), AMPLITUDE * np.sin(PHASE)
    np.testing.assert_allclose(found.value, [a, b], atol=6.0 * found.unit_limit.max())


def test_without_a_ripple_no_order_is_significant(plain: Campaign) -> None:
    estimate = estimate_of(plain)
    found = order_scores(estimate, space_of(estimate), catalogue())
    assert len(found) == 6
    assert all(s.log_p > np.log(0.005 / 6) and s.bic < 0.0 for s in found)


@pytest.mark.slow
def test_a_ripple_of_unknown_order_is_named_with_its_order(rippled: Campaign) -> None:
    found = diagnose(identify(rippled), rippled).stages["free_air"]
    assert (found.verdict, [(c["name"], c["where"]) for c in found.candidates]) == (
        "missing",
        [("gear_ripple", ["joint3"])],
    )
    known = {p["name"].partition(".")[2].partition("@")[0]: p for p in found.candidates[0]["parameters"]}
    truth = {"a": AMPLITUDE * np.cos(PHASE), "b": AMPLITUDE * np.sin(PHASE), "k": ORDER}
    for name, value in truth.items():
        assert abs(known[name]["value"] - value) < 4.0 * known[name]["std"]
    assert found.after < found.before


@pytest.mark.slow
def test_add_and_identify_search_the_order_themselves(rippled: Campaign) -> None:
    model = identify(rippled)
    mended, _ = add(model, rippled, [f"gear_ripple@joint{JOINT}"])
    terms = [*(t.effect for t in model.stages["free_air"].terms), f"gear_ripple@joint{JOINT}"]
    for found in (mended, identify(rippled, terms)):
        orders = [v for s, v in found.stages["free_air"].values().items() if s.parameter == "k"]
        assert orders == [pytest.approx(ORDER, abs=2e-3)]
    with pytest.raises(EffectError, match="in the model already"):
        add(mended, rippled, [f"gear_ripple@joint{JOINT}"])
