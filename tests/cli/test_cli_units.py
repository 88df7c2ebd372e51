"""Numbers with their units as they are printed, lists of effects as they are typed, and numbers that JSON lacks."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from cli_runner import Clampid

from clampid.display import error_text, quantity, readable, with_error
from clampid.effect import UNITS
from clampid.plain_json import finite
from clampid.verbs.errors import CallError
from clampid.verbs.inputs import split_effects, split_terms


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (1.234e-3, "m", "1.23 mm"),
        (1.234e-4, "m", "123 µm"),
        (1.7320508e-5, "m", "17.3 µm"),
        (0.0, "m", "0 µm"),
        (-2.5e-6, "m", "−2.50 µm"),
        (math.pi / 2, "rad", "90.0 deg"),
        (1e-4, "rad", "100 µrad"),
        (12.3456, "Nm", "12.3 Nm"),
        (float("nan"), "m", "not known"),
    ],
)
def test_numbers_for_people(value: float, unit: str, text: str) -> None:
    assert readable(value, unit) == text


def test_value_and_standard_error_share_unit_and_decimals() -> None:
    assert with_error(1.23456e-3, 4.2e-6, "m") == "1.2346 ± 0.0042 mm"
    assert with_error(2e-5, 3e-5, "rad") == "20 ± 30 µrad"
    assert quantity(5.0, 0.0, "kg") == ("5.000", "–", "kg")
    assert quantity(5.0, float("nan"), "kg") == ("5.000", "–", "kg")
    assert error_text(1.2345, "sigma") == "1.23 σ"
    assert error_text(None, "m") == "–"


@pytest.mark.parametrize("unit", sorted(UNITS))
def test_every_unit_of_an_effect_can_be_printed(unit: str) -> None:
    for value, std in ((0.0, 1e-12), (1e-9, 1e-10), (3.0, 1e5), (-1e4, 0.0)):
        assert all(isinstance(text, str) for text in quantity(value, std, unit))


def test_lists_of_effects() -> None:
    assert split_effects(None) is None
    assert split_effects([]) is None
    assert split_effects(["a,b@joint3"]) == ["a", "b@joint3"]
    assert split_effects(["poses=a, b", "free_air=c"]) == {"poses": ["a", "b"], "free_air": ["c"]}
    for wrong in (["a,"], ["poses="], ["a", "poses=b"], ["arm=a"]):
        with pytest.raises(CallError):
            split_effects(wrong)


def test_terms_to_add_keep_their_stage_until_another_is_named() -> None:
    assert split_terms("a@joint3") == ["a@joint3"]
    assert split_terms("a,b") == ["a", "b"]
    assert split_terms("poses=a,b@joint1,free_air=c") == ["poses=a", "poses=b@joint1", "free_air=c"]
    with pytest.raises(CallError):
        split_terms("a,,b")


def test_json_has_no_numbers_that_json_lacks() -> None:
    import numpy as np

    data = {"a": float("nan"), "b": (1, 2.5), "c": np.float64(3.0), "d": np.array([1.0, np.inf]), "e": True, "f": None}
    assert finite(data) == {"a": None, "b": [1, 2.5], "c": 3.0, "d": [1.0, None], "e": True, "f": None}


@pytest.mark.slow
def test_a_point_in_millimetres_is_the_same_point(poses_only: Path, tmp_path: Path, clampid: Clampid) -> None:
    model = tmp_path / "m.json"
    assert clampid("identify", poses_only, "-o", model, "--effects", "geometry", "-q").code == 0
    asked = ("compare", model, poses_only, "-q", "--json", "-")
    metres = clampid(*asked, "--sample", "1.2,0,0.4")
    millimetres = clampid(*asked, "--sample", "1200,0,400", "--mm")
    assert metres.code == millimetres.code == 0, millimetres.err
    assert metres.json == millimetres.json
    ran = clampid(*asked, "--mm")
    assert ran.code == 2
    assert "--mm is the unit of --sample" in ran.complaint
