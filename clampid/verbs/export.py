"""``clampid export``: the compensated robot as a Denavit–Hartenberg table, URDF or KUKA machine data; its dynamics."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from clampid.verbs.errors import CallError
from clampid.verbs.options import EffectsFrom, ModelFile, Quiet
from clampid.verbs.output import Output, output_file

if TYPE_CHECKING:
    from clampid.model import Model
    from kinematics.robot import RobotDescription

__all__ = ["export"]

export = typer.Typer(
    help="Write the robot as a DH table, URDF or KUKA machine data, or its dynamics.", no_args_is_help=True
)

Session = Annotated[int, typer.Option(min=1, help="Whose base and flange, where the model has several sessions.")]
Robot = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="The nominal robot's description, where it is not a bundled one."),
]
Temperature = Annotated[
    float, typer.Option(metavar="DEGC", help="Of all links; another than 20 needs an identified expansion.")
]


@export.command()
def dh(
    model: ModelFile,
    convention: Annotated[Literal["standard", "hayati"], typer.Option(help="Hayati's rows are exact.")] = "hayati",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.csv", help="Where to; stdout without it.")
    ] = None,
    session: Session = 1,
    temperature: Temperature = 20.0,
    robot: Robot = None,
    effects_from: EffectsFrom = None,
    quiet: Quiet = False,
) -> None:
    """The compensated Denavit–Hartenberg table with standard errors, as CSV."""
    out = Output(quiet)
    _writable(output)

    from clampid.export import dh_table, table_text
    from clampid.model import load_model

    loaded = load_model(model)
    _left_out(loaded, effects_from, out)
    table = dh_table(loaded, convention, session=session - 1, robot=_robot(robot), temperature=temperature)
    text = table_text(table)
    if not _written(text, output):
        return
    off = float(table["difference_m"].iloc[0])
    out.say(f"table: {output}; static geometry at {temperature:g} degC, read back within {off:.1e} m of the model")


@export.command()
def angles(
    model: ModelFile,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.csv", help="Where to; stdout without it.")
    ] = None,
    robot: Robot = None,
    effects_from: EffectsFrom = None,
    quiet: Quiet = False,
) -> None:
    """Errors of joint angles over their ranges, to be added before a DH table is used, as CSV."""
    out = Output(quiet)
    _writable(output)

    from clampid.export import angle_table, table_text
    from clampid.model import load_model

    text = table_text(angle_table(load_model(model), robot=_robot(robot), effects_from=effects_from))
    if not _written(text, output):
        return
    out.say(f"angle errors: {output}; arm less controller, with standard errors")


@export.command()
def urdf(
    model: ModelFile,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE.urdf", help="Where to.")],
    session: Session = 1,
    temperature: Temperature = 20.0,
    robot: Robot = None,
    effects_from: EffectsFrom = None,
    quiet: Quiet = False,
) -> None:
    """The calibrated chain as URDF; its frame world is the instrument's."""
    out = Output(quiet)
    _writable(output)

    from clampid.export import urdf_text
    from clampid.model import load_model, write_text

    loaded = load_model(model)
    _left_out(loaded, effects_from, out)
    text = urdf_text(loaded, session=session - 1, robot=_robot(robot), temperature=temperature)
    write_text(output, text)
    out.say(f"URDF: {output}; static geometry at {temperature:g} degC, read back and equal to the model")


@export.command()
def kuka(
    model: ModelFile,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.dat", help="Where to; stdout without it.")
    ] = None,
    lever: Annotated[
        float, typer.Option(metavar="M", help="From the flange to the tool's point, which is to err least.")
    ] = 0.2,
    campaign: Annotated[
        Path | None, typer.Option(metavar="CAMPAIGN", help="Poses on which to say what these data alone leave.")
    ] = None,
    session: Session = 1,
    temperature: Temperature = 20.0,
    robot: Robot = None,
    effects_from: EffectsFrom = None,
    quiet: Quiet = False,
) -> None:
    """The part of KUKA machine data that is geometry, and what this form alone leaves over the joints' ranges."""
    out = Output(quiet)
    _writable(output)

    from clampid.kuka_export import kuka_machine_data
    from clampid.model import load_model
    from experiments.campaign import read_campaign

    poses = None if campaign is None else read_campaign(campaign)
    loaded = load_model(model)
    found = kuka_machine_data(
        loaded,
        session=session - 1,
        robot=_robot(robot),
        temperature=temperature,
        lever=lever,
        left_out=_left_out(loaded, effects_from, out),
        campaign=poses,
    )
    if not _written(found.text, output):
        return
    out.say(f"machine data: {output}; static geometry at {temperature:g} degC")
    out.say(f"what this form alone leaves: {found.left}")
    out.say(f"what nominal machine data leave: {found.nominal}")
    if found.measured:
        out.say(found.measured)


