"""The demo: measure a virtual robot, identify, compare, diagnose, add, verify; then reveal the hidden effect.

The campaign comes from the virtual robot, which hides one effect that the start model lacks. It shares no code with
the effects. The hidden effect is shown at the end, and nothing reads it before.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clampid.comparison.compare import compare
from clampid.diagnosis.diagnose import diagnose
from clampid.display import error_text, error_texts
from clampid.identification.identify import identify
from clampid.loop.add import add
from clampid.models.model import Model, save_model
from clampid.standard_sets import DRAWN
from experiments.campaign import Campaign, read_campaign
from experiments.outputs import write_text
from experiments.simulate import hidden_file, simulate

__all__ = ["DRAWN", "DemoResult", "demo", "foreign_file", "terms_to_add"]

WRITTEN = (
    "campaign", "model_standard.json", "compare_standard.json", "diagnose.json", "add.json", "model.json",
    "compare.json", "report.html", "demo.json",
)  # fmt: skip
"""Files that it writes into its folder, besides the file that says what was hidden."""
ROBOT = "kuka_kr20_r1810"
FOUND = "It was found."
ONE_OF_SEVERAL = "It is one of those that these data do not distinguish."
MISSED = "It was not found."
Working = Callable[[str], AbstractContextManager[None]]


@dataclass(frozen=True)
class DemoResult:
    """Result of a demo: what was found, and what was hidden.

    Attributes
    ----------
    hidden
        ``[{"effect", "where", "parameters"}]``, as the virtual robot reports it.
    found
        Stage → the effects added, as terms.
    before, after, diagnosis
        As ``compare`` and ``diagnose`` give them to programs.
    named
        Whether the hidden effect is among the candidates: confirmed, or one of those that cannot be separated.
    """

    folder: Path
    report: Path
    hidden: Sequence[Mapping[str, Any]]
    found: Mapping[str, Sequence[str]]
    before: Mapping[str, Any]
    after: Mapping[str, Any]
    diagnosis: Mapping[str, Any]
    named: bool

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "folder": str(self.folder),
            "report": str(self.report),
            "hidden": list(self.hidden),
            "found": {stage: list(terms) for stage, terms in self.found.items()},
            "named": self.named,
            "before": dict(self.before),
            "after": dict(self.after),
            "diagnosis": dict(self.diagnosis),
        }


def demo(
    out: str | Path = "demo",
    seed: int = 1,
    *,
    poses: int = 250,
    say: Callable[[str], None] = print,
    working: Working | None = None,
) -> DemoResult:
    """Run the whole loop on a virtual robot with one effect hidden.

    Parameters
    ----------
    out
        Folder for the campaign, the models, the JSON and the report; an older demo in it is replaced.
    seed
        Draws the effect, the individual robot, the programs and the noise.
    poses
        Number of poses measured.
    say
        Takes each sentence for people.
    working
        Wraps each long step, with its name.

    Returns
    -------
    DemoResult
        What was found and what was hidden.
    """
    folder = Path(out)
    step: Working = working if working is not None else lambda _: nullcontext()
    with step("measuring a campaign on the virtual robot"):
        path = simulate(folder / "campaign", ROBOT, [_draw(seed)], seed=seed, poses=poses, overwrite=True)
        campaign = read_campaign(path)
    rows = ", ".join(f"{name} ({len(table)} rows)" for name, table in campaign.tables.items())
    say(f"Measured on a virtual {campaign.robot.title}, one effect hidden in it: {rows}.")
    with step("identifying the start model"):
        model = identify(campaign, seed=seed)
    save_model(model, folder / "model_standard.json")
    for stage, part in model.stages.items():
        say(f"Standard model, {stage}: {', '.join(t.label for t in part.terms)}; {len(part.slots)} parameters.")
    with step("comparing model and measurement"):
        before = compare(model, campaign, seed=seed).to_json()
    _write(folder / "compare_standard.json", before)
    with step("diagnosing"):
        found = diagnose(model, campaign, seed=seed).to_json()
    _write(folder / "diagnose.json", found)
    for stage, part in found["stages"].items():
        say(f"Diagnosis, {stage}: {part['verdict']}. {part['summary']}")
    with step("adding what was found and fitting again"):
        mended, terms, additions = _mend(model, campaign, found, seed)
    write_text(folder / "add.json", json.dumps(additions, indent=1) + "\n")
    listed = ", ".join(t for several in terms.values() for t in several)
    say(f"Added: {listed}." if listed else "Nothing was confirmed, so nothing is added.")
    save_model(mended, folder / "model.json")
    with step("comparing again"):
        after = compare(mended, campaign, seed=seed).to_json()
    _write(folder / "compare.json", after)
    for line in _errors(before, after):
        say(line)
    hidden: list[dict[str, Any]] = json.loads(hidden_file(path).read_text(encoding="utf-8"))
    outcomes = [_outcome(item, found) for item in hidden]
    for item, outcome in zip(hidden, outcomes, strict=True):
        say(f"What was hidden: {item['effect']} at {item['where']}. {outcome}")
    named = MISSED not in outcomes
    report = folder / "report.html"
    with step("writing the report"):
        from clampid.report import write_report  # only the last step needs it

        write_report(report, mended, campaign, comparison=after, diagnosis=found, first_model=model, truth=hidden)
    say(f"Report: {report}")
    result = DemoResult(folder, report, tuple(hidden), terms, before, after, found, named)
    _write(folder / "demo.json", result.to_json())
    return result


def foreign_file(out: str | Path) -> str | None:
    """A file in a folder that a demo would replace although no demo wrote it; None if there is none.

    A folder is that of an older demo if the file with the hidden effect is beside its campaign.
    """
    folder = Path(out)
    if hidden_file(folder / "campaign").is_file():
        return None
    return next((name for name in WRITTEN if os.path.lexists(folder / name)), None)


def _draw(seed: int) -> str:
    """One effect; as many consecutive seeds as there are effects draw each of them once."""
    row, place = divmod(seed, len(DRAWN))
    return DRAWN[int(np.random.default_rng([20, row]).permutation(len(DRAWN))[place])]


def terms_to_add(
    diagnosis: Mapping[str, Any],
) -> tuple[dict[str, list[str]], dict[tuple[str, int], list[list[str]]]]:
    """Terms to add, ``STAGE=EFFECT@PLACE``: confirmed ones by stage, alternatives by stage and group."""
    confirmed: dict[str, list[str]] = {}
    alternatives: dict[tuple[str, int], list[list[str]]] = {}
    for stage, part in diagnosis["stages"].items():
        for candidate in part["candidates"]:
            effect = f"{stage}={candidate['effect']}"  # without a place: wherever it can be tested
            terms = [f"{effect}@{place}" for place in candidate["where"]] or [effect]
            if candidate["alternative"]:
                alternatives.setdefault((stage, candidate["group"]), []).append(terms)
            else:
                confirmed.setdefault(stage, []).extend(terms)
    return confirmed, alternatives


def _mend(
    model: Model, campaign: Campaign, diagnosis: Mapping[str, Any], seed: int
) -> tuple[Model, dict[str, list[str]], list[Any]]:
    """Add the confirmed effects, and of inseparable alternatives the one with the smallest held-out error.

    Any of the alternatives corrects the prediction; which of them is the cause stays open.
    """
    found, alternatives = terms_to_add(diagnosis)
    additions = []
    if found:
        model, addition = add(model, campaign, [t for terms in found.values() for t in terms], seed=seed)
        additions.append(addition.to_json())
    for (stage, _), several in alternatives.items():
        tried = [(add(model, campaign, terms, seed=seed), terms) for terms in several]
        errors = [addition.to_json()["stages"][stage]["heldout_rms_after"] for (_, addition), _ in tried]
        (model, addition), terms = tried[int(np.argmin(errors))]
        found[stage] = [*found.get(stage, []), *terms]
        additions.append(addition.to_json())
    return model, found, additions


def _errors(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """For each table the held-out error before and after, and the noise floor."""
    lines = []
    for name, table in after["tables"].items():
        unit, was = table["unit"], before["tables"][name]
        errors = error_texts([t["heldout"]["rms"] for t in (was, table)], unit)
        floor = error_text(table["noise_floor"], unit)
        lines.append(f"Held-out error (rms), {name}: {errors[0]} before, {errors[1]} after; noise floor {floor}.")
    return lines


def _outcome(item: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> str:
    """Whether a hidden effect was confirmed, is one of several that explain the data equally well, or was missed."""
    stages = diagnosis["stages"].values()
    candidates = [c for part in stages for c in part["candidates"] if c["effect"] == item["effect"]]
    if not candidates:
        return MISSED
    return ONE_OF_SEVERAL if all(c["alternative"] for c in candidates) else FOUND


def _write(path: Path, data: Mapping[str, Any]) -> None:
    write_text(path, json.dumps(data, indent=1) + "\n")
