"""A clamp that begins to give way: found against earlier sweeps, at the stated rate of false alarms."""

from __future__ import annotations

import numpy as np
import pytest
from clamped_arm import noisy_sweeps, sweeps_of
from run_controller import CLAMPED, clamping_plan

from experiments.plans import Cell, Limits, Plan
from experiments.plans.press import flange_jacobian
from experiments.runs.loosening import Loosening, find_loosening
from experiments.runs.slips import SweepRows
from experiments.runs.sweep_noise import noise_of
from experiments.runs.sweeps import FALSE_ALARM

TILT = np.array([6e-5, 6e-5, 6e-5])  # a tenth of a millimetre from rest to rest


def looked_through(
    plan: Plan, sweeps: list[SweepRows], looks: int | None = None, level: float = FALSE_ALARM / 2
) -> list[Loosening | None]:
    jacobian, joints = flange_jacobian(plan.cell.robot, CLAMPED), [sweep.joint for sweep in plan.sweeps]
    robot, stiffness, looks = plan.cell.robot, plan.stiffness / 1.6, looks or len(sweeps)
    return [
        find_loosening(sweeps[:k], robot, stiffness, jacobian, joints[:k], looks=looks, level=level)
        for k in range(1, len(sweeps) + 1)
    ]


@pytest.mark.parametrize(("seed", "stiffer"), [(1, 1.0), (2, 1.0), (4, 1.0), (16, 1.6), (18, 1.6), (19, 1.6)])
def test_rocking_that_begins_in_sweep_3_is_named_before_sweep_5(
    cell: Cell, limits: Limits, seed: int, stiffer: float
) -> None:
    plan = clamping_plan(cell, limits, [(1, joint, CLAMPED) for joint in (1, 2, 1, 2)])
    found = looked_through(plan, sweeps_of(cell, plan, seed, stiffer=stiffer, rocks=TILT, since=3))
    assert found[:2] == [None, None]
    named = next(each for each in found if each is not None)
    assert named.first >= 3 > named.before
    assert 0.4 * np.linalg.norm(TILT) < named.size < 3 * np.linalg.norm(TILT)


@pytest.mark.parametrize(
    ("stiffer", "least"),
    [pytest.param(1.0, 17, marks=pytest.mark.study), pytest.param(1.6, 19, marks=pytest.mark.study)],
)
def test_of_twenty_robots_all_are_named_whose_block_tilts(
    cell: Cell, limits: Limits, stiffer: float, least: int
) -> None:
    """Other robots than those that the test was made with; where the load never changes its sign, nothing tilts."""
    plan = clamping_plan(cell, limits, [(1, joint, CLAMPED) for joint in (1, 2, 1, 2)])
    named = [
        any(looked_through(plan, sweeps_of(cell, plan, seed, stiffer=stiffer, rocks=TILT, since=3))[2:])
        for seed in range(200, 220)
    ]
    assert sum(named) >= least


@pytest.mark.parametrize("block", [pytest.param(0.0, marks=pytest.mark.study), 1e-7])
@pytest.mark.parametrize(
    "stiffer", [pytest.param(1.0, marks=pytest.mark.slow), pytest.param(1.6, marks=pytest.mark.study)]
)
def test_a_clamp_that_holds_or_yields_has_not_come_loose(
    cell: Cell, limits: Limits, block: float, stiffer: float
) -> None:
    """Twenty runs of five sweeps each; one false alarm in two thousand runs is stated."""
    plan = clamping_plan(cell, limits, [(1, joint, CLAMPED) for joint in (1, 2, 1, 2, 1)])
    for seed in range(520, 540):
        rows = sweeps_of(cell, plan, seed, stiffer=stiffer, block=[block] * 3 + [10 * block] * 3)
        assert not any(looked_through(plan, rows))


def test_the_stated_rate_of_false_alarms_is_kept(cell: Cell, limits: Limits) -> None:
    """With a rate of 20 % a run, slow noise and a drift give no more; three errors of a count aside."""
    plan = clamping_plan(cell, limits, [(1, 1, CLAMPED)] * 4)
    tried = 100
    alarms = sum(any(looked_through(plan, noisy_sweeps(plan, seed), level=0.2)) for seed in range(tried))
    assert alarms <= 0.2 * tried + 3 * np.sqrt(0.2 * 0.8 * tried)


def test_a_clamp_that_holds_more_firmly_than_before_is_no_alarm(cell: Cell, limits: Limits) -> None:
    plan = clamping_plan(cell, limits, [(1, 1, CLAMPED)] * 3)
    rows = sweeps_of(cell, plan, 1, stiffer=1.6, rocks=TILT, since=3)
    assert looked_through(plan, rows)[2] is not None
    backwards = [rows[2], rows[2], rows[0]]
    assert find_loosening(
        backwards,
        cell.robot,
        plan.stiffness / 1.6,
        flange_jacobian(cell.robot, CLAMPED),
        [1, 1, 1],
        level=FALSE_ALARM / 2,
    ) is None  # fmt: skip


def test_noise_is_that_of_what_the_loops_do_not_share(cell: Cell, limits: Limits) -> None:
    """A signal of the driven joint does not count; an autoregression has the power that its formula says."""
    plan, memory = clamping_plan(cell, limits, [(1, 1, CLAMPED)] * 40), 0.5
    rows = noisy_sweeps(plan, 3, memory)
    still = ~rows[0].turned
    angle = 2 * np.pi * 2 * np.arange(1, 7) / len(rows[0].time)
    power = 1.0 / (1.0 - 2.0 * memory * np.cos(angle) + memory**2)
    size = np.array([0.1, 0.05, 0.05, 0.02, 0.02, 0.02])
    found = [noise_of(noisy_sweeps(plan, seed, memory), 6) for seed in range(10)]
    share = np.array([np.outer(n.variance[still] / size[still] ** 2, n.spectrum / power) for n in found])
    error = np.std(share, axis=0, ddof=1) / np.sqrt(len(share))
    assert np.all(np.abs(share.mean(axis=0) - 1.0) < 0.04 + 3.5 * error)
    assert np.max(error) < 0.05
    noise = noise_of(rows, 6)
    assert np.all(np.isnan(noise.variance[~still]))
    loaded = [
        SweepRows(r.number, r.time, r.offset, r.direction, r.torque + 1e3 * r.offset[:, None], r.turned) for r in rows
    ]
    with_signal = noise_of(loaded, 6)
    assert with_signal is not None
    np.testing.assert_allclose(with_signal.variance[still], noise.variance[still], rtol=1e-6)


def test_sweeps_that_are_no_two_equal_loops_say_nothing(cell: Cell, limits: Limits) -> None:
    plan = clamping_plan(cell, limits, [(1, 1, CLAMPED)] * 2)
    rows = noisy_sweeps(plan, 1)
    short = [SweepRows(r.number, r.time[:48], r.offset[:48], r.direction[:48], r.torque[:48], r.turned) for r in rows]
    assert noise_of(short, 2) is None
    assert find_loosening(
        short, cell.robot, plan.stiffness, flange_jacobian(cell.robot, CLAMPED), [1, 1], level=1.0
    ) is None  # fmt: skip
