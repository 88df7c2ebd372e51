"""What is in the folder is tested: every effect of the catalogue keeps what its declaration promises."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import numpy as np
import pytest

import clampid.effects
from clampid.catalogue import catalogue
from clampid.diagnosis.probes import JOINT_ANGLE_PERIODIC
from clampid.effect import UNITS, Effect, Stage
from clampid.fitting.prior_and_start import clamping_offsets
from clampid.slots import find_parameter, slots_of
from clampid.stages.fit_problem import FitProblem, fit_problem
from clampid.stages.rows import Rows
from clampid.stages.stage_kind import kind_of, kinds
from kinematics.sources import load_sources

EFFECTS = catalogue()
ACTING = [(name, stage) for name, effect in EFFECTS.items() for stage in effect.stages]
FILES = sorted(p for p in Path(clampid.effects.__path__[0]).glob("*.py") if p.name != "__init__.py")
ALLOWED = {
    "clampid.effect",
    "clampid.roles",
    "clampid.search_policy",
    "clampid.algebra",
    "typing",
    "__future__",
    "itertools",
}
VISIBLE: dict[Stage, tuple[str, ...]] = {
    **{kind.name: kind.outputs for kind in kinds()},
    "free_air": (*kind_of("free_air").outputs, "friction_state"),
    "poses": (*kind_of("poses").outputs, "joint_torque"),
}
"""Where a stage sees deviations; in poses torques at the joints are loads on springs; friction has a state."""
REVEALS: dict[Stage, tuple[str, ...]] = {
    "free_air": ("coulomb_friction",),
    "clamped": ("joint_compliance",),
    "poses": ("joint_compliance",),
}
"""Through what a stage shows what is no torque or angle of its own."""


@pytest.fixture(params=sorted(EFFECTS))
def effect(request: pytest.FixtureRequest) -> Effect:
    return EFFECTS[request.param]


def _trial(effect: Effect, rows: Rows) -> tuple[FitProblem, int]:
    """A problem of the effect, and of what it shows through; how many slots are the effect's."""
    own = slots_of(effect, rows.layout, rows.stage)
    if rows.stage == "free_air" and "friction_state" not in effect.acts:
        return fit_problem(rows, EFFECTS, own), len(own)
    others = [slots_of(EFFECTS[name], rows.layout) for name in REVEALS[rows.stage] if name != effect.name]
    return fit_problem(rows, EFFECTS, (*own, *(slot for slots in others for slot in slots))), len(own)


def _values(trial: FitProblem, near: float, seed: int) -> np.ndarray:
    """Parameters at random within ``near`` times their sizes; shapes, and what it shows through, at usual values."""
    rng = np.random.default_rng(seed)
    theta, (lower, upper) = trial.start(), trial.bounds()
    theta = theta + near * trial.sizes() * rng.uniform(-1.0, 1.0, len(theta)) * ~trial.shapes()
    for k, slot in enumerate(trial.slots):
        if slot.effect in REVEALS[trial.stage]:
            theta[k] = trial.parameters[k].size * rng.uniform(0.7, 1.3)
    theta = np.clip(theta, lower, upper)
    if trial.stage == "clamped":
        theta[len(trial.slots) :] = clamping_offsets(trial, theta)
    return theta


def test_the_catalogue_is_the_folder():
    twice = [
        f"second_{name}"
        for name, effect in EFFECTS.items()
        if effect.event is not None and effect.search.refines is None
    ]
    assert twice
    assert sorted(EFFECTS) == sorted([*(p.stem for p in FILES), *twice])


def test_declaration(effect: Effect):
    assert EFFECTS[effect.family].family == effect.family
    assert {p.unit for p in effect.parameters} <= UNITS
    assert effect.source
    assert set(effect.source) <= set(load_sources())
    assert effect.equation
    again = effect.event is not None and effect.search.refines is not None
    file = effect.search.refines if again else effect.name  # a second time needs no file of its own
    assert (sys.modules[f"clampid.effects.{file}"].__doc__ or "").strip()
    assert all(p.meaning for p in effect.parameters)
    assert len({p.name for p in effect.parameters}) == len(effect.parameters)
    assert any(not p.shape for p in effect.parameters)
    assert all(
        p.bounds[0] <= (p.grid[0] if p.shape else 0.0) <= p.bounds[1] or p.bounds[0] > 0 for p in effect.parameters
    )


