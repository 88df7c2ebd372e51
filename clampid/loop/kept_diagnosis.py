"""A diagnosis stored beside its model, so that a report need not compute it again.

``diagnose`` and ``auto`` write ``MODEL.diagnosis.json``. It contains hashes of the model and of the campaigns, and is
used only for these.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.campaign import Campaign
from experiments.outputs import write_text
from kinematics.reading import json_of, read_text

__all__ = ["keep_diagnosis", "kept_diagnosis", "kept_file"]

FORMAT = "clampid-diagnosis/1"


def kept_file(model: Path) -> Path:
    """Path of the file with the diagnosis of a model."""
    return model.with_suffix(".diagnosis.json")


def keep_diagnosis(model: Path, campaigns: Sequence[Campaign], diagnosis: Mapping[str, Any]) -> None:
    """Write a diagnosis beside its model.

    Parameters
    ----------
    model
        The model file, already written.
    diagnosis
        As the JSON of ``diagnose`` has it, without numbers that are not finite.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    text = json.dumps({"format": FORMAT, **_of(model, campaigns), "diagnosis": diagnosis}, indent=1, ensure_ascii=False)
    write_text(kept_file(model), text + "\n")


def kept_diagnosis(model: Path, campaign: Campaign) -> Mapping[str, Any] | None:
    """The stored diagnosis of this model on this campaign, alone or with others; None if there is none."""
    try:
        data = json_of(read_text(kept_file(model)))
    except (OSError, ValueError):
        return None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        return None
    known = _of(model, [campaign])
    same = data.get("model") == known["model"] and known["campaigns"][0] in data.get("campaigns", ())
    return data.get("diagnosis") if same else None


def _of(model: Path, campaigns: Sequence[Campaign]) -> dict[str, Any]:
    digest = hashlib.sha256(model.read_bytes()).hexdigest()
    return {"model": digest, "campaigns": [campaign.fingerprint for campaign in campaigns]}
