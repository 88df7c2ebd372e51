"""Correlations: those of the covariance, strongest first, of what is identified."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from clampid.catalogue import catalogue
from clampid.models.correlations import PAIRS_SHOWN, correlations
from clampid.models.model import Model, Session, StageModel
from clampid.report.parameters import parameters_section
from clampid.report.style import Table
from clampid.slots import Layout, Slot, Term
from clampid.verbs.output import Output
from clampid.verbs.show import model_json, show_model
from kinematics.description import load_robot


def stage_of(R: np.ndarray, std: np.ndarray, identified: tuple[bool, ...]) -> StageModel:
    slots = [Slot("geometry", axis, f"link{i + 1}") for i in range(6) for axis in ("x", "y", "z", "rx", "ry", "rz")]
    covariance = R * np.outer(std, std)
    return StageModel(
        "poses", (Term("geometry"),), tuple(slots[: len(std)]), np.zeros(len(std)), covariance, identified
    )


@pytest.fixture
def stage() -> StageModel:
    """Five parameters: 1 and 2, 2 and 4 strongly correlated; 3 with a weaker one; the last is not identified."""
    R = np.eye(5)
    for i, j, r in ((0, 1, 0.93), (1, 3, -0.97), (0, 2, 0.5), (2, 4, 0.99)):
        R[i, j] = R[j, i] = r
    return stage_of(R, np.array([1e-6, 3e-3, 1e-9, 2.0, 1e-4]), (True, True, True, True, False))


def model_of(stage: StageModel) -> Model:
    return Model("ur10", Layout(6), {"poses": stage}, (Session("made", "", np.eye(4), (), 0.0),))


def test_strongest_first_and_only_of_what_is_identified(stage: StageModel) -> None:
    found = correlations(stage)
    assert [(c.first.label, c.second.label) for c in found] == [
        ("geometry.y@link1", "geometry.rx@link1"), ("geometry.x@link1", "geometry.y@link1"),
    ]  # fmt: skip
    assert [c.r for c in found] == pytest.approx([-0.97, 0.93])
    assert len(correlations(stage, 0.4)) == 3
    assert correlations(replace(stage, identified=(True,) * 5))[0].r == pytest.approx(0.99)


def test_a_parameter_without_an_error_has_none(stage: StageModel) -> None:
    covariance = stage.covariance.copy()
    covariance[1], covariance[:, 1] = 0.0, 0.0
    assert correlations(replace(stage, covariance=covariance)) == ()


def test_programs_get_all_and_people_the_strongest(monkeypatch: pytest.MonkeyPatch) -> None:
    n = 8  # 28 pairs
    stage = stage_of(np.full((n, n), 0.95) + 0.05 * np.eye(n), np.full(n, 1e-5), (True,) * n)
    model = model_of(stage)
    told = model_json(model)["stages"]["poses"]["correlations"]
    assert len(told) == 28
    assert told[0] == {"parameters": ["geometry.x@link1", "geometry.y@link1"], "r": pytest.approx(0.95)}
    out = Output(quiet=True)
    text = io.StringIO()
    monkeypatch.setattr(out, "console", Console(file=text, width=120), raising=False)
    show_model(model, catalogue(), load_robot("ur10"), {}, out)
    assert "poses: correlations of identified parameters beyond ±0.9, the strongest 20 of 28:" in text.getvalue()
    assert text.getvalue().count("+0.9500") == PAIRS_SHOWN
    tables = [b for b in parameters_section(model, catalogue(), load_robot(model.robot)).blocks if isinstance(b, Table)]
    assert len(tables[-1].rows) == PAIRS_SHOWN
    assert "the strongest 20 of 28" in tables[-1].caption


def test_nothing_is_said_where_nothing_is_strong(stage: StageModel, capsys: pytest.CaptureFixture[str]) -> None:
    model = model_of(replace(stage, covariance=np.diag(np.diag(stage.covariance))))
    show_model(model, catalogue(), load_robot("ur10"), {}, Output(quiet=True))
    said = capsys.readouterr().out
    assert "poses: geometry, deviations from the description" in said
    assert "correlations" not in said
    assert model_json(model)["stages"]["poses"]["correlations"] == []
