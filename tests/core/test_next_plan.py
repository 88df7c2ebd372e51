"""What to measure next, carried out on the virtual robot: look-alikes part and weak ones show as the design said."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.diagnosis.held_out import held_out_of
from clampid.diagnosis.linear_refit import linear_refit
from clampid.diagnosis.next_measurement import ENOUGH, SAME, NextPlan
from clampid.diagnosis.next_plan import parting_plan, showing_plan
from clampid.diagnosis.parting import part, show
from clampid.diagnosis.propose import Weak
from clampid.diagnosis.refit_signals import Rivals
from clampid.diagnosis.residual_excess import OneSided, excess_over_floor, one_sided, one_sided_words
from clampid.diagnosis.separators import something_else
from clampid.evidence.candidates import named_candidates
from clampid.evidence.score import Scored, explained_together, score
from clampid.evidence.space import Space, space_of
from clampid.fitting.accuracy import noise_floor
from clampid.fitting.solve import Estimate
from clampid.identification.fitted_stage import fit_stage
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.loop.add import add
from clampid.planning.clamping import planned_sweep, postures_for
from clampid.planning.press import Press, press_limits, stiffness_of
from clampid.planning.scene import Scene
from clampid.stages.fit_problem import parameter_of
from experiments.campaign import Campaign, read_campaign
from experiments.plans.cell import cell_of
from experiments.plans.limits import course_of, limits_of
from experiments.plans.model import Plan, Run
from experiments.plans.press import rated_motor_torque
from experiments.plans.read import read_plan
from experiments.plans.virtual import run_virtually
from experiments.plans.write import write_plan

ROBOT = "kuka_kr20_r1810"
POSES = {"poses": ("geometry", "joint_compliance", "backlash", "wrist_coupling_friction")}  # what this one has
FOUND = 27.5  # the noncentrality of two parameters that is found with 90 % power in a dictionary of usual size


def _seen(campaigns: Sequence[Campaign], stage: str, *labels: str) -> tuple[Estimate, Space, list[Scored]]:
    """The fit of some campaigns as sessions of one robot, and candidates' scores on what it leaves."""
    model = identify(list(campaigns), POSES if stage == "poses" else None)
    estimate = on_campaign(model, list(campaigns) if len(campaigns) > 1 else campaigns[0]).refit(stage).estimate
    space = space_of(estimate)
    effects = {name: catalogue()[name] for name in (label.partition("@")[0] for label in labels)}
    by_label = {s.candidate.label: s for s in reversed(score(space, named_candidates(estimate, effects)))}
    return estimate, space, [by_label[label] for label in labels]


def _carried_out(found: NextPlan, folder: Path, hidden: Sequence[str], seed: int) -> Campaign:
    """The plan written, read again and run on the same individual."""
    assert found.plan is not None
    plan = read_plan(write_plan(found.plan, folder / "next.toml"))
    return read_campaign(run_virtually(plan, folder / "next", hidden, seed=seed))


def _weak(estimate: Estimate, s: Scored, share: float | None = None) -> list[Weak]:
    """To be found at their usual size, or at a share of what is found now."""
    out = []
    for k, slot in enumerate(s.candidate.slots):
        parameter = parameter_of(slot, catalogue(), estimate.problem.rows.robot)
        now = float(s.unit_limit[k]) * FOUND**0.5
        out.append(Weak(s, k, FOUND, parameter, parameter.size if share is None else share * now))
    return out


def test_chosen_measurements_show_a_signal_that_the_model_cannot_absorb():
    rng = np.random.default_rng(0)
    J, pool_J = rng.standard_normal((60, 3)), rng.standard_normal((30, 4, 3))
    y, pool_y = (X @ np.array([1.0, -2.0, 0.5]) for X in (J, pool_J))  # the model follows it
    pool_y[5::10] += rng.standard_normal((3, 4))  # but not there
    hidden = pool_J @ np.ones(3)
    found = show(J, [y, J @ np.ones(3)], pool_J, [pool_y, hidden], [1e9, 1.0], batch=1, most=3)
    assert found.chosen == ()  # neither can be reached, and nothing is taken for it
    assert found.most[1] == pytest.approx(0.0, abs=1e-6)
    found = show(J, [y], pool_J, [pool_y], [found.most[0] * 0.99], batch=1, most=3)
    assert set(found.chosen) == {5, 15, 25}
    X, z = np.vstack([J, *pool_J[list(found.chosen)]]), np.concatenate([y, *pool_y[list(found.chosen)]])
    left = float(np.sum((z - X @ np.linalg.lstsq(X, z, rcond=None)[0]) ** 2))
    assert found.after[0] == pytest.approx(left, rel=1e-6)


