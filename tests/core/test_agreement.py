"""Clamped stiffness against the stiffness that the poses want: independent, calibrated, and with power."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from clampid.comparison.compare import compare
from clampid.identification.identify import identify
from clampid.models.agreement import agreement_of
from clampid.models.model import StageModel
from clampid.slots import Slot, Term
from clampid.verbs.findings import show_comparison
from clampid.verbs.output import Output
from experiments.campaign import Campaign

Simulated = Callable[..., Campaign]
TRUE = np.r_[np.full(6, 0.1), np.full(6, 1e-4)]


def stage_of(name: str, std: np.ndarray, rng: np.random.Generator, shift: np.ndarray | None = None) -> StageModel:
    slots = tuple(
        Slot(e, p, f"joint{j + 1}") for e, p in (("joint_compliance", "c"), ("backlash", "gap")) for j in range(6)
    )
    root = np.diag(std) @ (np.eye(12) + 0.3 * rng.random((12, 12)))
    theta = TRUE + root @ rng.standard_normal(12) + (0.0 if shift is None else shift)
    return StageModel(name, (Term("joint_compliance"), Term("backlash")), slots, theta, root @ root.T, (True,) * 12)  # type: ignore[arg-type]


def pair_of(seed: int, shift: np.ndarray | None = None) -> tuple[StageModel, StageModel]:
    rng = np.random.default_rng(seed)
    return stage_of("clamped", 0.01 * TRUE, rng), stage_of("poses", 0.05 * TRUE, rng, shift)


def test_false_alarm_rate_of_drive_contradictions():
    found = [agreement_of(*pair_of(seed)) for seed in range(400)]
    together = np.array([p for _, p in found])
    assert stats.kstest(together, "uniform").pvalue > 1e-3
    alarms = np.mean([any(a.verdict == "differs" for a in each) for each, _ in found])
    assert 0.01 < alarms < 0.08
    assert np.std([a.z for each, _ in found for a in each]) == pytest.approx(1.0, abs=0.05)


def test_a_spring_that_differs_is_named():
    shift = np.zeros(12)
    shift[4] = 0.6 * TRUE[4]
    for seed in range(20):
        each, together = agreement_of(*pair_of(seed, shift))
        assert each[4].verdict == "differs"
        assert together is not None
        assert together < 1e-3
        assert [a.slot.place for a in each[:6]] == [f"joint{j + 1}" for j in range(6)]


def test_what_the_poses_do_not_determine_is_not_tested():
    clamped, poses = pair_of(0, np.full(12, 10.0))
    each, together = agreement_of(clamped, replace(poses, identified=(False,) * 12))
    assert {a.verdict for a in each} == {"not testable"}
    assert together is None
    only = replace(poses, slots=poses.slots[:2], theta=poses.theta[:2], covariance=poses.covariance[:2, :2])
    assert len(agreement_of(clamped, only)[0]) == 2


@pytest.mark.slow
def test_compare_shows_it_on_the_virtual_robot(simulated: Simulated, capsys: pytest.CaptureFixture[str]):
    campaign = simulated(seed=3, poses=100, tables=("clamped", "poses", "verification"))
    effects = {"poses": ["geometry", "joint_compliance", "backlash"]}
    comparison = compare(identify(campaign, effects), campaign)
    data = comparison.to_json()
    assert len(data["drives"]["parameters"]) == 12
    first = data["drives"]["parameters"][0]
    assert first["where"] == "joint1"
    assert first["clamped_std"] > 0
    assert first["unit"] == "rad/Nm"
    show_comparison({**data, "model": "m", "campaign": "c"}, Output(False, None))
    assert "clamped sweeps against poses" in capsys.readouterr().out
    # Joint 1 turns about the vertical: gravity never loads its spring in the poses.
    assert first["verdict"] == "not testable"
