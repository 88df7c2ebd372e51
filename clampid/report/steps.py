"""Every step that a diagnosis confirmed and the model took, and all that was rejected beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clampid.diagnosis.held_out import HELD_OUT_RATE
from clampid.display import error_text, error_texts, number
from clampid.models.model import Model, Round
from clampid.report.evidence import confusable_text, filled_table, p_text, places_text
from clampid.report.rounds import rounds_of, unit_of
from clampid.report.stage_data import in_order, stage_title
from clampid.report.style import Figure, Section, Table

__all__ = ["steps_section"]

_STEP_COLUMNS = (
    "Step#",
    "Added",
    "p, alone#",
    "p, family-wise#",
    "p, held out#",
    "First in folds#",
    "Held out before#",
    "After#",
    "Confusable with",
)
_REJECTED = ("Step#", "Rejected", "At", "p, alone#", "p, family-wise#", "p, held out#", "Held out after#", "Why")
_NOTE = (
    "Each step is chosen with all earlier ones in the model. The second table lists every other effect that was "
    "significant at that step, at its best place, and every effect that was fitted and refused. While a large effect "
    "is missing, correlated effects are significant, too; they are no longer once it is added. Candidates after the "
    "last step are listed under the verdict."
)
_PRIOR_NOTE = (
    " (prior): most of what it explains is known from its prior and not from the rows. The held-out error of such an "
    "effect must not rise, but need not fall."
)
_MOSTLY = 0.5  # of what an effect explains


def steps_section(model: Model, first: Model | None) -> Section | None:
    """Section "Every step, and what was rejected"; None where no diagnosis chose what was added."""
    blocks: list[str | Table | Figure] = []
    for stage in in_order(model.stages):
        added = [r for r in rounds_of(model, first, stage) if r.added]
        if any("rejected" in r.evidence for r in added):
            blocks += [stage_title(stage), *_tables(added, unit_of(stage))]
    return Section("steps", "Every step, and what was rejected", (), tuple(blocks), (_NOTE,)) if blocks else None


def _tables(rounds: Sequence[Round], unit: str) -> list[Table]:
    steps = [_step(str(k), r, unit) for k, r in enumerate(rounds, 1)]
    rejected = [_rejection(str(k), e, unit) for k, r in enumerate(rounds, 1) for e in r.evidence.get("rejected", ())]
    tables = [
        filled_table(
            _STEP_COLUMNS,
            steps,
            "What was added, step by step. First in folds: share of the fits without a fifth of the rows in which it "
            f"ranks first.{_PRIOR_NOTE if any(_by_prior(r.evidence) for r in rounds) else ''}",
        )
    ]
    return [*tables, filled_table(_REJECTED, rejected, "What was rejected, and why.")] if rejected else tables


def _step(count: str, entry: Round, unit: str) -> tuple[str, ...]:
    found = entry.evidence
    stable = found.get("stability")
    return (
        count,
        ", ".join(entry.added),
        *_ps(found)[:2],
        f"{p_text(found.get('p_held_out'))}{' (prior)' if _by_prior(found) else ''}",
        "–" if stable is None else f"{number(100.0 * stable, 2)} %",
        *error_texts([found.get("heldout_rms_before"), found.get("heldout_rms_after")], unit),
        confusable_text(found),
    )


def _rejection(count: str, found: Mapping[str, Any], unit: str) -> tuple[str, ...]:
    after = error_text(found.get("heldout_rms_after"), unit)
    return count, str(found["name"]), places_text(found), *_ps(found), after, str(found["reason"])


def _by_prior(found: Mapping[str, Any]) -> bool:
    """Whether a step was confirmed although the held-out error does not fall by more than chance."""
    p = found.get("p_held_out")
    return p is not None and p > HELD_OUT_RATE and float(found.get("from_prior") or 0.0) > _MOSTLY


def _ps(found: Mapping[str, Any]) -> tuple[str, str, str]:
    return p_text(found.get("p_value")), p_text(found.get("p_familywise")), p_text(found.get("p_held_out"))
