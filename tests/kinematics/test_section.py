"""One reader of what a file says: kinds, ranges with units, unknown keys, versions."""

from __future__ import annotations

import math
from typing import Any

import pytest

from kinematics.section import Section, migrated


def read(**content: Any) -> Section:
    return Section(content, "a.toml", "tool")


@pytest.mark.parametrize("value", [True, False, "1", None, [1.0], math.nan, math.inf, -math.inf, 10**400, 6.0, -0.1])
def test_what_is_no_number_of_its_range_is_refused(value: Any) -> None:
    with pytest.raises(ValueError, match=r"a\.toml, key tool\.x_m: expected a finite number of m from 0 to 5, found"):
        read(x_m=value).number("x_m", 0.0, 5.0, "m")


@pytest.mark.parametrize(
    ("unit", "value", "hint"),
    [("m", 120.0, "millimetres"), ("rad", 90.0, "degrees"), ("°C", 300.0, "kelvin"), ("kg", 12000.0, "grams")],
)
def test_the_unit_that_was_probably_meant_is_said(unit: str, value: float, hint: str) -> None:
    with pytest.raises(ValueError, match=rf"found .*\(is it in {hint}\?\)"):
        read(x=value).number("x", 0.0, 50.0, unit)
    with pytest.raises(ValueError, match=rf"found .*\(is it in {hint}\?\)"):
        read(x=[0.0, value, 0.0]).vector("x", 3, -50.0, 50.0, unit)
    with pytest.raises(ValueError, match=r"found -1\.0$"):
        read(x=-1.0).number("x", 0.0, 50.0, unit)


def test_a_vector_has_a_length() -> None:
    for value in ([0.0, 0.0, 1e308], [-1e200, 0.0, 0.0]):
        with pytest.raises(ValueError, match=r"expected 3 finite numbers, found"):
            read(x=value).vector("x")
    assert math.isfinite(float(read(x=[1e100] * 3).vector("x") @ read(x=[1e100] * 3).vector("x")))
    with pytest.raises(ValueError, match="read-only"):
        read(x=[0.0] * 3).vector("x")[0] = 1.0


def test_one_number_is_three_and_infinite_where_it_may_be() -> None:
    at = read(a=2e-3, b=[1e-3, math.inf, 2e-3], c=[1.0, 2.0], d=True, e=0.0, f=5.0)
    assert at.three("a", 1.0, "m").tolist() == [2e-3] * 3
    assert at.three("b", 1.0, "m", infinite=True).tolist() == [1e-3, math.inf, 2e-3]
    for key in "bcdef":
        with pytest.raises(ValueError, match="one number or three of m above 0 and not above 1, found"):
            at.three(key, 1.0, "m")
    with pytest.raises(ValueError, match="millimetres"):
        at.three("f", 1.0, "m")


def test_what_is_misspelt_is_refused_before_it_is_missed() -> None:
    at = read(delimeter=";", table="poses")
    with pytest.raises(ValueError, match="unknown key 'delimeter'; did you mean 'delimiter'"):
        at.only(("table", "delimiter"))
    at = read(table="poses")
    at.only(("table", "delimiter"))
    with pytest.raises(ValueError, match="unknown key 'table'"):  # known and not yet read
        at.done()


def test_an_unknown_key_is_refused_with_the_one_that_was_meant() -> None:
    at = read(mass_kg=1.0, com_n=[0, 0, 0])
    at.number("mass_kg")
    at.vector("com_m", default=None)
    with pytest.raises(ValueError, match="expected one of mass_kg, com_m, found the unknown key 'com_n'; did you mean"):
        at.done()
    with pytest.raises(ValueError, match=r"key tool\.com_m: expected 3 finite numbers, found no such key, but 'com_n'"):
        at.vector("com_m")


def test_lists_of_tables_are_numbered() -> None:
    first, second = read(part=[{"a": 1}, {"a": "x"}]).sections("part")
    assert first.integer("a") == 1
    with pytest.raises(ValueError, match=r"key tool\.part\[2\]\.a: expected an integer from 1, found 'x'"):
        second.integer("a")
    with pytest.raises(ValueError, match=r"expected tables \[\[part\]\], found"):
        read(part={"a": 1}).sections("part")


@pytest.mark.parametrize("value", ["a\nb", "\x1b[2J", "\u202e", "x" * 201, 3, None])
def test_a_text_is_printable_and_on_one_line(value: Any) -> None:
    with pytest.raises(ValueError, match="expected printable text"):
        read(name=value).text("name")


@pytest.mark.parametrize("raw", [{}, {"format": "a-cell"}, {"format": "a-cell/1"}])
def test_a_file_without_a_version_is_version_1_and_each_step_is_taken(raw: dict[str, Any]) -> None:
    steps = {1: lambda c: {**c, "steps": [1]}, 2: lambda c: {**c, "steps": [*c["steps"], 2]}}
    assert migrated(raw, "a-cell/3", steps) == {"format": "a-cell/3", "steps": [1, 2]}
    assert migrated({"format": "a-cell/3"}, "a-cell/3", steps) == {"format": "a-cell/3"}


@pytest.mark.parametrize(
    "found", ["a-cell/2", "a-cell/0", "a-cell/x", "a-cell/\u0661", "a-cell/", "b-cell/1", "", 1, []]
)
def test_another_kind_or_an_unknown_version_is_refused(found: Any) -> None:
    with pytest.raises(ValueError, match="key format: expected 'a-cell/1', found"):
        migrated({"format": found}, "a-cell/1", {})
    with pytest.raises(ValueError, match=r"found 'a-cell/2' \(of a newer clampid\)$"):
        migrated({"format": "a-cell/2"}, "a-cell/1", {})
    with pytest.raises(ValueError, match="found no such key"):
        migrated({}, "a-cell/1", {}, needed=True)
