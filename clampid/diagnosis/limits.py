"""Detection limits effect by effect, and the effects that these rows cannot test, in columns for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clampid.display import label_text, places_text, span

__all__ = ["limit_rows", "not_testable"]

Json = Mapping[str, Any]
WHY = {
    "absent": "has no influence on these rows",
    "absorbed": "absorbed by the model",
    "weak": "nearly all of it absorbed by the model",
    "insensitive": "only an implausible size would be found",
    "implausible": "only an implausible size or sign would be found",
    "testable": "",
}
"""States in increasing order of what the rows can test, with their texts."""
_RANK = {state: rank for rank, state in enumerate(WHY)}


def limit_rows(testability: Sequence[Json]) -> list[tuple[str, str, str]]:
    """Effect with its parameter, places, and limits there, sorted by limit over usual size.

    Of an effect with several parameters the one with the smallest such ratio.
    """
    best: dict[tuple[str, str, str], dict[str, tuple[float, float]]] = {}
    for entry in testability:
        for limit in entry["limits"]:
            if entry["state"] != "testable" or limit["limit"] is None:
                continue
            label, _, place = limit["name"].partition("@")
            places = best.setdefault((entry["name"], label, limit["unit"]), {})
            found = (float(limit["limit"]), float(limit["limit"]) / limit["size"])
            places[place] = min(found, places.get(place, found))
    shown: dict[str, tuple[float, tuple[str, str, str]]] = {}
    for (name, label, unit), places in best.items():
        sizes = [value for value, _ in places.values()]
        share = min(share for _, share in places.values())
        row = (label, places_text([p for p in places if p]), span(min(sizes), max(sizes), unit))
        shown[name] = min((share, row), shown.get(name, (share, row)))
    return [row for _, row in sorted(shown.values())]


def not_testable(testability: Sequence[Json]) -> dict[str, list[str]]:
    """Why → effects that these rows cannot test, with the joints or links where that is so."""
    states: dict[str, dict[str, str]] = {}
    for entry in testability:
        places = states.setdefault(entry["name"], {})
        for limit in entry["limits"] or ({"name": entry["name"], "limit": None},):
            known = entry["state"] != "testable" or limit["limit"] is not None
            state = str(entry["state"]) if known else "insensitive"
            place = limit["name"].partition("@")[2]
            places[place] = max(state, places.get(place, state), key=lambda s: _RANK[s])
    groups: dict[str, dict[str, list[str]]] = {state: {} for state in WHY if state != "testable"}
    for name, places in states.items():
        for place, state in places.items():
            if state != "testable":
                groups[state].setdefault(name, []).extend([place] if place[-1:].isdigit() else [])
    return {WHY[s]: [label_text(name, at) for name, at in found.items()] for s, found in groups.items() if found}
