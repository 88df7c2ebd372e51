"""The command that does what a diagnosis asks for, to copy."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from clampid.diagnosis.headline import equally_good
from clampid.screen import Next

__all__ = ["after_diagnosis", "after_mending", "free_name", "next_steps"]


def next_steps(
    diagnosis: Mapping[str, Any], model: Path, campaigns: Sequence[Path], effects_from: Path | None = None
) -> list[Next]:
    """Say what to type next.

    Parameters
    ----------
    diagnosis
        As ``diagnose`` gives it to programs.
    model, campaigns, effects_from
        As it was called.

    Returns
    -------
    list of Next
        The command that adds what was confirmed, and the one that diagnoses again then; where nothing was, one for each
        of the candidates that explain the data equally well; none where nothing is missing.
    """
    confirmed: list[str] = []
    either: dict[tuple[str, int], list[str]] = {}
    for stage, part in diagnosis["stages"].items():
        offered = equally_good(part["candidates"])
        for candidate in part["candidates"]:
            name = candidate.get("name", candidate["effect"])  # ``effect`` is the family, of which it may be a variant
            # A stage holds for the terms after it, too.
            places = [f"{name}@{place}" for place in candidate["where"]] or [name]  # none: wherever it can be tested
            term = f"{stage}=" + ",".join(places)
            if not candidate["alternative"]:
                confirmed.append(term)
            elif candidate in offered:
                either.setdefault((stage, candidate["group"]), []).append(term)
    own = [] if effects_from is None else ["--effects-from", str(effects_from)]
    files, mended = [str(model), *map(str, campaigns)], str(free_name(model.with_name("mended.json")))

    def adding(terms: str) -> str:
        return shlex.join(["clampid", "add", terms, *files, "-o", mended, *own])

    if confirmed:
        again = shlex.join(["clampid", "diagnose", mended, *map(str, campaigns), *own])
        what = "it" if len(confirmed) == 1 else "them"
        return [Next(f"Next, add {what}:", adding(",".join(confirmed))), Next("Then diagnose again:", again)]
    # Of each group any one; what is left open of a second group is said after the next diagnosis.
    first = next(iter(either.values()), [])
    head = "Next, add one of these:" if len(first) > 1 else "Next, add it:"
    return [Next("Or:" if k else head, adding(terms)) for k, terms in enumerate(first)]


def after_diagnosis(
    diagnosis: Mapping[str, Any],
    model: Path,
    campaigns: Sequence[Path],
    plan: Path | None,
    effects_from: Path | None = None,
) -> list[Next]:
    """Say what to type after ``diagnose``: add, measure, describe an unknown effect, or write the report."""
    parts = diagnosis["stages"].values()
    confirmed = any(not c["alternative"] for part in parts for c in part["candidates"])
    if confirmed:
        return next_steps(diagnosis, model, campaigns, effects_from)
    measure = [] if plan is not None else _to_measure(diagnosis, model, campaigns, effects_from)
    shape = next((part["shape"]["command"] for part in parts if part.get("shape")), None)
    if shape is not None:
        return [Next("Next, write an effect of this shape:", shape)]
    found = [*measure, *next_steps(diagnosis, model, campaigns, effects_from)]
    return found or [_report(model, campaigns, effects_from)]


def after_mending(
    diagnosis: Mapping[str, Any],
    model: Path,
    campaigns: Sequence[Path],
    report: Path | None,
    effects_from: Path | None = None,
) -> list[Next]:
    """Say what to type after ``auto``: measure what is still open, and write the report."""
    measure = _to_measure(diagnosis, model, campaigns, effects_from)
    again = [] if report is not None else [_report(model, campaigns, effects_from)]
    found = [*again, *measure]
    return found or [Next("Next, export the table:", shlex.join(["clampid", "export", "dh", str(model)]))]


def _report(model: Path, campaigns: Sequence[Path], effects_from: Path | None) -> Next:
    own = [] if effects_from is None else ["--effects-from", str(effects_from)]
    return Next("Next, write the report:", shlex.join(["clampid", "report", str(model), str(campaigns[0]), *own]))


def _to_measure(
    diagnosis: Mapping[str, Any], model: Path, campaigns: Sequence[Path], effects_from: Path | None
) -> list[Next]:
    """The command that writes a plan of what distinguishes candidates, where such measurements are known."""
    plans = [part.get("next_plan") or {} for part in diagnosis["stages"].values()]
    if len(campaigns) > 1 or not any(plan.get("for") == "parting" and plan.get("helps") for plan in plans):
        return []
    own = [] if effects_from is None else ["--effects-from", str(effects_from)]
    call = ["clampid", "diagnose", str(model), *map(str, campaigns), "--plan", "next.toml", *own]
    return [Next("To distinguish the rest, write a measurement plan:", shlex.join(call))]


def free_name(wanted: Path) -> Path:
    """A name that no file has: the one wanted, or one with a number: ``mended.json``, ``mended2.json``, …."""
    for number in range(1, 1000):
        path = wanted.with_stem(f"{wanted.stem}{number if number > 1 else ''}")
        if not path.exists():
            return path
    return wanted.with_stem(wanted.stem.upper())
