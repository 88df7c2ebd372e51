"""``clampid link-files``: what goes onto a controller so that the suite can move and read the robot."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from clampid.verbs.errors import CallError
from clampid.verbs.options import Quiet
from clampid.verbs.output import Output
from experiments.targets import check_folder

__all__ = ["link_files"]


def link_files(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder to write.")],
    robot: Annotated[str, typer.Option(help="A bundled robot, or the path of a description.")] = "kuka_kr20_r1810",
    port: Annotated[int, typer.Option(help="Of the motion channel; the state channel has the next one.")] = 54600,
    address: Annotated[
        str,
        typer.Option(metavar="IP", help="The controller listens there only.", show_default="all of its addresses"),
    ] = "",
    listener: Annotated[
        str,
        typer.Option(metavar="IP", help="Where an RSI stream is to go.", show_default="to be put into the file"),
    ] = "",
    quiet: Quiet = False,
) -> None:
    """Write the files for a KUKA controller: EthernetKRL configs, KRL programs, an RSI config, and how to use them."""
    out = Output(quiet)
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise CallError(f"{output}: expected a new or empty folder, found something there")
    check_folder(output)

    from clampid.screen import Next, Screen
    from experiments.links.files import link_files as written
    from experiments.outputs import new_folder
    from kinematics.description import load_robot

    description = load_robot(robot)
    try:
        files = written(description, port, address, listener)
    except ValueError as error:
        raise CallError(f"link-files: {error}") from None
    with new_folder(output) as folder:
        for name, text in files.items():
            (folder / name).write_bytes(text.encode("ascii"))
    facts = tuple((name, f"{len(text)} bytes") for name, text in files.items())
    read_me = shlex.quote(str(output / "README.txt"))
    out.show(
        Screen(
            f"Wrote the controller's side of the links of {description.title} to {output}. Verified on the virtual "
            "controller only.",
            None,
            facts,
            next=(Next("Next, read what goes where, and how to try it:", f"cat {read_me}"),),
        )
    )
