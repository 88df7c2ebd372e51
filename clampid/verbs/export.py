"""``clampid export``: the compensated robot as a Denavit–Hartenberg table, URDF or KUKA machine data; its dynamics."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from clampid.display import fixed
from clampid.verbs.errors import CallError
from clampid.verbs.options import EffectsFrom, Json, ModelFile, Quiet
from clampid.verbs.output import Output, output_file
from clampid.verbs.streams import write_result
from clampid.verbs.units import Units

if TYPE_CHECKING:
    from clampid.exports.exported import Exported
    from clampid.models.model import Model
    from clampid.screen import Next
    from experiments.campaign import Campaign
    from experiments.targets import Kind
    from kinematics.robot import RobotDescription

__all__ = ["export"]

export = typer.Typer(
    help="Write the robot as a DH table, URDF or KUKA machine data, or its dynamics.", no_args_is_help=True
)

Session = Annotated[int, typer.Option(min=1, help="Session whose base and flange are written.")]
Robot = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="The nominal robot's description, where it is not a bundled one."),
]
Temperature = Annotated[
    float, typer.Option(metavar="DEGC", help="Temperature of all links; another than 20 needs an identified expansion.")
]
Poses = Annotated[
    Path | None,
    typer.Option(
        "--campaign", metavar="CAMPAIGN", help="Also say what the file alone leaves of these measured points."
    ),
]


@export.command(short_help="A Denavit–Hartenberg table with standard errors.")
def dh(
    model: ModelFile,
    convention: Annotated[
        Literal["standard", "hayati"], typer.Option(help="Kind of rows; Hayati's are exact.")
    ] = "hayati",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.csv", help="File to write; stdout without it.")
    ] = None,
    layout: Annotated[
        Literal["csv", "thesis"],
        typer.Option(help="CSV for programs, or for readers, as the thesis prints its table: nominal and compensated."),
    ] = "csv",
    fit: Annotated[
        Literal["best", "static"],
        typer.Option(
            help="best: the table with which a controller errs least that knows nothing else; static: the model's "
            "geometry, where its other effects are corrected elsewhere."
        ),
    ] = "best",
    campaign: Poses = None,
    session: Session = 1,
    temperature: Temperature = 20.0,
    robot: Robot = None,
    effects_from: EffectsFrom = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """The compensated Denavit–Hartenberg table with standard errors, and what it leaves of the model."""
    out = Output(quiet, json)
    _writable(output, "a DH table" if layout == "csv" else "a printed table")

    from clampid.exports.dh_export import dh_export
    from clampid.exports.dh_layout import thesis_layout
    from clampid.models.described import robot_of
    from clampid.models.model import load_model

    loaded = load_model(model)
    nominal = robot_of(loaded, _robot(robot))
    found = dh_export(
        loaded,
        convention,
        fit=fit,
        session=session - 1,
        robot=nominal,
        temperature=temperature,
        campaign=_read(campaign),
        user_effects=effects_from,
    )
    if output is not None or json != "-":
        _written(found.text if layout == "csv" else thesis_layout(found, nominal), output)
    _by_convention(loaded, out)
    _extrapolating(loaded, temperature, out)
    further = () if output is None else _after("dh", model, output, campaign, loaded.sessions[session - 1].name)
    _report("DH table", found, output, out, further)


@export.command(short_help="Errors of joint angles over their ranges.")
def angles(
    model: ModelFile,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.csv", help="File to write; stdout without it.")
    ] = None,
    robot: Robot = None,
    effects_from: EffectsFrom = None,
    quiet: Quiet = False,
) -> None:
    """Errors of joint angles over their ranges, to be added before a DH table is used, as CSV."""
    out = Output(quiet)
    _writable(output, "a table of joint errors")

    from clampid.exports.angle_export import angle_table
    from clampid.exports.dh_export import table_text
    from clampid.models.model import load_model

    table = angle_table(load_model(model), robot=_robot(robot), effects_from=effects_from)
    if not _written(table_text(table), output) or output is None:
        return
    from clampid.verbs.export_screen import angles_screen, use_next

    out.show(angles_screen(table, output, use_next(model)))


@export.command(short_help="The calibrated chain as URDF.")
def urdf(
    model: ModelFile,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE.urdf", help="File to write.")],
    campaign: Poses = None,
    session: Session = 1,
    temperature: Temperature = 20.0,
    robot: Robot = None,
    effects_from: EffectsFrom = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """The calibrated chain as URDF, whose frame world is the instrument's, and what it leaves of the model."""
    out = Output(quiet, json)
    _writable(output, "a URDF")

    from clampid.exports.urdf_export import urdf_export
    from clampid.models.model import load_model

    loaded = load_model(model)
    found = urdf_export(
        loaded,
        session=session - 1,
        robot=_robot(robot),
        temperature=temperature,
        campaign=_read(campaign),
        user_effects=effects_from,
    )
    _written(found.text, output)
    _report("URDF", found, output, out, _after("urdf", model, output, campaign, loaded.sessions[session - 1].name))
    _extrapolating(loaded, temperature, out)


