"""A clamp that rocks: found from the motors that stand, and not where the clamp holds or merely yields."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from clamped_arm import noisy_sweeps, sweeps_of
from run_controller import CLAMPED, Controller, clamping_plan

from experiments.plans import Cell, Limits, Plan
from experiments.plans.press import flange_jacobian
from experiments.runs.errors import RunStopped
from experiments.runs.folder import tables_of, work_folder
from experiments.runs.journal import whole_lines
from experiments.runs.rocking import Rocking, find_rocking
from experiments.runs.runner import run
from experiments.runs.slips import SweepRows, find_shift
from experiments.runs.sweeps import FALSE_ALARM
from experiments.virtual_controller.arm import Arm

TILT = np.array([6e-5, 6e-5, 6e-5])  # a tenth of a millimetre from rest to rest


def looked_through(plan: Plan, sweeps: list[SweepRows]) -> list[Rocking | None]:
    stiffness, jacobian = plan.stiffness / 1.6, flange_jacobian(plan.cell.robot, CLAMPED)
    looks, level = len(plan.sweeps), FALSE_ALARM / 2
    return [
        find_rocking(sweeps[:k], plan.cell.robot, stiffness, jacobian, sweep.joint, looks=looks, level=level)
        for k, sweep in enumerate(plan.sweeps, 1)
    ]


@pytest.mark.parametrize("seed", range(4))
def test_a_tenth_of_a_millimetre_is_found_with_stiffer_springs(cell: Cell, limits: Limits, seed: int) -> None:
    """Noise and friction are the virtual robot's; its springs are 1.6 times as stiff as it would have them."""
    plan = clamping_plan(cell, limits, [(1, 1, CLAMPED), (1, 2, CLAMPED), (1, 1, CLAMPED)])
    rows = sweeps_of(cell, plan, seed, stiffer=1.6, rocks=TILT, since=2)
    before, _, after = looked_through(plan, rows)
    assert before is None
    assert after is not None
    assert (after.first, after.last) == (3, 3)
    assert after.turns >= 3
    assert np.linalg.norm(TILT) / 2 < after.size < 3 * np.linalg.norm(TILT)
    assert after.p_value <= FALSE_ALARM
    assert find_shift(rows, cell.robot, plan.stiffness / 1.6, flange_jacobian(cell.robot, CLAMPED)) is None


@pytest.mark.parametrize("block", [pytest.param(0.0, marks=pytest.mark.study), 1e-7])
@pytest.mark.parametrize(
    "stiffer", [pytest.param(1.0, marks=pytest.mark.slow), pytest.param(1.6, marks=pytest.mark.study)]
)
def test_a_clamp_that_holds_or_yields_does_not_rock(cell: Cell, limits: Limits, block: float, stiffer: float) -> None:
    """Twenty runs of four sweeps each; one false alarm in a thousand runs is stated."""
    plan = clamping_plan(cell, limits, [(1, joint, CLAMPED) for joint in (1, 2, 0, 4)])
    alarms = 0
    for seed in range(500, 520):
        rows = sweeps_of(cell, plan, seed, stiffer=stiffer, block=[block] * 3 + [10 * block] * 3)
        alarms += sum(found is not None for found in looked_through(plan, rows))
    assert alarms == 0


@pytest.mark.parametrize("looks", [1, 3])
def test_the_stated_rate_of_false_alarms_is_kept(cell: Cell, limits: Limits, looks: int) -> None:
    """With a rate of 20 %, slow noise gives no more alarms than that; three errors of a count aside."""
    plan = clamping_plan(cell, limits, [(1, 1, CLAMPED)] * looks)
    tried, alarms = 100, 0
    for seed in range(tried):
        rows = noisy_sweeps(plan, seed)
        found = [
            find_rocking(
                rows[:k], cell.robot, plan.stiffness, flange_jacobian(cell.robot, CLAMPED), 1, looks=looks, level=0.2
            )
            for k in range(1, looks + 1)
        ]
        alarms += any(found)
    assert alarms <= 0.2 * tried + 3 * np.sqrt(0.2 * 0.8 * tried)


def test_the_same_tilt_in_several_sweeps_adds_up(cell: Cell, limits: Limits) -> None:
    """A robot with springs as described, whose clamp rocks from the start: one sweep is too few, four show it."""
    plan = clamping_plan(cell, limits, [(1, 1, CLAMPED)] * 4)
    found = looked_through(plan, sweeps_of(cell, plan, 13, rocks=TILT))
    assert found[0] is None
    late = found[3]
    assert late is not None
    assert late.first < late.last == 4


def test_a_rocking_block_lies_where_the_load_pushes_it(cell: Cell) -> None:
    arm = Arm(cell.robot, seed=2, posture=CLAMPED)
    arm.clamp(1.0)
    arm.rock(1.0, TILT.tolist())
    moved = []
    now = 1.0
    for offset in (1e-3, -1e-3):
        to = np.array(CLAMPED)
        to[1] += offset
        now = arm.go(now, to, 0.02) + 1.0
        moved.append(arm.gauges(now)[:3])
    along = TILT / np.linalg.norm(TILT)
    rigid = arm.plant.fixture.compliance[:3].max() * 3000.0
    assert abs((moved[0] - moved[1]) @ along) == pytest.approx(np.linalg.norm(TILT), abs=rigid + 2e-5)


@pytest.mark.slow
def test_a_rocking_clamp_stops_the_run_and_says_what_it_does(
    controller: Controller, cell: Cell, limits: Limits, tmp_path: Path
) -> None:
    plan = clamping_plan(cell, limits, [(1, joint, CLAMPED) for joint in (2, 1, 2, 1)])
    asked, loose, begun = controller.asked(), [], []

    def progress(done: float, text: str) -> None:
        begun.append(text)
        if text.startswith("sweep 2") and not loose:
            loose.append(controller.operate("rock 0.1 0.1 0.1"))

    asked.progress = progress
    found = r"the clamp rocks.* in (sweep \d|sweeps \d to \d) .* by about 0\.\d+ mm "  # alone, or with others alike
    words = found + r".* will be made again; sweeps? 1"
    with pytest.raises(RunStopped, match=words):
        run(plan, tmp_path / "C", asked)
    assert not controller.operate("state")["clamped"]
    entries = whole_lines((work_folder(tmp_path / "C") / "journal.jsonl").read_bytes())[0]
    void = next(e for e in entries if e["what"] == "void")["sweeps"]
    assert not set(void) & set(tables_of(entries)["clamped"]["sweep"])
    assert 1 in set(tables_of(entries)["clamped"]["sweep"])
    controller.operate("release")
    assert run(plan, tmp_path / "C", controller.asked(resume=True)).rows == {"clamped": 256}
