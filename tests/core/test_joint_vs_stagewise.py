"""Stage by stage against the joint fit: as rare an alarm as it says; a contradiction is found, both values kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clampid.identification.joint_vs_stagewise import StageDisagreement, joint_fit_disagreements
from clampid.models.model import StageModel
from clampid.slots import Slot, Term

SLOTS = tuple(Slot("joint_compliance", "c", f"joint{j + 1}") for j in range(6))
TRUE = np.linspace(1.0, 2.0, 6)


def stage_of(theta: np.ndarray, covariance: np.ndarray) -> StageModel:
    return StageModel("clamped", (Term("joint_compliance"),), SLOTS, theta, covariance, (True,) * 6)


def both(seed: int, shift: float = 0.0) -> tuple[StageModel, StageModel]:
    """A stage alone and together with others that know ``shift`` more of joint 3; linear, so joint is exact."""
    rng = np.random.default_rng(seed)
    roots = [
        np.diag(s) @ (np.eye(6) + 0.3 * rng.random((6, 6))) for s in (np.full(6, 0.02), rng.uniform(0.01, 0.04, 6))
    ]
    spreads = [r @ r.T for r in roots]
    moved = TRUE + shift * (np.arange(6) == 2)
    alone, others = (c + r @ rng.standard_normal(6) for c, r in zip((TRUE, moved), roots, strict=True))
    A, B = (np.linalg.inv(c) for c in spreads)
    together = np.linalg.inv(A + B)
    return stage_of(alone, spreads[0]), stage_of(together @ (A @ alone + B @ others), together)


def test_false_alarm_rate_of_stage_contradictions():
    alarms = np.mean([bool(joint_fit_disagreements(*both(seed), SLOTS)) for seed in range(1000)])
    assert alarms < 0.065  # 5 %, less where a variance counts as more than it is; binomial error 0.7 %
    assert alarms > 0.005


def test_a_contradiction_is_found_and_both_values_are_kept():
    found: tuple[StageDisagreement, ...] = ()
    for seed in range(20):
        pair = both(seed, shift=0.8)
        found = joint_fit_disagreements(*pair, SLOTS)
        assert SLOTS[2] in [m.slot for m in found], seed
        told = next(m for m in found if m.slot == SLOTS[2]).to_json()
        assert (told["apart"], told["joint"]) == (pair[0].theta[2], pair[1].theta[2])
        assert told["z"] > 0


def test_what_no_stage_shares_or_no_row_determines_is_not_tested():
    alone, together = both(0, shift=2.0)
    assert joint_fit_disagreements(alone, together, ()) == ()
    unknown = replace(alone, identified=(False,) * 6)
    assert joint_fit_disagreements(unknown, together, SLOTS) == ()
