"""Errors of joint angles as a table, for controllers that correct angles before they use a DH table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clampid.exports.form_error import ranges
from clampid.models.curves import angle_errors
from clampid.models.described import robot_of
from clampid.models.model import Model, ModelError
from clampid.models.own_effects import effects_of
from clampid.stages.stage_kind import known_of
from kinematics.robot import RobotDescription

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["angle_table"]

ANGLES = np.deg2rad(5.0)  # between rows of a table of angle errors


def angle_table(
    model: Model, *, robot: RobotDescription | None = None, effects_from: Path | None = None
) -> pd.DataFrame:
    """Errors of joint angles over their ranges, which no table of constant numbers can hold.

    Returns
    -------
    pandas.DataFrame
        ``joint``, ``q_rad`` as the controller reports it, ``error_rad`` (arm less controller: add it before a table of
        Denavit–Hartenberg parameters is used), ``std_error_rad``, and ``extrapolated``, 1 where no pose was near.

    Raises
    ------
    ModelError
        The model has no such errors.
    """
    import pandas as pd

    nominal = robot_of(model, robot)
    stage = known_of(model.stages, "points")
    if stage is None:
        raise ModelError("expected a model with a stage poses, found none")
    parts = []
    known = effects_of(model, effects_from)
    for j, (low, high) in enumerate(zip(*ranges(nominal), strict=True)):
        q = np.zeros((round((high - low) / ANGLES) + 1, nominal.n))
        q[:, j] = np.linspace(low, high, len(q))
        found = angle_errors(stage, known, model.layout, nominal, q)
        if found.active[j]:
            columns = {
                "q_rad": q,
                "error_rad": found.error,
                "std_error_rad": found.std,
                "extrapolated": found.extrapolated,
            }
            part = pd.DataFrame({name: values[:, j] for name, values in columns.items()})
            part.insert(0, "joint", j + 1)
            parts.append(part.astype({"extrapolated": int}))
    if not parts:
        raise ModelError("expected a model with errors of joint angles (such as gear_eccentricity), found none")
    return pd.concat(parts, ignore_index=True)
