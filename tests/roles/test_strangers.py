"""A stranger's effects, each without an edit elsewhere: loaded, hidden in rows, and the first name of their scores.

The rows are those of the virtual robot, moved by what the effect itself does: this tests that nothing in the core
ignores a new effect, not that its physics is right.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clampid.catalogue import with_user_effects
from clampid.evidence.candidates import named_candidates
from clampid.evidence.score import score
from clampid.evidence.space import space_of
from clampid.fitting.fit import fit
from clampid.identification.carried import is_load
from clampid.identification.fitted_stage import active_slots
from clampid.identification.identify import stage_rows
from clampid.slots import Slot, Term
from clampid.stages.fit_problem import fit_problem
from clampid.stages.layout import layout_of
from clampid.standard_sets import STANDARD
from experiments.campaign import Campaign, read_campaign
from experiments.simulate import simulate

EFFECTS = with_user_effects(Path(__file__).parent / "strangers.py")
HIDDEN = {  # effect → parameter, place and amount of what is hidden, in sizes
    "warm_clearance": ("growth", "joint2", 5.0),
    "angle_stiffness": ("sine", "joint3", 0.3),
    "arm_load_friction": ("mu", "joint2", 4.0),
}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    folder = tmp_path_factory.mktemp("strangers") / "arm"
    simulate(folder, "kuka_kr20_r1810", [], seed=5, poses=80, tables=("poses", "free_air", "wrist"))
    return read_campaign(folder)


def first_names(campaign: Campaign, stage: str, name: str) -> set[str]:
    """The candidates of the largest evidence, where an effect was added to the rows of a stage."""
    rows = stage_rows([campaign], layout_of([campaign]), stage)
    slots = active_slots(rows, EFFECTS, [Term(n) for n in STANDARD[stage]])
    estimate = fit(fit_problem(rows, EFFECTS, slots))
    parameter, place, amount = HIDDEN[name]
    whole = fit_problem(rows, EFFECTS, (*slots, Slot(name, parameter, place)))
    theta, value = estimate.theta, amount * whole.parameters[-1].size
    whole = whole.with_flanks(np.r_[theta[: len(slots)], value])
    with_it = np.r_[theta[: len(slots)], value, theta[len(slots) :]]
    moved = estimate.residual - whole.residual(with_it)[0]
    told = fit(fit_problem(replace(rows, measured=rows.measured + moved), EFFECTS, slots))
    scored = score(space_of(told), named_candidates(told, EFFECTS))
    best = max(s.bic for s in scored if s.freedom)
    return {s.candidate.label for s in scored if s.freedom and s.bic > best - 1e-6 * abs(best)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "stage"),
    [("warm_clearance", "poses"), ("angle_stiffness", "poses"), ("arm_load_friction", "free_air")],
)
def test_effect_of_a_stranger_is_the_first_name(campaign: Campaign, name: str, stage: str) -> None:
    place = HIDDEN[name][1]
    alike = {f"load_dependent_friction@{place}"} if stage == "free_air" else set()  # the same equation there
    assert first_names(campaign, stage, name) == {f"{name}@{place}"} | alike


def test_friction_on_a_load_enters_the_poses_and_decides_flanks(campaign: Campaign) -> None:
    slots = (Slot("backlash", "gap", "joint2"), Slot("arm_load_friction", "mu", "joint2"))
    assert is_load(slots[1], EFFECTS)
    rows = stage_rows([campaign], layout_of([campaign]), "poses")
    chain = fit_problem(rows, EFFECTS, slots).chain
    without, with_it = (
        np.asarray(chain.pressing(np.array([1e-3, mu]), {**rows.signals, "flank": rows.signals["direction"]}))
        for mu in (0.0, 1.5)
    )
    # Friction larger than the load presses against the motion, wherever the load presses.
    side = rows.signals["direction"][:, 1]
    assert np.all(with_it[side != 0.0, 1] * side[side != 0.0] > 0.0)
    assert np.any(without[side != 0.0, 1] * side[side != 0.0] < 0.0)