def test_what_a_probe_reveals_names_a_probe_that_exists():
    assert {e.search.revealed_by for e in EFFECTS.values()} <= {None, JOINT_ANGLE_PERIODIC}


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_one_effect_a_file_that_imports_nothing_else(path: Path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    imported, assigned = set(), []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0
            imported.add(node.module)
        elif isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Assign):
            assigned += [t.id for t in node.targets if isinstance(t, ast.Name)]
    assert imported <= ALLOWED
    assert assigned.count("EFFECT") == 1
    assert "EFFECTS" not in assigned
    assert EFFECTS[path.stem].name == path.stem


@pytest.mark.parametrize(("name", "stage"), ACTING)
def test_acts_where_its_stations_are_seen(name: str, stage: Stage):
    assert any(station in VISIBLE[stage] for station in EFFECTS[name].acts)


@pytest.mark.parametrize(("name", "stage"), ACTING)
def test_vanishes_without_amplitude(name: str, stage: Stage, few_rows: dict[Stage, Rows]):
    rows, effect = few_rows[stage], EFFECTS[name]
    trial = fit_problem(rows, EFFECTS, slots_of(effect, rows.layout, stage))  # raises where a signal is not declared
    torque = np.random.default_rng(1).normal(0.0, 50.0, (len(rows), rows.robot.n))
    for level in range(max((len(p.grid) for p in effect.parameters), default=0) or 1):
        theta = trial.start()[: len(trial.slots)]
        for k, slot in enumerate(trial.slots):
            grid = find_parameter(slot, EFFECTS).grid
            theta[k] = grid[min(level, len(grid) - 1)] if grid else 0.0
        signals = {**rows.signals, "flank": rows.signals["motor_motion"]}
        values = trial.chain.evaluate(theta, signals, torque if stage == "clamped" else None).values
        np.testing.assert_array_equal(values, 0.0)


@pytest.mark.parametrize(("name", "stage"), ACTING)
def test_is_visible(name: str, stage: Stage, few_rows: dict[Stage, Rows]):
    trial, own = _trial(EFFECTS[name], few_rows[stage])
    _, jacobian = trial.residual(_values(trial, 0.0, seed=2))
    effect_of = [find_parameter(s, EFFECTS).shape for s in trial.slots[:own]]
    seen = np.linalg.norm(jacobian[:, :, :own] * trial.sizes()[:own], axis=(0, 1))
    assert np.any(seen[~np.array(effect_of)] > 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "stage"), ACTING)
def test_derivative_is_the_difference(name: str, stage: Stage, few_rows: dict[Stage, Rows]):
    trial, own = _trial(EFFECTS[name], few_rows[stage])
    theta = _values(trial, 0.5, seed=3)
    trial = trial.with_flanks(theta)  # a search holds the loads, too
    _, jacobian = trial.residual(theta)
    size = trial.sizes()
    lengths = np.abs(jacobian * size).max(axis=(0, 1))
    for k in range(own):
        slot = trial.slots[k]
        if stage == "poses" and trial.effects[slot.effect].by_name[slot.parameter].fixed == "everywhere":
            continue  # no derivative is asked for by what no fit changes
        fine = 1e-5 if trial.shapes()[k] else 1e-3  # shapes are not linear: a phase acts 48 times per turn
        share = 1e-6 if stage == "clamped" else fine
        step = share * size[k] * np.eye(len(theta))[k]
        up, down = trial.residual(theta + step)[0], trial.residual(theta - step)[0]
        slope = (down - up) / 2  # residual: measured less predicted
        rounding = 4 * np.finfo(float).eps * np.nanmax(np.abs(trial.rows.measured)) / share
        tolerance = 2e-5 * lengths[k] + 1e-9 * lengths[:own].max() + rounding
        np.testing.assert_allclose(slope / step[k] * size[k], jacobian[:, :, k] * size[k], rtol=1e-4, atol=tolerance)
