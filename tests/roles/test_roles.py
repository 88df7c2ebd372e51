"""Parameters are asked for by what they are, so that a second law of the same thing counts without an edit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from clampid.catalogue import catalogue, with_user_effects
from clampid.diagnosis.separators import something_else
from clampid.effect import EffectError, Parameter
from clampid.identification.carried import is_load, is_start
from clampid.models.agreement import is_of_drives
from clampid.role_slots import has_role, numbers_of_role, role_of, slot_of, weight_slots
from clampid.roles import ROLES
from clampid.slots import Slot

SECOND_CLEARANCE = """
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search, Separator

def lag(p, x):
    return -0.5 * p.width * (1.0 + 0.01 * x.link_temperature) * x.flank

EFFECT = Effect(
    name="warm_clearance", family="{family}", acts={{"joint_angle": lag}},
    parameters=(Parameter("width", "rad", 1e-4, per="joint", role="clearance"),),
    needs=("flank", "link_temperature"), stages=("clamped", "poses"), equation="dq = -b (1 + a T) s / 2",
    source=("own measurements",),
    search=Search(separators=(Separator("{parts}", "the same poses cold and warm"),)),
)
"""


def load(folder: Path, family: str = "warm_clearance", parts: str = "backlash"):
    path = folder / "mine.py"
    path.write_text(SECOND_CLEARANCE.format(family=family, parts=parts), encoding="utf-8")
    return with_user_effects(path)


def test_second_law_of_clearance_is_a_clearance(tmp_path: Path) -> None:
    effects = load(tmp_path)
    slots = (
        Slot("joint_compliance", "c", "joint1"),
        Slot("warm_clearance", "width", "joint2"),
        slot_of("mass", "link3"),
    )
    assert numbers_of_role(slots, "clearance", effects=effects) == [1]
    assert is_start(slots[1], effects)
    assert not is_load(slots[1], effects)
    assert is_of_drives(effects["warm_clearance"])


def test_effect_says_in_its_own_file_what_separates_it(tmp_path: Path) -> None:
    said = something_else(("backlash", "warm_clearance"), load(tmp_path), "poses")
    assert said == "the same poses cold and warm"


def test_family_that_no_effect_leads_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EffectError, match="effect warm_clearance: family 'backlsh' does not exist; known: "):
        load(tmp_path, family="backlsh")


def test_role_or_axis_that_does_not_exist_is_refused() -> None:
    with pytest.raises(EffectError, match="role 'clearence' does not exist; known: "):
        Parameter("gap", "rad", 1e-4, role="clearence")  # type: ignore[arg-type]
    with pytest.raises(EffectError, match="first_moment has no axis 'rx'; known: x, y, z"):
        Parameter("m", "kg m", 1.0, role="first_moment", axis="rx")


def test_weights_of_links_and_tool_are_distinguished_by_their_places() -> None:
    assert [s.label for s in weight_slots("link2")] == [f"gravity.{m}@link2" for m in ("m", "mx", "my", "mz")]
    assert [s.label for s in weight_slots("tool")] == [f"payload.{m}@tool" for m in ("m", "mx", "my", "mz")]
    assert has_role(slot_of("mass", "link2"), "mass", per="link")
    assert not has_role(slot_of("mass", "tool"), "mass", per="link")


def test_place_without_such_a_parameter_is_refused() -> None:
    with pytest.raises(EffectError, match="no effect of the catalogue has a parameter clearance  at link2"):
        slot_of("clearance", "link2")


def test_unknown_effect_has_no_role() -> None:
    assert role_of(Slot("of_a_file_that_is_gone", "gap", "joint1")) == ""


def test_every_role_is_taken_by_a_parameter() -> None:
    taken = {p.role for e in catalogue().values() for p in e.parameters}
    assert taken == set(ROLES)


def test_renaming_an_effect_changes_no_role() -> None:
    effect = replace(catalogue()["backlash"], name="play", family="play")
    assert role_of(Slot("play", "gap", "joint1"), {"play": effect}) == "clearance"
