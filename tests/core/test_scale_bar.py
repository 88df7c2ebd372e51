"""A certified distance between two targets tells the instrument's scale, which free targets and links absorb."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from test_distances import TARGETS, measured

from clampid.identification.identify import identify
from experiments.stated import CertifiedDistance, Stated

SCALE, BAR_STD = 2e-4, 2e-6


def test_a_certified_distance_determines_the_scale_of_the_instrument() -> None:
    campaign = measured(2, points=True, distances=False, individual=True, poses=100)
    table = campaign.tables["poses"].copy()
    table[["x_m", "y_m", "z_m"]] *= 1.0 + SCALE
    length = float(np.linalg.norm(np.subtract(TARGETS["T1"], TARGETS["T2"])))
    bar = CertifiedDistance(("T1", "T2"), length, BAR_STD)
    found = []
    for distances in ((), (bar,)):
        scaled = replace(campaign, tables={"poses": table}, stated=Stated(distances=distances))
        stage = identify(scaled, ["geometry", "instrument_scale"]).stages["poses"]
        k = next(i for i, s in enumerate(stage.slots) if s.effect == "instrument_scale")
        found.append((float(stage.theta[k]), float(stage.std[k])))
    (_, without), (value, std) = found
    assert without > 1.5e-4  # the prior's 2e-4: the rows alone say nothing
    assert std < 6e-5
    assert abs(value - SCALE) < 3.0 * std
