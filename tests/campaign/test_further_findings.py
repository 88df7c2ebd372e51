"""Further columns of poses: `check` says which are variables, and why the others are not."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from clampid.stages.further_columns import further_signals
from clampid.verbs.check_screen import contents
from experiments.campaign import Campaign, read_campaign
from experiments.checks.check import Finding, check_campaign, holdings
from experiments.simulate import simulate


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    folder = tmp_path_factory.mktemp("further") / "arm"
    return read_campaign(simulate(folder, poses=20, seed=4, tables=("poses", "verification")))


def with_column(campaign: Campaign, name: str, values: object) -> Campaign:
    frame = campaign.tables["poses"].assign(**{name: values})
    return replace(campaign, tables=MappingProxyType({**campaign.tables, "poses": frame}))


def of_column(campaign: Campaign, name: str) -> list[Finding]:
    return [f for f in check_campaign(campaign) if f.column == name]


def varied(campaign: Campaign) -> np.ndarray:
    return np.linspace(30.0, 60.0, len(campaign.tables["poses"]))


def test_a_column_that_varies_is_a_variable(campaign: Campaign) -> None:
    wet = with_column(campaign, "humidity_percent", varied(campaign))
    assert of_column(wet, "humidity_percent") == []
    tables = holdings(wet)["tables"]
    assert tables["poses"]["variables"] == ["humidity_percent"]
    assert tables["verification"]["variables"] == []
    assert contents(tables["poses"]).endswith("; also humidity_percent")


def test_a_cell_without_a_number_is_said_and_has_the_mean_of_the_others(campaign: Campaign) -> None:
    values = varied(campaign)
    values[[4, 7]] = np.inf, np.nan
    wet = with_column(campaign, "humidity_percent", values)
    (found,) = of_column(wet, "humidity_percent")
    assert (found.severity, found.row) == ("note", 5)
    assert found.message == "2 rows have no finite number, first row 5; the mean of the others stands in"
    read = further_signals(wet.tables["poses"], {"poses": wet.tables["poses"]}, 6)["humidity_percent"]
    np.testing.assert_allclose(read[[4, 7]], np.delete(values, [4, 7]).mean())


def test_a_column_without_any_number_is_a_warning(campaign: Campaign) -> None:
    cells = ["2.5"] * len(campaign.tables["poses"])
    cells[3] = "warm"
    (text,) = of_column(with_column(campaign, "flow_m_s", cells), "flow_m_s")
    assert (text.severity, text.row) == ("warning", 4)
    assert text.message == "no effect can depend on flow_m_s: a number is expected, found 'warm'"
    for nothing in (np.inf, np.nan):
        (found,) = of_column(with_column(campaign, "flow_m_s", nothing), "flow_m_s")
        assert (found.severity, found.row) == ("warning", None)
        assert found.message == "no effect can depend on flow_m_s: no cell has a finite number"


def test_a_constant_and_a_name_without_a_unit_are_notes(campaign: Campaign) -> None:
    (constant,) = of_column(with_column(campaign, "force_N", 3.0), "force_N")
    assert (constant.severity, constant.message) == ("note", "no effect can depend on force_N: it is 3 in every row")
    (unitless,) = of_column(with_column(campaign, "humidity", varied(campaign)), "humidity")
    assert unitless.severity == "note"
    assert unitless.message.startswith("no effect can depend on humidity: a further column's name ends in its unit")


@pytest.mark.parametrize("name", ["remark", "std_x_m", "operator"])
def test_text_and_standard_deviations_are_left_alone(campaign: Campaign, name: str) -> None:
    values = varied(campaign) if name == "std_x_m" else ["cold start"] * len(campaign.tables["poses"])
    assert of_column(with_column(campaign, name, values), name) == []
