"""Repeatability along one line: scatter and reversal that are known are found, from one side and from both."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cli_runner import Ran

from experiments.campaign import write_campaign
from experiments.line_repeatability import line_repeatability
from experiments.plans import cell_of
from experiments.runs.folder import header_of

SIGMA, REVERSAL = 5e-6, 4e-5


def distances(sides: tuple[int, ...], visits: int = 200, places: int = 5) -> pd.DataFrame:
    """A line measured many times; the far side comes short by the reversal."""
    rng, rows = np.random.default_rng(1), []
    for visit in range(visits):
        for place in range(places):
            side = sides[visit % len(sides)]
            value = 1.0 + 0.1 * place + REVERSAL / 2 * side + SIGMA * rng.standard_normal()
            row = {"pose": place + 1, "visit": visit + 1, "time_s": float(len(rows))}
            row |= {f"q{i}_rad": 0.1 * place / i for i in range(1, 7)}
            row |= {f"dir{i}": side if i == 1 else 1 for i in range(1, 7)}
            rows.append(row | {"target": "T1", "anchor": "instrument", "distance_m": value})
    return pd.DataFrame(rows)


def test_from_one_side_there_is_no_reversal() -> None:
    found = line_repeatability(distances((1,)))
    assert found is not None
    assert found.one_side == pytest.approx(4 * SIGMA, rel=0.1)
    assert (found.both_sides, found.reversal) == (None, None)
    assert (found.places, found.freedom) == (5, 5 * 199)


def test_from_both_sides_the_reversal_is_in_it() -> None:
    found = line_repeatability(distances((1, -1)))
    assert found is not None
    assert found.one_side == pytest.approx(4 * SIGMA, rel=0.1)
    assert found.reversal == pytest.approx(REVERSAL, rel=0.1)
    assert found.both_sides == pytest.approx(REVERSAL + 4 * SIGMA, rel=0.1)


def test_places_measured_once_say_nothing() -> None:
    assert line_repeatability(distances((1,), visits=1)) is None
    assert line_repeatability(distances((1, -1), visits=2)) is None


@pytest.mark.slow
def test_check_says_it_in_a_campaign_of_distances_only(tmp_path: Path, clampid: Callable[..., Ran]) -> None:
    header = header_of(cell_of("kuka_kr20_r1810")[0], tmp_path / "C")
    for sides, words in (((1,), "from one side"), ((1, -1), "from both; the sides differ by up to 4")):
        write_campaign(tmp_path / "C", header, {"distances": distances(sides, 20)}, "csv", overwrite=sides != (1,))
        shown = " ".join(clampid("check", tmp_path / "C", "--iso9283").out.split())
        assert "distances, one line repeatability" in shown
        assert words in shown
    told = clampid("check", tmp_path / "C", "--iso9283", "--json", "-").json
    assert told["along_a_line"]["both_sides"] == pytest.approx(REVERSAL + 4 * SIGMA, rel=0.4)
    assert told["iso9283"] == {}
