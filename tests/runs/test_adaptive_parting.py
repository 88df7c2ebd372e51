"""A run goes on with poses that separate look-alikes, fewer than random ones; the benchmark has more robots."""

from __future__ import annotations

from pathlib import Path

import pytest
import run_session
from adaptive_parting import trial
from run_adaptive import CASES, adaptive


@pytest.mark.parametrize(
    ("pair", "rest"),
    [
        pytest.param("wrist", True, marks=pytest.mark.study),
        pytest.param("arm", False, marks=pytest.mark.study),
    ],
)
def test_adaptive_poses_separate_a_pair_with_half_of_what_random_ones_need(pair: str, rest: bool) -> None:
    """Nobody tells the chooser the pair; robots of which the first poses leave no pair open say nothing.

    Only a rest separates growth with temperature from growth with time; compliance and bending need no rest.
    """
    rows = [trial(pair, seed) for seed in range(3)]
    open_ = [row for row in rows if "random" in row]
    assert len(open_) >= 2
    assert sum(row["adaptive"] for row in open_) <= 0.5 * sum(row["random"] for row in open_)
    assert any("as cold as at the start" in said for row in open_ for said in row["said"]) == rest


@pytest.mark.slow
def test_a_run_over_sockets_measures_more_and_says_what_became_of_the_pair(
    program: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_session, "PROGRAM", (program,))
    found = adaptive(tmp_path, CASES["arm"], 20)
    first, *later = found["adaptive"]["decided"]
    planned = found["plain"]["rows"]["poses"]
    assert planned < found["adaptive"]["rows"]["poses"] <= planned + 3 * 20
    assert "more, because" in first
    assert "evidence" in first
    assert "nothing more is measured" in later[-1].lower()
