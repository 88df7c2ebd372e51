"""The demo finds what it hides, and says what was hidden only afterwards."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cli_runner import Clampid

from clampid.catalogue import catalogue
from clampid.identification.identify import standard_effects
from clampid.loop.demo import DRAWN, terms_to_add
from experiments.campaign import read_campaign
from experiments.virtual_robot import HIDEABLE


def test_what_is_drawn_can_be_hidden_and_found_and_is_not_in_the_standard_model(whole: Path) -> None:
    standard = {t.effect for terms in standard_effects([read_campaign(whole)]).values() for t in terms}
    assert set(DRAWN) <= set(HIDEABLE) & set(catalogue())
    assert not set(DRAWN) & standard


def test_confirmed_candidates_and_alternatives_are_kept_apart() -> None:
    def candidate(effect: str, *where: str, alternative: bool = False) -> dict[str, object]:
        return {"effect": effect, "where": list(where), "alternative": alternative, "group": 1}

    diagnosis = {
        "stages": {
            "free_air": {"candidates": []},
            "poses": {
                "candidates": [
                    candidate("a", "joint1", "joint2"),
                    candidate("b", "base", alternative=True),
                    candidate("c", "base", alternative=True),
                ]
            },
        }
    }
    confirmed, alternatives = terms_to_add(diagnosis)
    assert confirmed == {"poses": ["poses=a@joint1", "poses=a@joint2"]}
    assert alternatives == {("poses", 1): [["poses=b@base"], ["poses=c@base"]]}


@pytest.mark.parametrize("seed", [pytest.param(1, marks=pytest.mark.slow), pytest.param(7, marks=pytest.mark.study)])
def test_the_demo_finds_what_was_hidden_and_tells_it_last(seed: int, clampid: Clampid, tmp_path: Path) -> None:
    ran = clampid("demo", "--seed", str(seed), "--out", tmp_path / "demo", "--json", tmp_path / "demo.json")
    assert ran.code == 0, ran.err
    result = json.loads((tmp_path / "demo.json").read_text())
    assert result["named"]
    told = ran.out.index("- What was hidden:")
    assert told > ran.out.index("Error (rms) on held-out rows")
    assert len(ran.out.splitlines()) <= 24
    assert "<html" in (tmp_path / "demo" / "report.html").read_text(encoding="utf-8")[:2000]
    fell = [
        result["after"]["tables"][t]["heldout"]["rms"] < result["before"]["tables"][t]["heldout"]["rms"]
        for t in result["after"]["tables"]
    ]
    assert any(fell)
