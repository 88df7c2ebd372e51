"""A log's chain is evaluated piece by piece: the same numbers, and hardly anything to compile for the next model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.chain.compiled import PIECE_ROWS, Blocks, compiler
from clampid.chain.piecewise import Piecewise
from clampid.identification.fitted_stage import active_slots
from clampid.identification.identify import layout_of, stage_rows
from clampid.slots import Term
from clampid.stages.fit_problem import FitProblem, fit_problem
from clampid.stages.rows import Rows
from experiments.campaign import Campaign

NAMES = ("gravity", "inertia", "coulomb_friction", "viscous_friction", "stribeck_friction", "torque_gain")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


@pytest.fixture(scope="module")
def rows(tiny: Campaign) -> Rows:
    found = stage_rows([tiny], layout_of([tiny]), "free_air", active=[catalogue()["inertia"]])
    return found.take(np.arange(PIECE_ROWS + 3))


def problem_of(rows: Rows, *labels: str) -> FitProblem:
    terms = [Term(name, place or None) for name, _, place in (label.partition("@") for label in labels)]
    return fit_problem(rows, catalogue(), active_slots(rows, catalogue(), terms))


def somewhere(problem: FitProblem) -> np.ndarray:
    return problem.start() + 0.1 * problem.sizes() * np.random.default_rng(1).standard_normal(len(problem.start()))


@pytest.mark.parametrize("which", ["whole", "bent", "derivatives from the ninth on"])
def test_pieces_give_the_numbers_of_the_whole(cache: Path, rows: Rows, which: str):
    problem = problem_of(rows, *NAMES)
    theta, chain = somewhere(problem)[: len(problem.slots)], problem.chain
    if which == "bent":
        theta, chain = theta[chain.bends], chain.bent
    elif which != "whole":
        chain = chain.derivatives_from(8)
    columns = chain._columns(rows.signals, None)
    assert isinstance(chain.function, Piecewise)
    found, expected = chain.function(theta, *columns), Blocks(chain.function.function)(theta, *columns)
    assert np.any(expected[1])
    for mine, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-12, atol=1e-13 * np.abs(theirs).max(initial=0.0))


@pytest.mark.skipif(compiler() is None, reason="no C compiler here")
def test_an_effect_of_one_motor_is_all_there_is_to_compile(cache: Path, rows: Rows):
    """And one law of six motors is compiled once."""
    libraries = []
    for labels in (NAMES, (*NAMES, "torque_offset@joint2"), (*NAMES, "torque_offset@joint2", "torque_offset@joint4")):
        problem = problem_of(rows, *labels)
        problem.residual(somewhere(problem))
        libraries.append(len(list(cache.rglob("*.so"))))
    first, *others = np.diff(libraries, prepend=0)
    assert first <= rows.robot.n + 2  # a piece for the weight of each joint, and of a kind of motors
    assert others == [1, 1]


def test_few_rows_are_not_compiled(cache: Path, rows: Rows):
    problem = problem_of(rows.take(np.arange(PIECE_ROWS - 1)), *NAMES)
    problem.residual(somewhere(problem))
    assert list(cache.rglob("*.so")) == []


@pytest.mark.parametrize("count", [50, PIECE_ROWS])
def test_a_constant_reads_no_signal(rows: Rows, count: int):
    problem = problem_of(rows.take(np.arange(count)), "coulomb_friction", "torque_offset@joint2")
    theta = somewhere(problem)
    last = len(problem.slots) - 1
    assert problem.slots[last].effect == "torque_offset"
    np.testing.assert_array_equal(problem.derivative(theta, last), problem.residual(theta)[1][:, :, [last]])
    assert problem.derivative(theta, last + 1).shape[2] == 0
