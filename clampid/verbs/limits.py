"""Detection limits of a diagnosis, and what its rows cannot test, in a few lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clampid.diagnosis.limits import limit_rows, not_testable
from clampid.display import label_text, places_text, readable, span
from clampid.verbs.output import Output

__all__ = ["show_limits", "show_plan"]

Json = Mapping[str, Any]
MAX_LINES = 8


def show_limits(testability: Sequence[Json], out: Output) -> None:
    """A table of the effects that these rows show best, each with its detection limit, and what cannot be tested."""
    rows = limit_rows(testability)
    if rows:
        title = "an effect of more than this would have been found with 90 % probability"
        if len(rows) > MAX_LINES:
            title += f"; the {MAX_LINES} seen best of {len(rows)}, all in --json"
        out.table(title, ("absent effect", "at", "detection limit"), rows[:MAX_LINES], left=2)
    groups = not_testable(testability)
    if groups:
        listed = "; ".join(f"{', '.join(names)} ({why})" for why, names in groups.items())
        out.say(f"  not testable here: {listed}")


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
