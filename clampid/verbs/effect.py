"""``clampid effect new``: the file of a user's own effect, to be completed."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from clampid.verbs.options import Quiet
from clampid.verbs.output import Output, output_file

if TYPE_CHECKING:
    from clampid.effect import Stage

__all__ = ["effect"]

effect = typer.Typer(help="Make an effect of your own.", no_args_is_help=True)


@effect.callback()
def _several() -> None:
    """Keep ``new`` a word of its own, though it is the only one yet."""


@effect.command()
def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Of the effect.", show_default=False)],
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
        typer.Option(metavar="N", help="Harmonics of angles, powers of the rest.", show_default="3; of several 2"),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.py", help="Where to.", show_default="NAME.py")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Write the file of an effect with a given dependence; it works as it stands, and is there to be completed."""
    out = Output(quiet)
    if output is not None:
        output_file(output)

    from clampid.diagnosis.effect_new import effect_new
    from clampid.screen import Next, Screen

    variables = [part.strip() for part in depends_on.split(",")]
    path = effect_new(name, variables, at, stage=cast("Stage | None", stage), orders=orders, path=output)
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