@export.command(short_help="The geometry of KUKA machine data.")
def kuka(
    model: ModelFile,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.dat", help="File to write; stdout without it.")
    ] = None,
    lever: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="From the flange to the tool's point, which is to err least; otherwise 0.2 m.",
            show_default=False,
        ),
    ] = None,
    mm: Annotated[bool, typer.Option("--mm", help="--lever is given in millimetres, not metres.")] = False,
    campaign: Poses = None,
    session: Session = 1,
    temperature: Temperature = 20.0,
    robot: Robot = None,
    effects_from: EffectsFrom = None,
    quiet: Quiet = False,
) -> None:
    """The part of KUKA machine data that is geometry, and what this form alone leaves over the joints' ranges."""
    out = Output(quiet)
    _writable(output, "KUKA machine data")
    if mm and lever is None:
        raise CallError("--mm is the unit of --lever: expected --lever MM with it")

    from clampid.exports.kuka_export import LEVER, kuka_machine_data
    from clampid.models.model import load_model

    loaded = load_model(model)
    found = kuka_machine_data(
        loaded,
        session=session - 1,
        robot=_robot(robot),
        temperature=temperature,
        lever=LEVER if lever is None else Units(millimetres=mm).metres(lever),
        campaign=_read(campaign),
        user_effects=effects_from,
    )
    _extrapolating(loaded, temperature, out)
    if not _written(found.text, output) or output is None:
        return
    from clampid.verbs.export_screen import kuka_screen

    further = _after("kuka", model, output, campaign, loaded.sessions[session - 1].name)
    out.show(kuka_screen(found, temperature, output, further))


@export.command(short_help="Base parameters of gravity and inertia as JSON.")
def dynamics(
    model: ModelFile,
    consistent: Annotated[
        bool, typer.Option("--consistent", help="Also the nearest masses and inertias that bodies can have.")
    ] = False,
    campaign: Annotated[
        Path | None, typer.Option(metavar="CAMPAIGN", help="Logs on which to say what consistency costs.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.json", help="File to write; stdout without it.")
    ] = None,
    robot: Robot = None,
    effects_from: EffectsFrom = None,
    quiet: Quiet = False,
) -> None:
    """Base parameters of gravity and inertia with standard errors, and on demand bodies that can have them, as JSON."""
    out = Output(quiet)
    _writable(output, "JSON")
    if campaign is not None and not consistent:
        raise CallError("--campaign compares the fit with the consistent arm: give --consistent too")

    import json

    from clampid.exports.dynamics_export import dynamics as identified
    from clampid.models.model import load_model
    from experiments.campaign import read_campaign

    log = None if campaign is None else read_campaign(campaign)
    found = identified(
        load_model(model), consistent=consistent, campaign=log, robot=_robot(robot), user_effects=effects_from
    )
    text = json.dumps(found, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    if not _written(text, output) or output is None:
        return
    from clampid.verbs.export_screen import dynamics_screen

    out.show(dynamics_screen(_consistent_arm(found), len(found["base_parameters"]), output, model))


def _read(folder: Path | None) -> Campaign | None:
    from experiments.campaign import read_campaign

    return None if folder is None else read_campaign(folder)


def _report(kind: str, found: Exported, output: Path | None, out: Output, further: tuple[Next, ...] = ()) -> None:
    """What was written and what it leaves; in lines on stderr where the file itself went to stdout."""
    from clampid.verbs.export_screen import export_screen

    if output is None:
        exact = f"read back within {found.difference:.1e} m of the model's"
        for line in (f"{kind}: static geometry at {found.temperature:g} degC, {exact}", *found.said):
            out.step(line)
    else:
        out.show(export_screen(kind, found, output, further))
    out.result({"file": None if output is None else str(output), **found.to_json()})


def _after(form: str, model: Path, output: Path, campaign: Path | None, name: str) -> tuple[Next, ...]:
    """What to type next: say what the file alone leaves of the fitted points, or use the whole model."""
    from clampid.screen import Next
    from clampid.verbs.export_screen import use_next
    from clampid.verbs.next_step import free_name

    if campaign is not None:
        return use_next(model)

    near = [folder for folder in (model.parent / name, Path(name)) if (folder / "campaign.toml").is_file()]
    if not near:  # the model does not say where its campaign lies
        return use_next(model)
    folder = near[0]
    target = str(free_name(output))
    command = shlex.join(["clampid", "export", form, str(model), "--campaign", str(folder), "-o", target])
    return (Next("Next, see what the file alone leaves of the measured points:", command),)


def _by_convention(model: Model, out: Output) -> None:
    """Say which numbers have no standard error because the flange is fixed by convention."""
    from clampid.role_slots import any_of_role

    if not any_of_role(model.stages["poses"].slots, "flange_frame"):
        out.step(
            "an error of the flange frame is absorbed by the target positions: the flange is kept as described, and "
            "the last row and the tool have no standard errors of their own"
        )


def _extrapolating(model: Model, temperature: float, out: Output) -> None:
    """Say for which links the file's temperature is outside the range in which expansion was identified."""
    from clampid.role_slots import any_of_role
    from clampid.verbs.findings import extrapolating_text

    stage = model.stages["poses"]
    if stage.ranges is None or not any_of_role(stage.slots, "expansion"):
        return
    beyond = stage.ranges.beyond_temperature(temperature)
    if beyond:
        out.warn(f"warning: extrapolating: {extrapolating_text([found.to_json() for found in beyond])}")


def _consistent_arm(found: Mapping[str, Any]) -> list[str]:
    """The consistent arm and its chi-square, in a few lines; none where it was not asked for."""
    if "links" not in found:
        return []
    lines = [
        f"link {link['link']}: {link['mass_kg']:.3g} kg at ({', '.join(fixed(1e3 * c, 0) for c in link['com_m'])}) mm"
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
    """Write to a file; without one to stdout, which then carries nothing else."""
    from experiments.outputs import write_text

    if path is None:
        write_result(text)
        return False
    write_text(path, text)
    return True


def _writable(path: Path | None, kind: Kind) -> None:
    if path is not None:
        output_file(path, kind)
