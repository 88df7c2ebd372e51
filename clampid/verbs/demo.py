"""``clampid demo``: the whole loop on a virtual robot, for which nothing has to be provided."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from clampid.verbs.errors import CallError
from clampid.verbs.options import Json, Quiet, Verbose
from clampid.verbs.output import Output
from experiments.targets import check_folder, is_forced

__all__ = ["demo"]


def demo(
    seed: Annotated[int, typer.Option(min=0, help="Draws the hidden effect, the robot and the noise.")] = 1,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write.")] = Path("demo"),
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Run the whole loop on a virtual robot with an effect hidden, and write a report."""
    output = Output(quiet, json, verbose)
    if out.exists() and not out.is_dir():
        raise CallError(f"{out}: expected a folder, found a file")
    check_folder(out, kept=True)

    from clampid.loop.demo import demo as run_demo
    from clampid.loop.demo import foreign_file
    from clampid.verbs.demo_screen import demo_screen

    foreign = foreign_file(out)
    if foreign is not None and not is_forced():
        raise CallError(
            f"{out}: expected a folder without {foreign}, or one of an older demo, found what no demo wrote "
            "(--force replaces it)"
        )
    result = run_demo(out, seed, say=output.say, working=output.working)
    output.show(demo_screen(result))
    output.result(result.to_json())
