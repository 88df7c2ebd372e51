"""``clampid effect new``: the file of a user's own effect, to be completed; ``trust``: whose code may run."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clampid.verbs.options import Quiet
from clampid.verbs.output import Output, output_file

if TYPE_CHECKING:
    pass

__all__ = ["effect"]

effect = typer.Typer(help="Make an effect of your own.", no_args_is_help=True)


@effect.command(short_help="Write the file of an effect, to be completed.")
def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the effect.", show_default=False)],
    depends_on: Annotated[
        str, typer.Option(metavar="q4,dir4", help="Recorded variables that it depends on.", show_default=False)
    ],
    at: Annotated[str, typer.Option(metavar="joint4", help="Where it acts.", show_default=False)],
    stage: Annotated[
        str | None,
        typer.Option(metavar="STAGE", help="free_air, clamped or poses.", show_default="the first that has them all"),
    ] = None,
    orders: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Highest harmonic of angles, and highest power of the rest.",
            show_default="3; of several 2",
        ),
    ] = None,
    joints: Annotated[int, typer.Option(min=1, metavar="N", help="Axes that the robot has.")] = 6,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.py", help="File to write.", show_default="NAME.py")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Write the file of an effect with a given dependence; it works as it stands, and is there to be completed."""
    out = Output(quiet)
    if output is not None:
        output_file(output, "Python")

    from clampid.diagnosis.effect_new import effect_new
    from clampid.screen import Next, Screen

    variables = [part.strip() for part in depends_on.split(",")]
    path = effect_new(name, variables, at, stage=stage, orders=orders, joints=joints, path=output)
    look = Next(
        "Next, see how it is understood:", shlex.join(["clampid", "effects", name, "--effects-from", str(path)])
    )
    out.show(
        Screen(
            f"Wrote {path}, the effect {name}.",
            notes=(f"To fit it: clampid add {name} MODEL.json CAMPAIGN -o MODEL2.json --effects-from {path}",),
            next=(look,),
        )
    )


@effect.command(short_help="Let models run the code of an effect file.")
def trust(
    file: Annotated[Path, typer.Argument(metavar="FILE.py", help="A file of effects.", show_default=False)],
    remove: Annotated[bool, typer.Option("--remove", help="Trust it no longer.")] = False,
    quiet: Quiet = False,
) -> None:
    """Let models run the code of an effect file without --effects-from, as long as the file is not changed."""
    from clampid.screen import Next, Screen
    from clampid.trusted import distrust, trust_file
    from clampid.trusted import trust as trust_effect

    out = Output(quiet)
    if remove:
        out.say(f"{file} is no longer trusted." if distrust(file) else f"{file} was not trusted.")
        return
    mark = trust_effect(file)
    look = shlex.join(["clampid", "effects", "--effects-from", str(file)])
    out.show(
        Screen(
            f"Trusted {file}: a model that names this file runs it now.",
            facts=(("SHA-256", f"{mark[:16]}…"), ("listed in", str(trust_file()))),
            notes=("Once the file is changed, it has to be trusted again.",),
            next=(Next("Next, list the effects that are known with it:", look),),
        )
    )
