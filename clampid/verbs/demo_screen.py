"""The screen of ``demo``: the fall of the error, the verdict, and only then what had been hidden."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from clampid.diagnosis.headline import headline, listed, named
from clampid.display import error_text
from clampid.screen import Errors, Next, Screen

if TYPE_CHECKING:
    from clampid.loop.demo import DemoResult

__all__ = ["demo_screen"]

FOUND = "It was found."
ONE_OF_SEVERAL = "It is one of those that these data cannot distinguish."
MISSED = "It was not found."


def demo_screen(result: DemoResult) -> Screen:
    """What a demo found, and then what was hidden."""
    rows = []
    for name, table in result.after["tables"].items():
        errors = (result.before["tables"][name]["heldout"]["rms"], table["heldout"]["rms"], table["noise_floor"])
        rows.append((name, tuple(error_text(e, table["unit"]) for e in errors), ""))
    hidden = [named(item["effect"], [item["where"]]) for item in result.hidden]
    outcome = MISSED if not result.named else FOUND if _confirmed(result) else ONE_OF_SEVERAL
    labels = [term.partition("=")[2].partition("@") for terms in result.found.values() for term in terms]
    added = [named(effect, [place] if place else []) for effect, _, place in labels]
    facts = [("added", listed(added, 4) if added else "nothing: no effect was confirmed")]
    return Screen(
        "Simulated a campaign with a hidden effect, fitted a start model, diagnosed and mended it.",
        Errors(
            "Error (rms) on held-out rows; torques in σ, units of each motor's noise",
            ("start model", "this model", "noise floor"),
            tuple(rows),
        ),
        tuple(facts),
        headline(result.diagnosis["stages"], mended=True),
        "good" if result.named else "bad",
        (f"What was hidden: {listed(hidden)}. {outcome}", f"The report: {result.report}"),
        "Each step in sentences: --verbose.",
        (
            Next(
                "Next, compare the mended model with the campaign:",
                shlex.join(["clampid", "compare", str(result.folder / "model.json"), str(result.folder / "campaign")]),
            ),
        ),
    )


def _confirmed(result: DemoResult) -> bool:
    effects = {item["effect"] for item in result.hidden}
    stages = result.diagnosis["stages"].values()
    return any(c["effect"] in effects and not c["alternative"] for part in stages for c in part["candidates"])
