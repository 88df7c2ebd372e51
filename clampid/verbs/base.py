"""``clampid base``: where the base is, from circles traced by joints 1 and 2."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clampid.verbs.errors import CallError
from clampid.verbs.inputs import read_checked
from clampid.verbs.options import EffectsFrom, Json, OneCampaign, Quiet
from clampid.verbs.output import Output
from clampid.verbs.units import length, quantity

if TYPE_CHECKING:
    from clampid.base_frame import BaseFrame

__all__ = ["base"]

AXES = ("x", "y", "z")


def base(
    campaign: OneCampaign,
    model: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL.json", help="Whose springs and loads; without it, the description's.", show_default=False
        ),
    ] = None,
    rigid: Annotated[bool, typer.Option("--rigid", help="Correct nothing: the frame stays biased.")] = False,
    effects_from: EffectsFrom = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Find the base frame from circles traced by joints 1 and 2, corrected for what the arm's weight bends."""
    out = Output(quiet, json)
    if rigid and model is not None:
        raise CallError("--rigid corrects nothing: expected no --model beside it")

    from clampid.base_frame import base_from_circles
    from clampid.model import load_model

    loaded = None if model is None else load_model(model)
    with out.working("reading"):
        (read,) = read_checked([campaign], out)
    with out.working("fitting circles"):
        found = base_from_circles(read, loaded, rigid=rigid, user_effects=effects_from)
    _show(found, rigid, out)
    out.result(found.to_json())


def _show(found: BaseFrame, rigid: bool, out: Output) -> None:
    from kinematics.screws import roll_pitch_yaw

    position, angles = found.base[:3, 3], roll_pitch_yaw(found.base[:3, :3])
    std, bias = found.std, found.bias
    rows: list[tuple[str, ...]] = [
        (name, f"{1e3 * position[k]:.4f} mm", *quantity(bias[3 + k], std[3 + k], "m")) for k, name in enumerate(AXES)
    ]
    rows += [
        (f"turn about {name}", f"{math.degrees(angles[k]):.6f} deg", *quantity(bias[k], std[k], "rad"))
        for k, name in enumerate(AXES)
    ]
    columns = ["base in the instrument's frame", "", "bias taken out", "± std", "unit"]
    if rigid:
        rows, columns = [(*row[:2], *row[3:]) for row in rows], [*columns[:2], *columns[3:]]
    out.table("", columns, rows)
    out.say("bias and standard errors are along and about the base's own axes; turns are those of Rz Ry Rx")
    angle, angle_std, angle_unit = quantity(found.between[0], std[6], "rad")
    apart, apart_std, apart_unit = quantity(found.between[1], std[7], "m")
    out.say(
        f"axes 1 and 2, beyond the description: angle {angle} ± {angle_std} {angle_unit}, distance {apart} ± "
        f"{apart_std} {apart_unit}"
    )
    count = sum(len(c.rows) for c in found.circles)
    out.say(f"{len(found.circles)} circles, {count} points, rms {length(found.rms)} from their circles")
    back = "" if rigid else f"; points were put back by up to {length(found.deflection)}"
    out.say(f"springs: {found.springs}{back}")
    if found.outliers:
        out.warn(f"warning: on no circle, left out: rows {', '.join(map(str, found.outliers))}")
