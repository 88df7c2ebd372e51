"""Numbers that a change of names and places leaves alone: fits and first verdicts of fixed campaigns.

``python tests/core/fixed_fits.py`` writes the kept numbers anew, where they are meant to change.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from fixed_fits import FITS, KEPT, REAL, VERDICTS, fitted, verdict

WITHIN = 0.1  # of its standard error: what a parameter may move by
STD_WITHIN = 0.05  # of itself: what a standard error may change by
Table = dict[str, dict[str, list[float]]]


@pytest.fixture(scope="module")
def kept() -> dict[str, Any]:
    """The numbers kept in ``fixed_fits.json``."""
    found: dict[str, Any] = json.loads(KEPT.read_text(encoding="utf-8"))
    return found


def moved(now: Table, before: Table) -> dict[str, str]:
    """Slots that are gone, new, or have moved by more than they may."""
    out: dict[str, str] = {}
    for stage in {**now, **before}:
        old, new = before.get(stage, {}), now.get(stage, {})
        for slot in {**old, **new}:
            if slot not in old or slot not in new:
                out[f"{stage} {slot}"] = "only before" if slot in old else "only now"
                continue
            (value, std), (was, std_was) = new[slot], old[slot]
            if abs(value - was) > WITHIN * std_was or abs(std - std_was) > STD_WITHIN * std_was:
                out[f"{stage} {slot}"] = f"{was:.4g} ± {std_was:.2g} before, {value:.4g} ± {std:.2g} now"
    return out


@pytest.mark.slow
@pytest.mark.parametrize("case", FITS)
def test_fits_of_fixed_campaigns_stay(case: str, kept: dict[str, Any]) -> None:
    assert not moved(fitted(case), kept["fits"][case])


@pytest.mark.slow
@pytest.mark.parametrize("case", REAL)
def test_fits_of_real_campaigns_stay(case: str, kept: dict[str, Any], shared_folder: Path) -> None:
    assert not moved(fitted(case, shared_folder), kept["real"][case])


@pytest.mark.slow
@pytest.mark.parametrize("case", VERDICTS)
def test_first_verdicts_of_fixed_campaigns_stay(case: str, kept: dict[str, Any]) -> None:
    assert verdict(case) == kept["verdicts"][case]


def test_moved_parameter_is_seen(kept: dict[str, Any]) -> None:
    before: Table = kept["fits"]["poses alone"]
    slot, (value, std) = next(iter(before["poses"].items()))
    assert not moved(before, before)
    assert len(moved({"poses": {**before["poses"], slot: [value + 0.2 * std, std]}}, before)) == 1
    assert len(moved({"poses": {**before["poses"], slot: [value, 1.1 * std]}}, before)) == 1
    assert len(moved({"poses": {k: v for k, v in before["poses"].items() if k != slot}}, before)) == 1
