"""The bias of the exported robot without an effect: the shift of the Denavit-Hartenberg table when the effect is added.

A fit without an effect absorbs it in the free parameters: J⁺·D·β, with J the Jacobian of the free parameters, D the
effect's columns and β its size. Here both fits are known, so the shift is their difference. It contains what J⁺·D·β
leaves out, the change of the active effects with each other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from clampid.diagnosis.headline import worth_naming
from clampid.display import length, with_error
from clampid.exports.dh_export import FRAME_COLUMNS, ROW_COLUMNS, read_dh, static_table, table_text
from clampid.exports.form_error import postures
from clampid.models.model import Model, ModelError
from kinematics.dh import forward
from kinematics.dh_conversion import DHError
from kinematics.robot import RobotDescription

__all__ = ["exported_shift", "shift_in_words"]

if TYPE_CHECKING:
    import pandas as pd

Array = npt.NDArray[np.float64]

CERTAIN_SHIFT = 2.0  # standard errors beyond which a shift is reported
MAX_NAMED = 3  # numbers named in a sentence
POSTURES = 200


def exported_shift(before: Model, after: Model, robot: RobotDescription) -> list[dict[str, Any]]:
    """Numbers of the exported table (Hayati's rows) that the omission had shifted, the largest at the flange first.

    Parameters
    ----------
    before, after
        The model without and with the effect, fitted to the same rows of the same sessions.

    Returns
    -------
    list of dict
        ``row`` (``1`` … ``n``, ``base``, ``tool``), ``parameter`` and ``unit`` (m or rad), ``shift`` (without the
        effect less with it), ``std``, the standard error of the number with it, and ``at_flange_m``, by how much the
        shift of this number alone moves the flange (rms over the joints' ranges). Only what is beyond two standard
        errors; empty if the models have no geometry to export.
    """
    try:
        tables = [static_table(model, "hayati", robot=robot) for model in (before, after)]
    except (ModelError, DHError):
        return []
    q, with_it = postures(robot, POSTURES), tables[1]
    there = _flange(with_it, q)
    out: list[dict[str, Any]] = []
    for (_, old), (k, new) in zip(tables[0].iterrows(), with_it.iterrows(), strict=True):
        for column in (*ROW_COLUMNS, *FRAME_COLUMNS):
            std = float(new[f"std_{column}"])
            if not std > 0.0:  # empty, or fixed by the convention
                continue
            shift = float(old[column]) - float(new[column])
            unit = "m" if column.endswith("_m") else "rad"
            if unit == "rad":
                shift = float(np.pi - np.remainder(np.pi - shift, 2.0 * np.pi))
            if abs(shift) > CERTAIN_SHIFT * std:
                name = column.removesuffix(f"_{unit}")
                without = with_it.copy()
                without.loc[k, column] = old[column]
                moved = np.linalg.norm(_flange(without, q) - there, axis=1)
                out.append({"row": str(new["row"]), "parameter": name, "shift": shift, "std": std, "unit": unit,
                            "at_flange_m": float(np.sqrt(np.mean(moved**2)))})  # fmt: skip
    return sorted(out, key=lambda entry: -entry["at_flange_m"])


def _flange(table: pd.DataFrame, q: Array) -> Array:
    """Positions ``(N, 3)`` of the flange by a table, m."""
    return np.asarray(forward(read_dh(table_text(table)), q)[:, :3, 3])


def shift_in_words(shifts: Sequence[Mapping[str, Any]]) -> str:
    """One sentence on the shifts that are largest at the flange; empty where none is measurable there."""
    large, named = worth_naming(shifts), []
    if not large:
        return ""
    for entry in large[:MAX_NAMED]:
        off = with_error(entry["shift"], entry["std"], entry["unit"])
        row = f"row {entry['row']}" if entry["row"].isdigit() else entry["row"]
        named.append(f"{entry['parameter']} of {row} by {off} ({length(entry['at_flange_m'])} at the flange)")
    more = f", and {len(large) - MAX_NAMED} more numbers" if len(large) > MAX_NAMED else ""
    return f"Without it the exported DH table was biased: {', '.join(named)}{more}."
