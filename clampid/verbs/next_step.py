"""The command that does what a diagnosis asks for, to copy."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

__all__ = ["next_steps"]


def next_steps(
    diagnosis: Mapping[str, Any], model: Path, campaigns: Sequence[Path], effects_from: Path | None = None
) -> list[str]:
    """Say what to type next.

    Parameters
    ----------
    diagnosis
        As ``diagnose`` gives it to programs.
    model, campaigns, effects_from
        As it was called.

    Returns
    -------
    list of str
        The command that adds what was confirmed, and the one that looks again then; where nothing was, one for each of
        the candidates that cannot be told apart; none where nothing is missing.
    """
    confirmed: list[str] = []
    either: dict[tuple[str, int], list[str]] = {}
    for stage, part in diagnosis["stages"].items():
        for candidate in part["candidates"]:
            name = candidate.get("name", candidate["effect"])  # ``effect`` is the family, of which it may be a variant
            term = ",".join(f"{stage}={name}@{place}" for place in candidate["where"])
            if candidate["alternative"]:
                either.setdefault((stage, candidate["group"]), []).append(term)
            else:
                confirmed.append(term)
    own = [] if effects_from is None else ["--effects-from", str(effects_from)]

    files, mended = [str(model), *map(str, campaigns)], str(_free(model))

    def adding(terms: str) -> str:
        return shlex.join(["clampid", "add", terms, *files, "-o", mended, *own])

    if confirmed:
        again = shlex.join(["clampid", "diagnose", mended, *map(str, campaigns), *own])
        return [f"to add it: {adding(','.join(confirmed))}", f"and to look again: {again}"]
    # Of each group any one; what is left open of a second group is said when one looks again.
    first = next(iter(either.values()), [])
    return [("or: " if k else "to add one of these: ") + adding(terms) for k, terms in enumerate(first)]


def _free(model: Path) -> Path:
    """A name beside the model that no file has: ``mended.json``, ``mended2.json``, …."""
    for number in range(1, 1000):
        path = model.with_name(f"mended{number if number > 1 else ''}.json")
        if not path.exists():
            return path
    return model.with_name("MENDED.json")
