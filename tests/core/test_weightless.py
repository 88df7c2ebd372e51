"""What holds the arm's weight is not sought at joints that bear none, even where they accelerate."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clampid.catalogue import catalogue
from clampid.diagnosis.scoring import scores_of
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from experiments.campaign import Campaign


def test_no_balancer_is_sought_at_an_upright_joint_that_accelerates(simulated: Callable[..., Campaign]) -> None:
    campaign = simulated(seed=7, tables=("free_air",))
    estimate = on_campaign(identify(campaign), campaign).refit("free_air").estimate
    signals = estimate.problem.rows.signals
    assert np.abs(signals["regressor"][:, 0]).max() > 1.0  # of inertia
    assert np.abs(signals["gravity_torque"][:, 0]).max() < 1e-9
    scores = scores_of(estimate, dict(catalogue()), flips=19, seed=0)
    states = {s.candidate.label: s.state for s in scores.named}
    assert states["gravity_compensator@joint1"] == "absent"
    assert states["gravity_compensator@joint2"] == "testable"
    assert states["torque_ripple@joint1"] == "testable"
