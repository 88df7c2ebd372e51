"""Measurements for several pairs of look-alikes at once: each beside a fit of its own, within what is allowed."""

from __future__ import annotations

import numpy as np
import pytest

from clampid.diagnosis.next_measurement import ENOUGH
from clampid.diagnosis.parting import Rivals, part_each

WEIGHT = np.zeros((0, 0))


def pair(seen: float, *, aliased: bool = False) -> tuple[Rivals, tuple[np.ndarray, list[np.ndarray]]]:
    """Two candidates that are one in the rows so far; in the pool the second stays behind by ``seen`` a measurement."""
    rng = np.random.default_rng(1)
    rows = 5.0 * rng.normal(size=(30, 1))
    columns = [rows, rows.copy()]
    pool = np.ones((100, 1, 1))
    other = pool.copy() if aliased else pool - seen
    rivals = Rivals(np.zeros((30, 0)), columns, [np.ones(1), np.ones(1)], WEIGHT)
    return rivals, (np.zeros((100, 1, 0)), [pool, other])


def chosen(pairs: list[tuple[Rivals, tuple[np.ndarray, list[np.ndarray]]]], most: int):
    return part_each([p[0] for p in pairs], [p[1] for p in pairs], enough=ENOUGH, batch=5, most=most)


def test_one_choice_separates_all_pairs() -> None:
    found = chosen([pair(10.0), pair(5.0)], 40)
    assert found.pairs == (0, 1)
    assert found.parted
    assert np.all(found.after >= ENOUGH)
    assert found.before == pytest.approx([0.0, 0.0], abs=1e-6)


def test_no_more_than_is_allowed_and_the_hardest_pair_is_left_out() -> None:
    easy, hard = pair(10.0), pair(2.5)
    both, few = chosen([easy, hard], 40), chosen([easy, hard], 3)
    assert both.pairs == (0, 1)
    assert len(both.chosen) > 3
    assert few.pairs == (0,)
    assert len(few.chosen) <= 3
    assert few.parted


def test_what_no_measurement_separates_is_left_out_and_what_takes_more_is_still_chosen() -> None:
    assert chosen([pair(10.0), pair(0.0, aliased=True)], 40).pairs == (0,)
    none = chosen([pair(0.0, aliased=True)], 40)
    assert (none.chosen, none.pairs) == ((), ())
    short = chosen([pair(2.5)], 2)
    assert len(short.chosen) == 2
    assert not short.parted
    assert 0.0 < short.after[0] < ENOUGH
