"""One figure for one step: a diagnosis with the held-out errors that the model's ledger has of the steps it took.

Diagnosis and ``add`` fit the same step from different starts, so that weights and outliers can differ. On the UR10 the
first step leaves 110 µm in the one and 112 µm in the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from clampid.diagnosis.headline import at_error
from clampid.models.model import Model, Round
from clampid.report.rounds import rounds_of
from clampid.report.stage_data import in_order

__all__ = ["with_ledger_figures"]

Json = Mapping[str, Any]
ERRORS = ("heldout_rms_before", "heldout_rms_after")


def with_ledger_figures(diagnosis: Json | None, model: Model, first: Model | None) -> Json | None:
    """The JSON of ``diagnose`` with the ledger's held-out errors where the model took a confirmed candidate as a round.

    Candidates that the model does not have keep the diagnosis's own errors.
    """
    if diagnosis is None:
        return None
    stages = dict(diagnosis.get("stages") or {})
    for stage in in_order([name for name in stages if name in model.stages]):
        stages[stage] = _stage(stages[stage], rounds_of(model, first, stage))
    return {**diagnosis, "stages": stages}


def _stage(part: Json, rounds: tuple[Round, ...]) -> Json:
    candidates = list(part.get("candidates") or ())
    taken = [next((r for r in rounds if _is_of(c, r)), None) for c in candidates]
    found = [
        c if r is None else {**c, **{key: r.evidence[key] for key in ERRORS if key in r.evidence}}
        for c, r in zip(candidates, taken, strict=True)
    ]
    confirmed = [(c, r) for c, r in zip(found, taken, strict=True) if not c.get("alternative")]
    if not confirmed or any(r is None for _, r in confirmed):
        return {**part, "candidates": found}
    ends = {ERRORS[0]: confirmed[0][0].get(ERRORS[0]), ERRORS[1]: confirmed[-1][0].get(ERRORS[1])}
    known = {key: value for key, value in ends.items() if value is not None}
    return at_error({**part, "candidates": found, **known}, rounds[-1].heldout_rms, rounds[-1].noise_floor)


def _is_of(candidate: Json, entry: Round) -> bool:
    """Whether a round added a candidate, at its places or wherever it acts."""
    name = str(candidate.get("name") or candidate.get("effect") or "")
    places = {f"{name}@{place}" for place in candidate.get("where") or ()}
    return bool(entry.added) and set(entry.added) in ({name}, places)
