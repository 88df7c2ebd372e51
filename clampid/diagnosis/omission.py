"""What leaving an effect out had done to the exported robot: how the Denavit-Hartenberg table shifts when it is added.

A fit without an effect puts as much of it as it can into what is free: J⁺·D·β, with J the Jacobian of the free
parameters, D the effect's columns and β its size. Both fits are at hand here, so that the shift is their difference and
holds what J⁺·D·β leaves out, the change of the active effects with each other.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clampid.display import with_error
from clampid.exports.dh_export import FRAME_COLUMNS, ROW_COLUMNS, static_table
from clampid.models.model import Model, ModelError
from kinematics.dh_conversion import DHError
from kinematics.robot import RobotDescription

__all__ = ["exported_shift", "shift_in_words"]

CLEAR = 2.0  # standard errors beyond which a shift is told
MAX_NAMED = 3  # numbers named in a sentence


def exported_shift(before: Model, after: Model, robot: RobotDescription) -> list[dict[str, Any]]:
    """Numbers of the exported table (Hayati's rows) that the omission had shifted, the clearest first.

    Parameters
    ----------
    before, after
        The model without and with the effect, fitted to the same rows of the same sessions.

    Returns
    -------
    list of dict
        ``row`` (``1`` … ``n``, ``base``, ``tool``), ``parameter`` and ``unit`` (m or rad), ``shift`` (without the
        effect less with it) and ``std``, the standard error of the number with it. Only what is beyond two standard
        errors; empty where the models have no geometry to export.
    """
    try:
        tables = [static_table(model, "hayati", robot=robot) for model in (before, after)]
    except (ModelError, DHError):
        return []
    out: list[dict[str, Any]] = []
    for (_, old), (_, new) in zip(tables[0].iterrows(), tables[1].iterrows(), strict=True):
        for column in (*ROW_COLUMNS, *FRAME_COLUMNS):
            std = float(new[f"std_{column}"])
            if not std > 0.0:  # empty, or fixed by the convention
                continue
            shift = float(old[column]) - float(new[column])
            unit = "m" if column.endswith("_m") else "rad"
            if unit == "rad":
                shift = float(np.pi - np.remainder(np.pi - shift, 2.0 * np.pi))
            if abs(shift) > CLEAR * std:
                name = column.removesuffix(f"_{unit}")
                out.append({"row": str(new["row"]), "parameter": name, "shift": shift, "std": std, "unit": unit})
    return sorted(out, key=lambda entry: -abs(entry["shift"]) / entry["std"])


def shift_in_words(shifts: list[dict[str, Any]]) -> str:
    """One sentence on the largest shifts; empty where there are none."""
    if not shifts:
        return ""
    named = []
    for entry in shifts[:MAX_NAMED]:
        off = with_error(entry["shift"], entry["std"], entry["unit"])
        row = f"row {entry['row']}" if entry["row"].isdigit() else entry["row"]
        named.append(f"{entry['parameter']} of {row} by {off}")
    more = f", and {len(shifts) - MAX_NAMED} more numbers" if len(shifts) > MAX_NAMED else ""
    return f"Without it the exported DH table was biased: {', '.join(named)}{more}."
