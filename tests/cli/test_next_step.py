"""The command to copy after a diagnosis, and the names of rejected points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from clampid.identification.identify import identify
from clampid.verbs.next_step import next_steps
from clampid.verbs.rejected import rejected_words
from experiments.campaign import read_campaign
from experiments.simulate import simulate


def candidate(effect: str, *where: str, alternative: bool = False) -> dict[str, Any]:
    return {"effect": effect, "where": list(where), "alternative": alternative, "group": 0}


def told(*candidates: dict[str, Any]) -> dict[str, Any]:
    return {"stages": {"free_air": {"candidates": []}, "poses": {"candidates": list(candidates)}}}


def test_what_is_confirmed_is_added_and_looked_at_again(tmp_path: Path) -> None:
    model = tmp_path / "my model.json"
    (tmp_path / "mended.json").touch()
    found = told(candidate("backlash", "joint1", "joint2"), candidate("base_tilt", "base", alternative=True))
    add, again = next_steps(found, model, [Path("arm")])
    assert add.command == (
        f"clampid add poses=backlash@joint1,backlash@joint2 '{model}' arm -o {tmp_path}/mended2.json"
    )
    assert again.command == f"clampid diagnose {tmp_path}/mended2.json arm"


def test_a_variant_is_added_by_its_own_name_and_not_its_familys() -> None:
    found = told({**candidate("gear_eccentricity", "joint2"), "name": "motor_eccentricity"})
    add, _ = next_steps(found, Path("m.json"), [Path("arm")])
    assert add.command == "clampid add poses=motor_eccentricity@joint2 m.json arm -o mended.json"


def test_an_effect_without_a_place_is_added_by_its_name_alone() -> None:
    add, _ = next_steps(told(candidate("backlash", "joint1"), candidate("gravity")), Path("m.json"), [Path("arm")])
    assert add.command == "clampid add poses=backlash@joint1,poses=gravity m.json arm -o mended.json"
    assert add.purpose == "Next, add them:"


def test_a_single_alternative_is_not_one_of_several() -> None:
    (step,) = next_steps(told(candidate("backlash", "joint1", alternative=True)), Path("m.json"), [Path("arm")])
    assert step.purpose == "Next, add it:"


def test_of_what_cannot_be_separated_any_one() -> None:
    found = told(
        *(candidate(name, "joint2", alternative=True) for name in ("gear_eccentricity", "gravity_compensator"))
    )
    lines = next_steps(found, Path("m.json"), [Path("a"), Path("b")], Path("f.py"))
    assert [step.command for step in lines] == [
        "clampid add poses=gear_eccentricity@joint2 m.json a b -o mended.json --effects-from f.py",
        "clampid add poses=gravity_compensator@joint2 m.json a b -o mended.json --effects-from f.py",
    ]
    assert next_steps(told(), Path("m.json"), [Path("a")]) == []


def test_rejected_points_are_named_by_pose_and_visit_with_how_far_they_are_off(tmp_path: Path) -> None:
    folder = simulate(tmp_path / "arm", "ur10", seed=2, poses=40, tables=("poses",), file_format="csv")
    table = pd.read_csv(folder / "poses.csv")
    spoilt = table.index[(table["pose"] == 17) & (table["visit"] == 1) & (table["target"] == "T2")]
    table.loc[spoilt, "y_m"] += 0.02
    table.to_csv(folder / "poses.csv", index=False)
    campaign = read_campaign(folder)
    said = rejected_words(identify(campaign, ["geometry", "joint_compliance"]), [campaign])["poses"]
    first = said.partition(": ")[2].partition(";")[0]
    assert first.startswith("pose 17 visit 1 (T2) off by ")
    assert float(first.split()[-2]) == pytest.approx(20, abs=1)
    assert first.endswith(" mm")
