"""Values whose standard error is large, but which are certainly not zero: shown, and marked as what they are."""

from __future__ import annotations

import math
from typing import Any

import pytest

from clampid.catalogue import catalogue
from clampid.display import odds_text
from clampid.report.budget import Share
from clampid.report.budget_section import _largest, _number_of
from clampid.report.evidence import MARKS, evidence, explained_marks
from clampid.report.placing import placing_tables
from clampid.slots import beyond_limit, excludes_zero

TILT = catalogue()["bearing_tilt"].by_name["c"]


@pytest.mark.parametrize(
    ("effect", "parameter", "value", "std", "shown"),
    [
        ("bearing_tilt", "c", 1.11e-4, 1.87e-5, True),  # the UR10's joint 4: six standard errors from zero
        ("bearing_tilt", "c", 5e-5, 1.87e-5, False),
        ("gravity", "my", 2.6e15, 2.0e15, False),
        ("geometry", "base_y", 0.082, 0.0021, False),  # not separable from the probe's mount
        ("joint_compliance", "c", 2.5e-4, 1e-5, False),
        ("bearing_tilt", "c", 1.11e-4, 0.0, False),
    ],
)
def test_an_amplitude_far_from_zero_is_no_chance_result(effect, parameter, value, std, shown) -> None:
    assert excludes_zero(catalogue()[effect].by_name[parameter], value, std) is shown


def test_a_value_above_its_physical_limit_is_found() -> None:
    assert beyond_limit(TILT, 1.1 * TILT.bounds[1])
    assert not beyond_limit(TILT, 0.9 * TILT.bounds[1])


def tilt(**more: Any) -> dict[str, Any]:
    c = {"name": "bearing_tilt.c@joint4", "value": 1.11e-4, "std": 1.87e-5, "unit": "rad/Nm", "identified": False}
    found = {"effect": "bearing_tilt", "name": "bearing_tilt", "where": ["joint4"], "alternative": False}
    return {**found, "p_value": 1e-7, "parameters": [{**c, **more}]}


def test_what_was_confirmed_is_not_called_not_identifiable() -> None:
    """A bearing tilt that was confirmed with p = 1e-7 had no value in the table of what was confirmed."""
    (table,) = evidence({"candidates": [tilt(excludes_zero=True, beyond_limit=True)]}, "m")
    assert "c = 111 ± 19 µrad/Nm (above its limit)" in table.rows[0]
    assert "larger than is physically plausible" in table.caption
    (table,) = evidence({"candidates": [tilt(excludes_zero=True, beyond_limit=False)]}, "m")
    assert "c = 111 ± 19 µrad/Nm (uncertain)" in table.rows[0]
    assert "the data exclude zero" in table.caption
    (table,) = evidence({"candidates": [tilt(excludes_zero=False, beyond_limit=False)]}, "m")
    assert "not identifiable" in table.rows[0]
    assert "“(" not in table.caption


def test_a_mark_is_explained_where_it_stands() -> None:
    assert explained_marks(["1 ± 2"]) == ""
    for mark, meaning in MARKS.items():
        assert meaning in explained_marks([f"1 ± 2 ({mark})"])


def test_many_numbers_have_a_table_of_their_own() -> None:
    """Gravity's 24 numbers stood in one cell."""
    numbers = [
        {"name": f"gravity.{p}@link{k}", "value": 0.1 * k, "std": 0.01, "unit": unit, "identified": k < 6}
        for p, unit in (("m", "kg"), ("mx", "kg m"))
        for k in range(1, 7)
    ]
    found = {"effect": "gravity", "name": "gravity", "where": [], "alternative": False, "parameters": numbers}
    what, values = evidence({"candidates": [found]}, "m")
    assert "12 numbers, in a table below" in what.rows[0]
    assert values.columns == ("At", "m, kg#", "mx, kg·m#")
    assert values.rows[1] == ("link2", "0.200 ± 0.010", "0.200 ± 0.010")
    assert values.rows[5] == ("link6", "not identifiable", "not identifiable")


@pytest.mark.parametrize(
    ("log_odds", "text"),
    [
        (91.0, "above 10³⁹ to 1"),
        (math.log(1e4) + 1e-9, "above 10⁴ to 1"),
        (math.log(8.2), "8.2 to 1"),
        (math.log(150.0), "150 to 1"),
    ],
)
def test_odds_are_said_in_powers_of_ten(log_odds: float, text: str) -> None:
    assert odds_text(log_odds) == text


def test_a_table_of_iso_9283_without_a_metric_is_left_out() -> None:
    none = {"position": {"not_determinable": {"AP": "no pose was visited twice"}}, "returns_wanted": 30}
    metric = {"poses": 5, "returns": (30, 30), "mean": 1e-4, "max": 2e-4, "interval95": None, "by_scatter": None}
    some = {"position": {"AP": metric, "not_determinable": {}}, "returns_wanted": 30}
    found = {"robot": none, "compensated": none, "compensated_rows": "all"}
    assert placing_tables({"poses": {"iso9283": found}}) == []
    (table,) = placing_tables({"poses": {"iso9283": {**found, "compensated": some}}})
    assert "compensated with this model" in table.caption


def test_only_numbered_places_have_a_ring_in_the_error_budget() -> None:
    """“robot” stood across a ring of 16 pixels."""
    assert [_number_of(p).isdigit() for p in ("joint10", "link2", "robot", "tool", "session1")] == [
        True,
        True,
        False,
        False,
        False,
    ]
    share = Share("shared_angle_curve", 1e-4, {"robot": 3.18e-4, "joint2": 1.7e-4})
    assert _largest(share) == "what all joints share 318 µm, joint2 170 µm"
