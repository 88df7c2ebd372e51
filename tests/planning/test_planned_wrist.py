"""A planned wrist program tells the motor's friction and the arm's apart; a few swings do not.

The study itself is benchmarks/planned_wrist.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import planned_wrist
import pytest

from experiments.plans import write_plan

ARM = [k for k, name in enumerate(planned_wrist.ASKED) if name.startswith("F ")]


@pytest.mark.slow
def test_a_planned_program_tells_the_two_sides_apart(tmp_path: Path) -> None:
    plan, path = planned_wrist.planned(), tmp_path / "wrist.toml"
    write_plan(plan, path)
    promised = planned_wrist.promised(plan)
    both = [planned_wrist.trial(path, seed) for seed in (1, 2, 3)]
    for by_plan, usual in both:
        assert not by_plan.claimed
        assert not usual.claimed  # joint 4 and its motor only turn together
        assert np.all(by_plan.std[ARM] < 0.5)  # Nm, of 1.5 to 8
        assert np.all(usual.std[ARM] > 5 * by_plan.std[ARM])
    z = np.concatenate([t.error / t.std for t, _ in both])
    assert np.sqrt(np.mean(z**2)) < 1.66  # of twelve: more in one case of 1 000, were they independent
    # Of noise of 0.6 to 1.2 % of the rated torque, where the plan took 1 %.
    assert np.all(np.array([t.std for t, _ in both]) < 2 * promised)
