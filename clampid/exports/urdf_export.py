"""The compensated robot as URDF, with what it leaves of the whole model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from clampid.exports.determined import fix_undetermined
from clampid.exports.exported import EXACT, Exported, checked
from clampid.exports.form_error import POSTURES, postures
from clampid.models.calibrated import calibrated_chain
from clampid.models.described import robot_of
from clampid.models.model import Model, ModelError
from clampid.stages.rows import Array
from experiments.campaign import Campaign
from experiments.outputs import temporary_folder, write_text
from experiments.temperatures import REFERENCE_TEMPERATURE
from kinematics.poe import forward
from kinematics.robot import RobotDescription
from kinematics.urdf import read_urdf, write_urdf

__all__ = ["urdf_export", "urdf_text"]


def urdf_export(
    model: Model,
    *,
    session: int = 0,
    robot: RobotDescription | None = None,
    temperature: float = REFERENCE_TEMPERATURE,
    campaign: Campaign | None = None,
    user_effects: Path | None = None,
) -> Exported:
    """The calibrated chain as URDF, whose frame ``world`` is the instrument's, and what it leaves of the whole model.

    The file says its temperature, by how much it, read back, differs at most from the static chain over the joints'
    ranges, and what it leaves of the whole model there.

    Parameters
    ----------
    session, robot, temperature, campaign, user_effects
        See `dh_export`.

    Raises
    ------
    ModelError
        The model has no geometry, or effects that are not known; the campaign is not that of the session; or the file,
        read back, is not the chain.
    DescriptionError
        A joint is neither revolute nor prismatic.
    """
    nominal = robot_of(model, robot)
    fixed = fix_undetermined(model)
    model = fixed.model
    chain = calibrated_chain(model, session=session, robot=nominal, temperature=temperature)
    text = write_urdf(chain.screws, chain.home, chain.robot, chain.base)
    with temporary_folder() as folder:
        path = folder / "robot.urdf"
        write_text(path, text)
        back = read_urdf(path, "flange")

    def form(q: Array) -> Array:
        return np.asarray(forward(back.screws, back.flange, q))

    q = postures(nominal)
    difference = float(np.abs(form(q) - chain.flange(q)).max())
    if not difference <= EXACT:
        raise ModelError(f"the URDF, read back, differs by {difference:.2g} m from the model, more than {EXACT:g} m")
    left, measured = checked(form, model, nominal, session, temperature, campaign, user_effects)
    head, _, rest = text.partition("\n")
    found = Exported("", temperature, difference, left, measured, fixed.combinations)
    said = (
        f"clampid: static geometry at {temperature:g} degC; read back it differs by at most {difference:.1e} m "
        f"from the model's static geometry, over {POSTURES} postures in the joints' ranges",
        *found.said,
    )
    comments = "\n".join(f"<!-- {line.replace('--', '- -')} -->" for line in said)
    return replace(found, text=f"{head}\n{comments}\n{rest}")


def urdf_text(model: Model, **options: Any) -> str:
    """The file of :func:`urdf_export`, which says the ``options``."""
    return urdf_export(model, **options).text
