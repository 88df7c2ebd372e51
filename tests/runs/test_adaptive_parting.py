"""Proposed poses part two look-alikes with fewer measurements than random ones; the benchmark has more robots."""

from __future__ import annotations

import numpy as np
import pytest
from adaptive_parting import trial


@pytest.mark.slow
@pytest.mark.parametrize(("pair", "seeds"), [("wrist", range(100, 106)), ("arm", range(100, 104))])
def test_proposed_poses_part_a_pair_with_half_of_what_random_ones_need(pair: str, seeds: range) -> None:
    ratios = []
    for seed in seeds:
        row = trial(pair, seed)
        assert row["random"] > 0  # not parted by the first campaign already
        ratios.append(row["proposed"] / row["random"])
    assert np.median(ratios) <= 0.5
