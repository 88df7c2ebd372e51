"""Evidence of a confirmed step, and the rejected candidates with their reasons: for the ledger."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from clampid.diagnosis.candidate_scores import ABLE, DICTIONARY_FALSE_ALARMS, CandidateScores
from clampid.diagnosis.entries import considered_of
from clampid.evidence.score import Scored

__all__ = ["evidence_of"]

FOR = ("p_value", "p_familywise", "p_held_out", "stability", "explained", "from_prior", "confusable_with")
ABOUT = (
    "effect", "name", "where", "p_value", "p_familywise", "p_held_out", "stability", "explained", "heldout_rms_before",
    "heldout_rms_after", "reason",
)  # fmt: skip


def evidence_of(
    chosen: Mapping[str, Any], best: Scored, scores: CandidateScores, refused: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """The evidence of a step, with the names of ``diagnose``, and the rejected candidates.

    Parameters
    ----------
    chosen
        The step as a verdict lists it.
    best, scores
        Its candidate, and the scores that found it.
    refused
        Candidates that were fitted before it and refused, as a verdict lists them, with the ``reason``.
    """
    rejected = [*refused, *_passed_over(best, scores)]
    return {
        **{key: chosen[key] for key in FOR if key in chosen},
        "rejected": [{key: entry[key] for key in ABOUT if key in entry} for entry in _once(rejected)],
    }


def _passed_over(best: Scored, scores: CandidateScores) -> list[dict[str, Any]]:
    """The best place of every other significant effect, except the places of the step."""
    found: dict[str, Scored] = {}
    mine = set(best.candidate.terms)
    for s in sorted((s for s in scores.named if s.freedom), key=lambda s: -s.bic):
        stands_out = s.bic > 0 and scores.named_null.p_familywise(s.log_p) <= DICTIONARY_FALSE_ALARMS
        if stands_out and s.state in (*ABLE, "implausible") and not mine & set(s.candidate.terms):
            found.setdefault(s.candidate.name, s)
    entries = considered_of(list(found.values()), scores.named_null, len(found))
    return [{**entry, "reason": _reason(s, best)} for entry, s in zip(entries, found.values(), strict=True)]


def _reason(s: Scored, best: Scored) -> str:
    if s.state == "implausible":
        return "fits only with an impossible size or sign"
    if s.explained < best.explained:
        return f"explains {100.0 * s.explained / best.explained:.0f} % as much"
    return "explains as much, but with more parameters, so more of it by chance"


def _once(entries: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Each effect and place once, its first entry."""
    first: dict[tuple[Any, ...], Mapping[str, Any]] = {}
    for entry in entries:
        first.setdefault((entry["name"], *entry["where"]), entry)
    return list(first.values())