def test_inseparable_pairs_do_not_prevent_a_plan_for_others():
    rng = np.random.default_rng(1)
    J, a = rng.standard_normal((80, 3)), rng.standard_normal((80, 1))
    pool_J, pool_a = rng.standard_normal((40, 3, 3)), rng.standard_normal((40, 3, 1))
    pool_c = rng.standard_normal((40, 3, 1))
    rivals = Rivals(J, [a, a, a], [np.ones(1)] * 3, np.eye(3))
    found = part(rivals, pool_J, [pool_a, pool_a, pool_c], enough=30.0, batch=1, most=40)
    assert [pair[:2] for pair in found.never] == [(0, 1)]
    assert found.never[0][2] == pytest.approx(1.0, abs=1e-6)
    assert found.before == pytest.approx(0.0, abs=1e-6)
    assert found.after >= 30.0


def _narrow_log(folder: Path, hidden: Sequence[str], seed: int) -> Campaign:
    """A log in which every joint goes over a quarter of its range."""
    cell, _ = cell_of(ROBOT)
    limits, _ = limits_of(cell.robot, acceleration=5.0)
    half = 0.25 * (limits.upper - limits.lower) / 2
    middle = np.array([0.0, -1.2, 1.6, 0.3, 0.8, 0.2])
    knots = np.clip(middle + half * np.random.default_rng(0).uniform(-1, 1, (14, 6)), limits.lower, limits.upper)
    runs = tuple(Run(course_of(cell.robot, limits, knots, speed_share=s), s) for s in (0.15, 0.05))
    plan = Plan("free_air", cell, limits, sum(run.course.length for run in runs), runs=runs)
    return read_campaign(run_virtually(plan, folder, hidden, seed=seed))


def _left_beside(campaigns: list[Campaign], there: str, asked: str) -> float:
    """What a candidate explains of the logs' residual once another is in the fit."""
    estimate = on_campaign(add(identify(campaigns), campaigns, [there])[0], campaigns).refit("free_air").estimate
    effects = {name: catalogue()[name] for name in (asked.partition("@")[0],)}
    scored = score(space_of(estimate), named_candidates(estimate, effects))
    return next(s for s in scored if s.candidate.label == asked).explained


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.study) for s in (1, 2))])
def test_runs_part_a_dress_pack_from_a_balancer(tmp_path: Path, seed: int):
    hidden, labels = ("dress_pack@joint4",), ("dress_pack@joint4", "gravity_compensator@joint4")
    campaign = _narrow_log(tmp_path / "narrow", hidden, seed=3)
    estimate, space, (true, other) = _seen([campaign], "free_air", *labels)
    assert explained_together(space, true, other) - other.explained < SAME  # these rows cannot tell
    found = parting_plan(campaign, estimate, [true, other], space.scale, seed=seed)
    assert found is not None
    assert found.helps
    assert found.before < SAME < ENOUGH <= found.after
    assert found.shared[1] < found.shared[0]
    more = _carried_out(found, tmp_path, hidden, seed=3)
    # In the fit of both logs, not in scores beside a fit without either: what is missing there shapes the noise.
    both = [campaign, more]
    assert _left_beside(both, "gravity_compensator@joint4", "dress_pack@joint4") > SAME
    assert _left_beside(both, "dress_pack@joint4", "gravity_compensator@joint4") < SAME


def test_poses_show_a_gear_that_few_poses_do_not(simulated: Callable[..., Campaign], tmp_path: Path):
    campaign = simulated(seed=7, poses=60, tables=("poses",))
    estimate, space, (s,) = _seen([campaign], "poses", "gear_eccentricity@joint5")
    found = showing_plan(campaign, estimate, _weak(estimate, s), space.scale, seed=0)
    assert found is not None
    assert found.plan is not None
    before = s.unit_limit * FOUND**0.5
    assert [g.before for g in found.gains] == pytest.approx(before, rel=1e-3)
    more = _carried_out(found, tmp_path, (), seed=7)
    _, _, (s,) = _seen([campaign, more], "poses", "gear_eccentricity@joint5")
    after = s.unit_limit * FOUND**0.5
    wanted = [g.before > g.aim for g in found.gains]  # the others are found already, and the plan is not for them
    assert sum(wanted) >= 2
    assert np.all((after < before)[wanted])
    assert [g.after for g in found.gains] == pytest.approx(after, rel=0.3)


