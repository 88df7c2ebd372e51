"""Measurements for several open pairs at once: what is chosen, how many, and the chance that they decide each."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clampid.diagnosis.deciding import Deciding, OpenPair, chance_decided, decide_most
from clampid.diagnosis.next_measurement import POWER, SAME
from clampid.diagnosis.refit_signals import Rivals

WEIGHT = np.zeros((0, 0))
POOL = 100


def pair(difference: np.ndarray, evidence: float = 0.0) -> OpenPair:
    """Two effects that are one in the rows so far; in the pool they differ by so much, measurement by measurement."""
    rows = 5.0 * np.random.default_rng(1).normal(size=(30, 1))
    one = np.ones((POOL, 1, 1))
    other = one - difference.reshape(POOL, 1, 1)
    rivals = Rivals(np.zeros((30, 0)), [rows, rows.copy()], [np.ones(1), np.ones(1)], WEIGHT)
    return OpenPair(rivals, (np.zeros((POOL, 1, 0)), [one, other]), evidence)


def everywhere(difference: float) -> np.ndarray:
    return np.full(POOL, difference)


def at(numbers: range, difference: float) -> np.ndarray:
    return np.where(np.isin(np.arange(POOL), numbers), difference, 0.0)


def chosen(pairs: list[OpenPair], most: int = 40, batch: int = 5) -> Deciding:
    return decide_most(pairs, bound=SAME, power=POWER, batch=batch, most=most)


@pytest.mark.parametrize("evidence", [0.0, 6.0, -14.0])
def test_the_chance_is_the_share_of_campaigns_in_which_a_pair_is_decided(evidence: float) -> None:
    """Rows of known noise are drawn under either effect, as likely as the evidence says, and the odds are computed."""
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, 40)) * 0.55
    gain = float(np.sum((first - second) ** 2))
    campaigns = 20000
    likely = rng.random(campaigns) < 1.0 / (1.0 + np.exp(-evidence / 2.0))
    y = np.where(likely[:, None], first, second) + rng.normal(size=(campaigns, 40))
    then = evidence + np.sum((y - second) ** 2, axis=1) - np.sum((y - first) ** 2, axis=1)
    share = float(np.mean(np.abs(then) >= SAME))
    assert chance_decided(evidence, (gain, gain), SAME) == pytest.approx(share, abs=0.012)


@settings(max_examples=50, deadline=None)
@given(st.floats(-19.9, 19.9), st.floats(0.0, 200.0), st.floats(0.0, 200.0))
def test_chances_are_chances_and_which_effect_is_called_the_first_does_not_matter(e: float, a: float, b: float) -> None:
    chance = chance_decided(e, (a, b), SAME)
    assert 0.0 <= chance <= 1.0
    assert chance == pytest.approx(chance_decided(-e, (b, a), SAME))


def test_nothing_is_decided_by_what_brings_nothing() -> None:
    assert chance_decided(10.0, (0.0, 0.0), SAME) == 0.0
    assert chance_decided(0.0, (1e4, 1e4), SAME) == pytest.approx(1.0)


def test_one_choice_decides_all_pairs() -> None:
    found = chosen([pair(everywhere(10.0)), pair(everywhere(5.0))])
    assert len(found.chosen) == 5
    assert np.all(found.chances >= POWER)
    assert found.before == pytest.approx([0.0, 0.0], abs=1e-6)


def test_measurements_that_say_something_of_every_pair_come_before_those_of_one() -> None:
    """10 to 19 differ for both pairs, 0 to 9 for the first and 20 to 29 for the second alone, a little more each."""
    both = at(range(10, 20), 3.0)
    found = chosen([pair(both + at(range(10), 3.3)), pair(both + at(range(20, 30), 3.3))], batch=5, most=5)
    assert set(found.chosen) <= set(range(10, 20))


def test_a_pair_that_little_decides_does_not_wait_for_one_that_needs_much() -> None:
    easy, hard = pair(everywhere(4.0)), pair(everywhere(1.2))
    found = chosen([easy, hard])
    assert len(found.chosen) == 5
    assert found.chances[0] > POWER > 0.5 > found.chances[1]
    assert len(chosen([hard]).chosen) > 5


def test_evidence_so_far_counts() -> None:
    nearly, none = chosen([pair(everywhere(1.2), 18.0)]), chosen([pair(everywhere(1.2))])
    assert len(nearly.chosen) < len(none.chosen)


def test_what_no_measurement_decides_is_left_out_and_what_takes_more_is_still_chosen() -> None:
    with_aliased = chosen([pair(everywhere(10.0)), pair(everywhere(0.0))])
    assert len(with_aliased.chosen) == 5
    assert with_aliased.chances.tolist() == [pytest.approx(1.0, abs=1e-3), 0.0]
    none = chosen([pair(everywhere(0.0))])
    assert none.chosen == ()
    assert none.decided == 0.0
    short = chosen([pair(everywhere(2.5))], most=2)
    assert len(short.chosen) == 2
    assert 0.0 < short.chances[0] < POWER
