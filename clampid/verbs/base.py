"""``clampid base``: where the base is, from circles traced by joints 1 and 2, or from features touched with a tip."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clampid.display import length, quantity
from clampid.verbs.errors import CallError
from clampid.verbs.inputs import read_checked
from clampid.verbs.options import EffectsFrom, Json, Quiet
from clampid.verbs.output import Output

if TYPE_CHECKING:
    from clampid.base_frames.base_frame import BaseFrame
    from clampid.models.model import Model
    from clampid.stages.rows import Array

__all__ = ["base"]

AXES = ("x", "y", "z")


def base(
    campaign: Annotated[
        Path,
        typer.Argument(
            metavar="CAMPAIGN|TOUCHED.toml",
            help="A campaign folder with circles, or a file of touches.",
            show_default=False,
        ),
    ],
    model: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL.json",
            help="Model whose springs and loads are used; otherwise the description's.",
            show_default=False,
        ),
    ] = None,
    rigid: Annotated[
        bool, typer.Option("--rigid", help="Do not correct for deflection: the frame stays biased.")
    ] = False,
    effects_from: EffectsFrom = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Find the base frame from circles of joints 1 and 2 or from touches, corrected for what the weight bends."""
    out = Output(quiet, json)
    if rigid and model is not None:
        raise CallError("--rigid corrects nothing: expected no --model with it")

    from clampid.base_frames.base_frame import base_from_circles
    from clampid.models.model import load_model

    loaded = None if model is None else load_model(model)
    if campaign.suffix == ".toml" and not campaign.is_dir():
        _touched(campaign, loaded, rigid, effects_from, out)
        return
    with out.working("reading"):
        (read,) = read_checked([campaign], out)
    with out.working("fitting circles"):
        found = base_from_circles(read, loaded, rigid=rigid, user_effects=effects_from)
    _show(found, rigid, out)
    out.result(found.to_json())


def _touched(path: Path, model: Model | None, rigid: bool, effects_from: Path | None, out: Output) -> None:
    from clampid.base_frames.touched_base import base_from_touches
    from experiments.touched import read_touched

    with out.working("reading"):
        touched = read_touched(path)
    with out.working("fitting touches"):
        found = base_from_touches(touched, model, rigid=rigid, user_effects=effects_from)
    _show_frame(found.base, found.std, found.bias, rigid, "base in the frame of the cell", out)
    shares = {name: std for name, std in found.sources.items() if any(std > 0)}
    rows = [(name, *(f"{1e6 * v:.3g}" for v in (*std[3:], *std[:3]))) for name, std in shares.items()]
    out.table("", ("± std by", "x [µm]", "y", "z", "about x [µrad]", "y", "z"), rows)
    counts = [(name, f"{count}", length(rms)) for name, (count, rms) in found.features.items()]
    out.table("", ("feature", "touches", "rms"), counts)
    raised = f"; standard errors were raised by {math.sqrt(found.scale):.2f}" if found.scale > 1 else ""
    out.say(
        f"{sum(count for count, _ in found.features.values())} touches, rms {length(found.rms)}; chi-square "
        f"{found.chi2:.1f} over {found.freedom} degrees of freedom{raised}"
    )
    back = "" if rigid else f"; tip put back by up to {length(found.put_back)}"
    out.say(f"arm: {found.arm}{back}")
    if found.outliers:
        out.warn(f"warning: far from their features, left out: rows {', '.join(map(str, found.outliers))}")
    out.result(found.to_json())


def _show(found: BaseFrame, rigid: bool, out: Output) -> None:
    std = found.std
    _show_frame(found.base, std, found.bias, rigid, "base in the instrument's frame", out)
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


def _show_frame(base: Array, std: Array, bias: Array, rigid: bool, title: str, out: Output) -> None:
    """A frame with its standard errors and what it would be off by if nothing were put back; both (w, v)."""
    from kinematics.screws import roll_pitch_yaw

    position, angles = base[:3, 3], roll_pitch_yaw(base[:3, :3])
    rows: list[tuple[str, ...]] = [
        (name, f"{1e3 * position[k]:.4f} mm", *quantity(bias[3 + k], std[3 + k], "m")) for k, name in enumerate(AXES)
    ]
    rows += [
        (f"turn about {name}", f"{math.degrees(angles[k]):.6f} deg", *quantity(bias[k], std[k], "rad"))
        for k, name in enumerate(AXES)
    ]
    columns = [title, "", "bias taken out", "± std", "unit"]
    if rigid:
        rows, columns = [(*row[:2], *row[3:]) for row in rows], [*columns[:2], *columns[3:]]
    out.table("", columns, rows)
    out.say("bias and standard errors are along and about the base's own axes; turns are those of Rz Ry Rx")
