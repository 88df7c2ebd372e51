"""What a live fit calls known: what rows tell, and neither a shape's assumption nor the description's masses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from run_controller import poses_plan

from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.loop.known_here import known_before, known_here
from experiments.campaign import read_campaign
from experiments.plans import Cell, Limits
from experiments.plans.virtual import run_virtually


def test_a_prior_is_not_what_rows_tell(cell: Cell, limits: Limits, tmp_path: Path) -> None:
    campaign = read_campaign(run_virtually(poses_plan(cell, limits, 30), tmp_path / "C", seed=3))
    model = identify(campaign, ["geometry", "joint_compliance", "gravity", "warm_up_expansion@link4"])
    fitted, opened = model.stages["poses"], on_campaign(model, campaign)
    names = [slot.label for slot in fitted.slots]
    tau, m = names.index("warm_up_expansion.tau@link4"), names.index("gravity.m@link1")
    covariance = fitted.covariance.copy()  # as where the growth is zero, and rows tell nothing of its time constant
    covariance[tau] = covariance[:, tau] = 0.0
    covariance[tau, tau] = (0.99 * 3 * 3600.0) ** 2
    identified = [*fitted.identified]
    identified[tau] = True  # it is below its size, which is all that its prior says
    stage = replace(fitted, covariance=covariance, identified=tuple(identified))
    known = known_here(stage, {}, opened.rows("poses"), opened.effects)
    before = known_before(stage, {}, opened.rows("poses"), opened.effects)
    assert not known[tau]
    assert not before[tau]
    assert before[m]
    assert not known[m]
    assert np.all(known <= np.array(stage.identified))
    geometry = [k for k, slot in enumerate(stage.slots) if slot.effect == "geometry"]
    assert known[geometry].mean() > 0.8
