"""The positions that effects of an instrument and probes read: where points are, and not how they were misread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from scipy.spatial.distance import pdist

from clampid.stages.layout import layout_of
from clampid.stages.pose_rows import pose_rows
from experiments.campaign import Campaign


def test_noise_of_the_points_is_not_in_the_positions_that_explain_it(simulated: Callable[..., Campaign]) -> None:
    """A fit that explains a position column but for its noise would leave the noise, which then explains itself."""
    campaign = simulated(seed=1, poses=20, tables=("poses",))
    table = campaign.tables["poses"].copy()
    columns = ["x_m", "y_m", "z_m"]
    table[columns] += 1e-3 * np.random.default_rng(0).standard_normal((len(table), 3))
    noisy = replace(campaign, tables=MappingProxyType({**campaign.tables, "poses": table}))
    layout = layout_of([campaign])
    read = [pose_rows([c], layout, "poses") for c in (campaign, noisy)]
    assert np.abs(read[1].measured - read[0].measured).max() > 1e-3
    first, second = (rows.signals["position"] for rows in read)
    assert np.allclose(pdist(first), pdist(second), atol=1e-12)  # another alignment, the same points
    assert np.abs(first - read[0].measured[:, :3]).max() < 2e-2
