"""Rows that the parameters follow whatever was measured determine nothing: they are refused, in words."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from clampid.cli import run
from clampid.diagnosis.diagnose import diagnose
from clampid.diagnosis.few_rows import estimates_share, refuse_unjudged
from clampid.diagnosis.stage import FAR_OFF
from clampid.fitting.solve import FitError
from clampid.identification.fitted_stage import FittedStage
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.models.model import Model, save_model
from experiments.campaign import Campaign, read_campaign, write_campaign
from experiments.simulate import simulate


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    folder = tmp_path_factory.mktemp("few") / "arm"
    simulate(folder, "ur10", seed=3, poses=30, tables=("poses",))
    return read_campaign(folder)


@pytest.fixture(scope="module")
def model(arm: Campaign) -> Model:
    return identify(arm)


def fit_of(model: Model, arm: Campaign) -> FittedStage:
    opened = on_campaign(model, arm, None)
    return opened.refit("poses", opened.rows("poses"))


def with_rows(arm: Campaign, count: int, folder: Path) -> Path:
    return write_campaign(folder / f"few{count}", arm.header, {"poses": arm.tables["poses"].iloc[:count]}, "csv")


@pytest.mark.parametrize("count", [1, 2, 3])
def test_one_to_three_rows_identify_nothing(arm: Campaign, count: int, tmp_path: Path) -> None:
    with pytest.raises(FitError, match=rf"found {3 * count} and \d+: no degree of freedom"):
        identify(read_campaign(with_rows(arm, count, tmp_path)))


@pytest.mark.parametrize("verb", ["diagnose", "compare"])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_nor_are_they_diagnosed_or_fitted_again(
    arm: Campaign, model: Model, verb: str, count: int, tmp_path: Path, capsys
) -> None:
    save_model(model, tmp_path / "model.json")
    code = run([verb, str(tmp_path / "model.json"), str(with_rows(arm, count, tmp_path)), "-q"])
    said = capsys.readouterr().err
    assert "LinAlgError" not in said
    assert code in ((2,) if verb == "diagnose" else (0, 2)), said


@pytest.mark.parametrize("count", [6, 7, 8, 9])
def test_a_verdict_from_too_few_poses_is_none(
    arm: Campaign, model: Model, count: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Degrees of freedom are left, or nearly; yet "a structure that nothing explains" would be the missing rows."""
    save_model(model, tmp_path / "model.json")
    assert run(["diagnose", str(tmp_path / "model.json"), str(with_rows(arm, count, tmp_path)), "-q"]) == 2
    assert re.search(r"the geometry of 6 joints and \d targets? needs .* measure \d+ or more", capsys.readouterr().err)


@pytest.mark.parametrize("count", [6, 8, 9])
def test_no_verdict_is_given_on_a_robot_without_fault_from_too_few_rows(
    arm: Campaign, model: Model, count: int, tmp_path: Path
) -> None:
    """They said *unknown*: the error of too few poses on left-out poses was taken for a missing effect."""
    rows = arm.tables["poses"].sample(count, random_state=0).sort_index()
    few = read_campaign(write_campaign(tmp_path / "few", arm.header, {"poses": rows}, "csv"))
    with pytest.raises(FitError, match=r"degrees? of freedom"):
        diagnose(model, few)


def test_few_rows_of_a_robot_without_fault_are_no_unknown_effect(arm: Campaign, model: Model, tmp_path: Path) -> None:
    """The error of the estimates themselves is no structure, and the summary says how much of it there is."""
    rows = arm.tables["poses"].sample(18, random_state=0).sort_index()
    few = read_campaign(write_campaign(tmp_path / "few", arm.header, {"poses": rows}, "csv"))
    found = diagnose(model, few).stages["poses"]
    assert found.after > FAR_OFF * found.noise_floor
    assert found.verdict == "adequate"
    assert found.floor_excess is not None
    assert "the poses are few" in found.summary


def test_a_large_error_of_few_rows_is_still_said(arm: Campaign, model: Model, tmp_path: Path) -> None:
    """Many times what the estimates' own error could be."""
    rows = arm.tables["poses"].sample(24, random_state=0).sort_index()
    wrong = np.random.default_rng(0).normal(scale=3e-3, size=(len(rows), 3))
    rows[["x_m", "y_m", "z_m"]] += wrong
    few = read_campaign(write_campaign(tmp_path / "few", arm.header, {"poses": rows}, "csv"))
    assert diagnose(model, few).stages["poses"].verdict == "unknown"


def test_many_rows_are_judged_as_ever(model: Model, arm: Campaign) -> None:
    fitted = fit_of(model, arm)
    assert estimates_share(fitted.estimate, verified=False) == 1.0
    refuse_unjudged(fitted, verified=False)
