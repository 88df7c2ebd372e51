"""``clampid export``: the compensated robot as a Denavit–Hartenberg table or as URDF."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from clampid.verbs.errors import CallError
from clampid.verbs.options import ModelFile, Quiet
from clampid.verbs.output import Output, output_file

if TYPE_CHECKING:
    from kinematics.robot import RobotDescription

__all__ = ["export"]

export = typer.Typer(help="Write the compensated robot as a DH table or as URDF.", no_args_is_help=True)

Session = Annotated[int, typer.Option(min=1, help="Whose base and flange, where the model has several sessions.")]
Robot = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="The nominal robot's description, where it is not a bundled one."),
]


@export.command()
def dh(
    model: ModelFile,
    convention: Annotated[Literal["standard", "hayati"], typer.Option(help="Hayati's rows are exact.")] = "hayati",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.csv", help="Where to; stdout without it.")
    ] = None,
    session: Session = 1,
    robot: Robot = None,
    quiet: Quiet = False,
) -> None:
    """The compensated Denavit–Hartenberg table with standard errors, as CSV."""
    out = Output(quiet)
    _writable(output)

    from clampid.export import dh_table, table_text
    from clampid.model import load_model, write_text

    loaded = load_model(model)
    text = table_text(dh_table(loaded, convention, session=session - 1, robot=_robot(robot)))
    if output is None:
        sys.stdout.write(text)
        return
    write_text(output, text)
    out.say(f"table: {output}; static geometry at 20 degC, read back and equal to the model")


@export.command()
def urdf(
    model: ModelFile,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE.urdf", help="Where to.")],
    session: Session = 1,
    robot: Robot = None,
    quiet: Quiet = False,
) -> None:
    """The calibrated chain as URDF; its frame world is the instrument's."""
    out = Output(quiet)
    _writable(output)

    from clampid.export import urdf_text
    from clampid.model import load_model, write_text

    write_text(output, urdf_text(load_model(model), session=session - 1, robot=_robot(robot)))
    out.say(f"URDF: {output}; static geometry at 20 degC, read back and equal to the model")


def _robot(path: Path | None) -> RobotDescription | None:
    from kinematics.description import load_robot

    if path is not None and path.suffix.lower() not in (".toml", ".urdf"):
        raise CallError(f"--robot {path}: expected a .toml or .urdf file")
    return None if path is None else load_robot(path)


def _writable(path: Path | None) -> None:
    if path is not None:
        output_file(path)