@export.command()
def dynamics(
    model: ModelFile,
    consistent: Annotated[
        bool, typer.Option("--consistent", help="Also the nearest masses and inertias that bodies can have.")
    ] = False,
    campaign: Annotated[
        Path | None, typer.Option(metavar="CAMPAIGN", help="Logs on which to say what consistency costs.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.json", help="Where to; stdout without it.")
    ] = None,
    robot: Robot = None,
    effects_from: EffectsFrom = None,
    quiet: Quiet = False,
) -> None:
    """Base parameters of gravity and inertia with standard errors, and on demand bodies that can have them, as JSON."""
    out = Output(quiet)
    _writable(output)
    if campaign is not None and not consistent:
        raise CallError("--campaign compares the fit with the consistent arm: give --consistent too")

    import json

    from clampid.dynamics_export import dynamics as identified
    from clampid.model import load_model
    from experiments.campaign import read_campaign

    log = None if campaign is None else read_campaign(campaign)
    found = identified(
        load_model(model), consistent=consistent, campaign=log, robot=_robot(robot), user_effects=effects_from
    )
    text = json.dumps(found, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    if not _written(text, output):
        return
    for line in _told(found):
        out.say(line)
    out.say(f"dynamics: {output}")


def _left_out(model: Model, effects_from: Path | None, out: Output) -> list[str]:
    """Which effects of the poses a static geometry cannot hold; they are said."""
    from clampid.catalogue import with_user_effects

    effects = with_user_effects(effects_from)
    terms = model.stages["poses"].terms if "poses" in model.stages else ()
    others = dict.fromkeys(t.effect for t in terms if t.effect not in effects or effects[t.effect].family != "geometry")
    if others:
        out.step(f"not in a static geometry, and left to clampid ik: {', '.join(others)}")
    return list(others)


def _told(found: Mapping[str, Any]) -> list[str]:
    """What the consistent arm is and what it costs, in a few lines."""
    if "links" not in found:
        return [f"{len(found['base_parameters'])} base parameters"]
    lines = [
        f"link {link['link']}: {link['mass_kg']:.3g} kg at ({', '.join(f'{1e3 * c:.0f}' for c in link['com_m'])}) mm"
        for link in found["links"]
    ]
    if not found["inertia_identified"]:
        lines.append("inertias are the description's: the model has no link_inertia")
    fit, worst = found["fit"], max(found["base_parameters"], key=lambda p: abs(p["off_by_std"]))
    lines.append(
        f"what it costs: chi-square {fit['chi_square']:.3g} over {fit['base_parameters']} base parameters (noise alone "
        f"puts the true arm at about {fit['base_parameters']}); furthest off, by {abs(worst['off_by_std']):.2g} "
        f"standard errors: {worst['name']}"
    )
    if "rms_Nm" in fit:
        pairs = zip(fit["rms_Nm"], fit["consistent_rms_Nm"], strict=True)
        lines.append("rms torque of the motors, Nm: " + ", ".join(f"{a:.4g} → {b:.4g}" for a, b in pairs))
    return lines


def _robot(path: Path | None) -> RobotDescription | None:
    from kinematics.description import load_robot

    if path is not None and path.suffix.lower() not in (".toml", ".urdf"):
        raise CallError(f"--robot {path}: expected a .toml or .urdf file")
    return None if path is None else load_robot(path)


def _written(text: str, path: Path | None) -> bool:
    """Write to a file, or to stdout where there is none, where nothing else is to be said."""
    from clampid.model import write_text

    if path is None:
        sys.stdout.write(text)
        return False
    write_text(path, text)
    return True


def _writable(path: Path | None) -> None:
    if path is not None:
        output_file(path)