def _gentle_sweeps(folder: Path, seed: int) -> Campaign:
    """Sweeps of joints 2, 3 and 5 to a tenth of what they may bear, in one posture."""
    cell, _ = cell_of(ROBOT)
    free, _ = limits_of(cell.robot)
    rated = rated_motor_torque(cell.robot)
    stiffness, _ = stiffness_of(cell.robot, rated)
    limits = press_limits(free, rated)
    press = Press(np.full(6, 0.08), rated, stiffness)
    blank = Plan("clamping", cell, limits, 0.0, stiffness=1.3 * stiffness)
    posture = postures_for(cell, limits, Scene.floor_only(cell), 0)[0]
    sweeps = tuple(planned_sweep(blank, press, posture, joint, 10) for joint in (1, 2, 4))
    return read_campaign(run_virtually(replace(blank, sweeps=sweeps, duration=600.0), folder, seed=seed))


@pytest.mark.slow
def test_sweeps_show_a_spring_that_hardens(tmp_path: Path):
    campaign = _gentle_sweeps(tmp_path / "gentle", seed=4)
    estimate, space, (s,) = _seen([campaign], "clamped", "nonlinear_stiffness@joint2")
    found = showing_plan(campaign, estimate, _weak(estimate, s, 0.25), space.scale, seed=0)
    assert found is not None
    assert found.plan is not None
    before = float(s.unit_limit[0]) * FOUND**0.5
    assert found.gains[0].before == pytest.approx(before, rel=1e-3)
    more = _carried_out(found, tmp_path, (), seed=4)
    _, _, (s,) = _seen([campaign, more], "clamped", "nonlinear_stiffness@joint2")
    after = float(s.unit_limit[0]) * FOUND**0.5
    assert after < before
    assert found.gains[0].after == pytest.approx(after, rel=0.5)


def test_separating_measurement_follows_from_stations_of_the_effects():
    effects = catalogue()
    assert "base plate" in something_else(("base_tilt", "bearing_tilt"), effects, "poses")
    assert "base plate" in something_else(("base_creep", "warm_up_expansion"), effects, "poses")
    assert "clamped flange" in something_else(("backlash", "gear_eccentricity"), effects, "poses")
    assert "free air" in something_else(("dress_pack", "joint_angle_curve"), effects, "poses")
    alike = something_else(("dress_pack", "gravity_compensator"), effects, "free_air")
    assert "either may be added" in alike


def test_predicted_held_out_error_of_an_alternative_equals_its_fit(simulated: Callable[..., Campaign]):
    campaign = simulated(seed=7, poses=60, tables=("poses",))
    opened = on_campaign(identify(campaign), campaign)
    fitted = opened.refit("poses")
    estimate, rows = fitted.estimate, opened.rows("poses")
    floor = noise_floor(estimate.problem.rows, estimate.residual)
    effects = {"wrist_coupling_friction": catalogue()["wrist_coupling_friction"]}
    scored = score(space_of(estimate), named_candidates(estimate, effects))
    s = next(s for s in scored if s.candidate.places == ("joint5",))
    along = linear_refit(estimate, s)
    assert along is not None
    terms, values = [*fitted.model.terms, *s.candidate.terms], fitted.model.values()
    model = opened.stages["poses"]
    whole = fit_stage(rows, opened.effects, terms, model.carried_prior or {}, values, opened.held_out("poses"))
    before, said, found = (held_out_of(e, None, floor, 0).rms for e in (estimate, along, whole.estimate))
    assert found < 0.8 * before
    assert said == pytest.approx(found, rel=0.05)


def test_an_error_above_its_floor_is_said_with_figures():
    assert excess_over_floor(1.2e-4, 1e-4, "instrument", 0, []) is None
    found = excess_over_floor(2e-4, 1e-4, "instrument", 3, [])
    assert found is not None
    assert found["times_floor"] == pytest.approx(2.0)
    assert found["share_of_square"] == pytest.approx(0.75)
    assert any("3 rows" in reason for reason in found["reasons"])


def test_joints_that_come_from_one_side_only_are_named(simulated: Callable[..., Campaign]):
    campaign = simulated(seed=7, poses=60, tables=("poses",))
    rows = on_campaign(identify(campaign), campaign).rows("poses")
    assert one_sided(rows) == []
    kept = rows.take(rows.signals["direction"][:, 2] > 0)
    assert one_sided(kept) == [OneSided(3, 1, 0)]
    said = one_sided_words(one_sided(kept), kept, catalogue())
    assert "joint 3 (+)" in said
    assert "backlash" in said
    unknown = replace(rows, signals={**rows.signals, "direction": np.zeros_like(rows.signals["direction"])})
    said = one_sided_words(one_sided(unknown), unknown, catalogue())
    assert said.count("not recorded") == 1
    assert "at joints 1, 2, 3, 4, 5, 6, whose directions were not recorded: record the direction of approach" in said
