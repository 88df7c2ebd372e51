"""What a diagnosis would have found and what it could not, in a few lines for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clampid.display import readable, span
from clampid.verbs.output import Output
from clampid.verbs.show import label_text, places_text

__all__ = ["limit_rows", "not_testable", "show_limits", "show_plan"]

Json = Mapping[str, Any]
MOST = 8
WHY = {
    "absent": "does nothing in these rows",
    "absorbed": "the model takes it up",
    "weak": "the model takes nearly all of it up",
    "insensitive": "only a size that cannot be would show",
    "implausible": "only a size or sign that cannot be would show",
    "testable": "",
}
"""States, the more that rows can tell the later, and what is said of them."""
_RANK = {state: rank for rank, state in enumerate(WHY)}


def show_limits(testability: Sequence[Json], out: Output) -> None:
    """A table of the effects that these rows show best, each with its detection limit, and what cannot be tested."""
    rows = limit_rows(testability)
    if rows:
        title = "an effect of more than this would have been found with 90 % probability"
        if len(rows) > MOST:
            title += f"; the {MOST} seen best of {len(rows)}, all in --json"
        out.table(title, ("absent effect", "at", "detection limit"), rows[:MOST], left=2)
    groups = not_testable(testability)
    if groups:
        listed = "; ".join(f"{', '.join(names)} ({why})" for why, names in groups.items())
        out.say(f"  not testable here: {listed}")


def limit_rows(testability: Sequence[Json]) -> list[tuple[str, str, str]]:
    """Effect with its parameter, places, and limits there; first what is seen at the smallest part of a usual size.

    Of an effect with several parameters the one that is seen best.
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


def show_plan(plan: Json, out: Output) -> None:
    """Of what is to test better: detection limits now and after, and what no such measurement tests."""
    if plan["for"] != "testing":
        return
    helped = [g for g in plan["detection_limits"] if g["possible"]]
    if helped:
        out.say(f"  next measurement, for what these rows test too weakly: {plan['what']}")
        title = f"found with 90 % probability, now and with these {plan['count']} (of {plan['tried']} tried)"
        columns = ("effect", "at", "usual size", "found from, now", "with these")
        out.table(title, columns, _gains(helped), left=2)
    rest = [g for g in plan["detection_limits"] if not g["possible"]]
    some = _named([g for g in rest if g["limit_with_all_tried"] is not None])
    none = _named([g for g in rest if g["limit_with_all_tried"] is None])
    if some:
        out.say(f"  their usual size would not show even with all {plan['tried']} tried together: {some}")
    if none:
        out.say(f"  no such measurement shows them at all: {none}")


def _gains(gains: Sequence[Json]) -> list[tuple[str, ...]]:
    """Parameter, places, usual size, and the limits there before and after; several places in one row."""
    groups: dict[tuple[str, str], list[Json]] = {}
    for g in gains:
        groups.setdefault((g["name"].partition("@")[0], g["unit"]), []).append(g)
    rows = []
    for (label, unit), own in groups.items():
        places = [place for g in own if (place := g["name"].partition("@")[2])]
        sizes = (_between([g[key] for g in own], unit) for key in ("size", "limit_before", "limit_after"))
        rows.append((label, places_text(places), *sizes))
    return rows


def _between(values: Sequence[float | None], unit: str) -> str:
    known = [value for value in values if value is not None]
    if len(known) < len(values):
        return f"{readable(min(known), unit, 2)} – nowhere" if known else "not at all"
    return span(min(known), max(known), unit)


def _named(gains: Sequence[Json]) -> str:
    """Effects with their places, each once."""
    places: dict[str, dict[str, None]] = {}
    for g in gains:
        label, _, place = g["name"].partition("@")
        places.setdefault(label.partition(".")[0], {}).update({place: None} if place[-1:].isdigit() else {})
    return ", ".join(label_text(name, list(at)) for name, at in places.items())
