"""Rows that the parameters follow whatever was measured determine nothing: they are refused, in words."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from clampid.cli import run
from clampid.fitting.solve import FitError
from clampid.identification.identify import identify
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
