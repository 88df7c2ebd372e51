"""The file that ``effect_new`` writes: an effect like any other, at any place, of any variables, in every stage."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clampid.catalogue import catalogue, with_user_effects
from clampid.diagnosis.effect_new import effect_module, effect_new, effect_text
from clampid.effect import EffectError, Stage
from clampid.fitting.prior_and_start import clamping_offsets
from clampid.identification.identify import stage_rows
from clampid.slots import slots_of
from clampid.stages.fit_problem import FitProblem, fit_problem
from clampid.stages.layout import layout_of

VARIABLES: dict[Stage, tuple[str, ...]] = {
    "poses": ("q4", "dir4", "time", "temp_link2", "temp_motor3", "tau3", "motor5"),
    "free_air": ("q4", "time", "temp_link2", "temp_motor3", "tau3", "motor5", "qd2", "qdd2"),
    "clamped": ("q4", "dir4", "time", "temp_link2", "temp_motor3", "tau3", "motor5"),
}
PLACES: dict[Stage, tuple[str, ...]] = {
    "poses": ("joint4", "link2", "flange", "tool", "base", "instrument"),
    "free_air": ("joint4", "motor2"),
    "clamped": ("joint4", "motor2", "fixture"),
}
EVERY = [(stage, at) for stage, places in PLACES.items() for at in places]


@pytest.fixture(scope="module")
def few_rows(simulated):
    """A few rows of every stage."""
    campaign = simulated(seed=5, poses=12, tables=("free_air", "clamped", "poses"))
    layout = layout_of([campaign])
    free_air, clamped = stage_rows([campaign], layout, "free_air"), stage_rows([campaign], layout, "clamped")
    return {
        "free_air": free_air.take(np.arange(0, len(free_air), 60)),
        "clamped": clamped.take(clamped.fold == clamped.fold[0]),
        "poses": stage_rows([campaign], layout, "poses"),
    }


def trial_of(text: str, rows) -> tuple[FitProblem, int]:
    """The new effect, with the springs without which a clamped drive has no finite torque."""
    effect = effect_module(text).EFFECT
    effects = {**catalogue(), effect.name: effect}
    own = slots_of(effect, rows.layout, rows.stage)
    springs = slots_of(effects["joint_compliance"], rows.layout) if rows.stage == "clamped" else ()
    return fit_problem(rows, effects, (*own, *springs)), len(own)


def start_of(trial: FitProblem, own: int) -> np.ndarray:
    theta = trial.start()
    theta[own : len(trial.slots)] = trial.sizes()[own : len(trial.slots)]
    if trial.stage == "clamped":
        theta[len(trial.slots) :] = clamping_offsets(trial, theta)
    return theta


@pytest.mark.parametrize(("stage", "at"), EVERY)
def test_acts_where_it_says_and_vanishes_at_zero(stage: Stage, at: str, few_rows):
    for first, second in zip(VARIABLES[stage], (*VARIABLES[stage][1:], VARIABLES[stage][0]), strict=True):
        trial, own = trial_of(effect_text("mine", (first, second), at, stage=stage, orders=1), few_rows[stage])
        theta = start_of(trial, own)
        without = fit_problem(trial.rows, trial.effects, trial.slots[own:])
        zero, jacobian = trial.residual(theta)
        bare, _ = without.residual(np.r_[theta[own : len(trial.slots)], theta[len(trial.slots) :]])
        np.testing.assert_allclose(zero, bare, atol=1e-9)
        assert np.isfinite(jacobian).all()
        if second.startswith("temp") or (stage == "clamped" and at == "motor2"):
            continue  # without a sensor there is nothing to depend on; a held motor's torque is not used
        assert np.abs(jacobian[:, :, :own]).max() > 0, (first, second)


@pytest.mark.parametrize(("stage", "at"), EVERY)
def test_derivative_is_the_difference(stage: Stage, at: str, few_rows):
    trial, own = trial_of(effect_text("mine", ("q4", "time"), at, stage=stage, orders=1), few_rows[stage])
    theta = start_of(trial, own)
    theta[:own] += 0.1 * trial.sizes()[:own]
    _, jacobian = trial.residual(theta)
    for k in range(own):
        step = 1e-3 * trial.sizes()[k] * np.eye(len(theta))[k]
        up, down = trial.residual(theta + step)[0], trial.residual(theta - step)[0]
        difference = -(up - down) / (2e-3 * trial.sizes()[k])
        np.testing.assert_allclose(jacobian[:, :, k], difference, atol=2e-4 * np.abs(jacobian[:, :, k]).max() + 1e-9)


def test_a_shape_over_two_variables_is_their_full_product():
    names = [p.name for p in effect_module(effect_text("mine", ("q4", "dir4"), "joint5", orders=2)).EFFECT.parameters]
    of_q4 = {"q4", "sin_q4", "cos_q4", "sin_2q4", "cos_2q4"}
    assert set(names) == of_q4 | {"dir4"} | {f"{name}_dir4" for name in of_q4}
    assert len(names) == 11


@given(
    stage=st.sampled_from(sorted(PLACES)),
    data=st.data(),
    orders=st.integers(1, 4),
)
def test_every_file_is_tidy_and_can_be_read_back(stage: Stage, data, orders: int, tmp_path_factory):
    variables = data.draw(st.lists(st.sampled_from(VARIABLES[stage]), min_size=1, max_size=2, unique=True))
    at = data.draw(st.sampled_from(PLACES[stage]))
    text = effect_text("mine", variables, at, stage=stage, orders=orders)
    assert max(map(len, text.splitlines())) <= 120
    assert len(text.splitlines()) < 60
    file = tmp_path_factory.mktemp("own") / "mine.py"
    file.write_text(text)
    effect = with_user_effects(file)["mine"]
    assert effect.at == at
    assert effect.stages == (stage,)
    assert len({p.name for p in effect.parameters}) == len(effect.parameters)


def test_files_pass_the_linter(tmp_path: Path):
    pytest.importorskip("ruff")
    for stage, at in EVERY:
        effect_new(f"mine_{stage}_{at}", VARIABLES[stage][:2], at, stage=stage, path=tmp_path / f"{stage}_{at}.py")
    settings = Path(__file__).parents[2] / "pyproject.toml"
    for command in (["check"], ["format", "--check"]):
        done = subprocess.run(
            [sys.executable, "-m", "ruff", *command, "--config", settings, tmp_path],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("name", "variables", "at", "message"),
    [
        ("mine", ("elbow",), "joint1", "variable 'elbow' is not known in poses; known: q1, q2, …, "),
        ("mine", ("q",), "joint1", "variable 'q' is not known"),
        ("mine", ("q0",), "joint1", "variable 'q0' is not known"),
        ("mine", ("time3",), "joint1", "variable 'time3' is not known"),
        ("mine", ("qd3", "dir3"), "motor3", "variable 'dir3' is not known in free_air; known: .*qd1, qd2, …"),
        ("mine", ("q1", "q1"), "joint1", "'q1' is named twice"),
        ("mine", (), "joint1", "at least one variable"),
        ("mine", ("q1",), "elbow", "nothing acts at 'elbow' in poses; known: joint1, joint2, …, link1"),
        ("mine", ("q1",), "joint", "nothing acts at 'joint'"),
        ("mine", ("q1",), "base2", "nothing acts at 'base2'"),
        ("mine", ("z",), "base", "can sit at the instrument only, found 'base'"),
        ("2nd", ("q1",), "joint1", "a name of letters, digits and _"),
        ("class", ("q1",), "joint1", "a name of letters, digits and _"),
        ("backlash", ("q1",), "joint1", "the catalogue has an effect of that name"),
    ],
)
def test_what_cannot_be_is_refused(name, variables, at, message, tmp_path: Path):
    with pytest.raises(EffectError, match=message):
        effect_new(name, variables, at, path=tmp_path / "mine.py")
    assert not list(tmp_path.iterdir())


def test_a_file_is_never_overwritten(tmp_path: Path):
    path = effect_new("mine", ("q1",), "joint1", path=tmp_path / "mine.py")
    before = path.read_text()
    with pytest.raises(EffectError, match=r"mine\.py: expected a file that does not exist yet, found one"):
        effect_new("mine", ("q2",), "joint1", path=path)
    assert path.read_text() == before


def test_orders_and_stages_have_limits():
    with pytest.raises(EffectError, match="1 to 12, found 0"):
        effect_text("mine", ("q1",), "joint1", orders=0)
    with pytest.raises(EffectError, match="stage 'air' is not known; known: free_air, clamped, poses"):
        effect_text("mine", ("q1",), "joint1", stage="air")


@pytest.mark.parametrize(
    ("variable", "at"), [("q9", "joint1"), ("q1", "joint7"), ("temp_link8", "base"), ("dir7", "link1")]
)
def test_an_axis_that_the_robot_does_not_have_is_refused(variable: str, at: str, tmp_path: Path):
    with pytest.raises(EffectError, match="the robot has 6 axes; expected a number from 1 to 6"):
        effect_new("mine", (variable,), at, path=tmp_path / "mine.py")
    assert effect_new("mine", (variable,), at, joints=9, path=tmp_path / "mine.py").exists()


def test_a_joint_that_the_robot_does_not_have(few_rows):
    with pytest.raises(EffectError, match="does not fit a robot of 6 joints"):
        trial_of(effect_text("mine", ("q7",), "joint1"), few_rows["poses"])
    with pytest.raises(EffectError, match="does not fit a robot of 6 joints"):
        trial_of(effect_text("mine", ("q1",), "joint7"), few_rows["poses"])
