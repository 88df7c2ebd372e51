"""Ways since a reversal, from the order of visits, and the lost motion that a joint has after a short one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clampid.effects.presliding_lost_motion import missing
from clampid.stages.reversals import UNKNOWN_WAY, since_reversal
from experiments.campaign import Campaign

STEPS = st.lists(st.sampled_from([-0.3, -0.1, 0.0, 0.2, 0.5]), min_size=2, max_size=12)


@pytest.fixture(scope="module")
def arm(simulated: Callable[..., Campaign]) -> Campaign:
    return simulated(seed=1, poses=20, tables=("poses",))


def visited(arm: Campaign, q: Sequence[float], side: Sequence[float], rows: int = 1) -> Campaign:
    """A campaign whose joint 1 stands at ``q`` in turn, its last motions ``side``; the other joints stand still."""
    n, count = arm.robot.n, len(q)
    table = pd.DataFrame({"pose": range(count), "visit": 0, "time_s": 10.0 * np.arange(count)})
    for i in range(1, n + 1):
        table[f"q{i}_rad"], table[f"dir{i}"] = (q, side) if i == 1 else (0.0, 1)
    return replace(arm, tables={"poses": table.loc[table.index.repeat(rows)].reset_index(drop=True)})


def test_a_way_goes_on_until_the_joint_turns_back(arm: Campaign) -> None:
    way, back = since_reversal(visited(arm, [0.0, 0.2, 0.5, 0.4, 0.1], [1, 1, 1, -1, -1]), "poses")
    np.testing.assert_allclose(way[:, 0], [UNKNOWN_WAY, UNKNOWN_WAY + 0.2, UNKNOWN_WAY + 0.5, 0.1, 0.4])
    assert not back.any()


def test_a_last_motion_against_the_way_is_short_by_an_unknown_length(arm: Campaign) -> None:
    way, back = since_reversal(visited(arm, [0.0, 0.5, 0.2, 0.1], [1, -1, 1, 1]), "poses")
    np.testing.assert_array_equal(back[:, 0], [0, 1, 1, 1])
    assert (way[:, 0] == UNKNOWN_WAY).all()


@given(steps=STEPS, seed=st.integers(0, 99))
def test_ways_do_not_depend_on_the_order_of_rows_nor_on_how_often_a_visit_was_read(
    arm: Campaign, steps: list[float], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    q, side = np.cumsum(steps), rng.choice([-1.0, 0.0, 1.0], len(steps))
    once = since_reversal(visited(arm, q, side), "poses")
    thrice = visited(arm, q, side, rows=3)
    shuffled = thrice.tables["poses"].sample(frac=1.0, random_state=seed)
    found = since_reversal(replace(arm, tables={"poses": shuffled}), "poses")
    for a, b in zip(once, found, strict=True):
        np.testing.assert_allclose(a[shuffled["pose"]], b, atol=1e-9)


@given(steps=STEPS, seed=st.integers(0, 99))
def test_a_mirrored_motion_has_the_same_ways(arm: Campaign, steps: list[float], seed: int) -> None:
    q, side = np.cumsum(steps), np.random.default_rng(seed).choice([-1.0, 1.0], len(steps))
    for a, b in zip(
        since_reversal(visited(arm, q, side), "poses"), since_reversal(visited(arm, -q, -side), "poses"), strict=True
    ):
        np.testing.assert_array_equal(a, b)


def test_the_order_goes_on_from_one_table_to_the_next(arm: Campaign) -> None:
    """A verification between two poses: the joint came to the second one from there."""
    whole = visited(arm, [0.0, 0.5, 0.3, 0.2], [1, 1, -1, -1])
    table = whole.tables["poses"]
    parted = replace(whole, tables={"poses": table.drop(index=2), "verification": table.loc[[2]]})
    way, _ = since_reversal(whole, "poses")
    np.testing.assert_array_equal(since_reversal(parted, "poses")[0], way[[0, 1, 3]])
    np.testing.assert_array_equal(since_reversal(parted, "verification")[0], way[[2]])


def test_what_is_missing_is_that_of_a_state_that_follows_the_motion(arm: Campaign) -> None:
    """Dahl's law in small steps of the motion, dz/dx = (sign - z) / l, of joints that come from far away."""
    length, size = 0.12, 2e-4
    ends = np.array([0.0, 3.0, 2.95, 2.8, 0.0, 0.02, 0.3, 3.0])
    z, states = 1.0, [1.0]
    for a, b in pairwise(ends):
        way, steps = abs(b - a), 20_000
        for _ in range(steps):
            z += way / steps / length * (np.sign(b - a) - z)
        states.append(z)
    side = np.r_[1.0, np.sign(np.diff(ends))]
    way, back = since_reversal(visited(arm, ends, side), "poses")
    p = SimpleNamespace(missing=2.0 * size, short=0.0, length=length)
    x = SimpleNamespace(direction=ca.DM(side), reversal_way=ca.DM(way[:, 0]), turned_back=ca.DM(back[:, 0]))
    error = np.asarray(missing(p, x), dtype=float).ravel() - size * side
    np.testing.assert_allclose(error, -size * np.array(states), atol=1e-3 * size)
