"""``clampid base``: where the base is, from circles traced by joints 1 and 2, or from features touched with a tip."""

from __future__ import annotations

import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clampid.display import length, number, quantity, with_error
from clampid.screen import Next, Screen
from clampid.verbs.errors import CallError
from clampid.verbs.inputs import read_checked
from clampid.verbs.next_step import free_name
from clampid.verbs.options import EffectsFrom, Json, Quiet, Verbose
from clampid.verbs.output import Output

if TYPE_CHECKING:
    from clampid.base_frames.base_frame import BaseFrame
    from clampid.stages.rows import Array

__all__ = ["base"]

AXES = ("x", "y", "z")
AXES_TURNED_ABOUT = ("about x", "about y", "about z")
TAKEN_OUT = "Bias: what deflection would have added; it is taken out."
NOTES = ("Bias and standard errors are along and about the base's own axes; turns are those of Rz Ry Rx.",)


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
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Find the base frame from circles of joints 1 and 2 or from touches, corrected for what the weight bends."""
    out = Output(quiet, json, verbose)
    if rigid and model is not None:
        raise CallError("--rigid corrects nothing: expected no --model with it")

    from clampid.base_frames.base_frame import base_from_circles
    from clampid.models.model import load_model

    if campaign.suffix == ".toml" and not campaign.is_dir():
        _touched(campaign, model, rigid, effects_from, out)
        return
    loaded = None if model is None else load_model(model)
    with out.working("reading"):
        (read,) = read_checked([campaign], out)
    with out.working("fitting circles"):
        found = base_from_circles(read, loaded, rigid=rigid, user_effects=effects_from)
    _show(found, campaign, rigid, out)
    out.result(found.to_json())


def _touched(path: Path, file: Path | None, rigid: bool, effects_from: Path | None, out: Output) -> None:
    from clampid.base_frames.touched_base import base_from_touches
    from clampid.models.model import load_model
    from experiments.touched import read_touched

    model = None if file is None else load_model(file)
    with out.working("reading"):
        touched = read_touched(path)
    with out.working("fitting touches"):
        found = base_from_touches(touched, model, rigid=rigid, user_effects=effects_from)
    shares = {name: std for name, std in found.sources.items() if any(std > 0)}
    rows = [(name, *(number(1e6 * v) for v in (*std[3:], *std[:3]))) for name, std in shares.items()]
    out.table("", ("± std by", "x [µm]", "y", "z", "about x [µrad]", "y", "z"), rows)
    counts = [(name, f"{count}", length(rms)) for name, (count, rms) in found.features.items()]
    out.table("", ("feature", "touches", "rms"), counts)
    raised = f"; standard errors were raised by {math.sqrt(found.scale):.2f}" if found.scale > 1 else ""
    touches = sum(count for count, _ in found.features.values())
    agree = f"rms {length(found.rms)}; chi-square {found.chi2:.1f} over {found.freedom} degrees of freedom{raised}"
    back = "" if rigid else f"; tip put back by up to {length(found.put_back)}"
    facts = (
        *_frame(found.base, found.std, found.bias, rigid),
        ("residuals", agree),
        ("arm", f"{found.arm}{back}"),
    )
    if found.outliers:
        out.warn(f"warning: far from their features, left out: rows {', '.join(map(str, found.outliers))}")
    keep = shlex.join(
        ["clampid", "base", str(path), *_given(file, rigid), "--json", str(free_name(path.with_name("base.json")))]
    )
    out.show(
        Screen(
            f"Found the base in the frame of the cell, from {touches} touches.",
            facts=facts,
            notes=NOTES if rigid else (TAKEN_OUT, *NOTES),
            more="Errors by source, and features: --verbose, --json FILE.",
            next=(Next("Next, keep it for programs:", keep),),
        )
    )
    out.result(found.to_json())


def _show(found: BaseFrame, campaign: Path, rigid: bool, out: Output) -> None:
    angle = with_error(found.between[0], found.std[6], "rad")
    apart = with_error(found.between[1], found.std[7], "m")
    back = "" if rigid else f"; points were put back by up to {length(found.deflection)}"
    count = sum(len(c.rows) for c in found.circles)
    if found.outliers:
        out.warn(f"warning: on no circle, left out: rows {', '.join(map(str, found.outliers))}")
    fit = shlex.join(["clampid", "identify", str(campaign), "-o", str(free_name(Path("model.json")))])
    out.show(
        Screen(
            f"Found the base in the instrument's frame, from {len(found.circles)} circles, {count} points.",
            facts=(
                *_frame(found.base, found.std, found.bias, rigid),
                ("axes 1, 2", f"beyond the description: angle {angle}, distance {apart}"),
                ("residuals", f"rms {length(found.rms)} from the circles"),
                ("springs", f"{found.springs}{back}"),
            ),
            notes=NOTES if rigid else (TAKEN_OUT, *NOTES),
            next=(Next("Next, find the base with everything else:", fit),),
        )
    )


def _frame(base: Array, std: Array, bias: Array, rigid: bool) -> list[tuple[str, str]]:
    """A frame with its standard errors, and its bias without the correction; both (w, v)."""
    from kinematics.fixed_angles import roll_pitch_yaw

    position, angles = base[:3, 3], roll_pitch_yaw(base[:3, :3])
    places = [f"{1e3 * position[k]:.4f} mm" for k in range(3)]
    turns = [f"{math.degrees(angles[k]):.6f} deg" for k in range(3)]
    out = []
    for names, values, unit, at in ((AXES, places, "m", 3), (AXES_TURNED_ABOUT, turns, "rad", 0)):
        for k, name in enumerate(names):
            bias_text, std_text, symbol = quantity(bias[at + k], std[at + k], unit)
            taken = "" if rigid else f"; bias {bias_text} {symbol}"
            out.append((name, f"{values[k]} ± {std_text} {symbol}{taken}"))
    return out


def _given(model: Path | None, rigid: bool) -> list[str]:
    """The options of this call, for the next one."""
    return ["--rigid"] if rigid else [] if model is None else ["--model", str(model)]
