"""``clampid simulate``: a campaign measured on the virtual robot."""

from __future__ import annotations

import os
import shlex
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from clampid.verbs.errors import CallError
from clampid.verbs.options import Json, Quiet, Seed
from clampid.verbs.output import Output, output_file
from experiments.targets import check_folder

__all__ = ["simulate"]


class FileFormat(StrEnum):
    """How the tables are stored."""

    CSV = "csv"
    PARQUET = "parquet"


def simulate(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="CAMPAIGN", help="Folder to write.")],
    robot: Annotated[str, typer.Option(help="A bundled robot, or the path of a description.")] = "kuka_kr20_r1810",
    hide: Annotated[
        list[str] | None,
        typer.Option(
            metavar="EFFECT[@jointN][:MAGNITUDE],…",
            help="Effects to hide, with their places and sizes.",
            show_default=False,
        ),
    ] = None,
    seed: Seed = 0,
    session: Annotated[
        int,
        typer.Option(min=1, metavar="N", help="The robot of this seed on another day, measured from elsewhere."),
    ] = 1,
    poses: Annotated[int, typer.Option(help="Number of poses.")] = 250,
    tables: Annotated[
        str | None,
        typer.Option(metavar="poses,…", help="Only these; all that the robot allows otherwise.", show_default=False),
    ] = None,
    file_format: Annotated[
        FileFormat, typer.Option("--format", help="File format of the tables.")
    ] = FileFormat.PARQUET,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Measure a campaign on the virtual robot; what was hidden goes beside the folder, never into it."""
    out = Output(quiet, json)
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise CallError(f"{output}: expected a new or empty folder, found something there")
    check_folder(output)

    from clampid.screen import Next, Screen
    from experiments.simulate import hidden_file
    from experiments.simulate import simulate as measure

    output_file(hidden_file(output), "JSON")

    only = None if tables is None else [name.strip() for name in tables.split(",")]
    items = [part.strip() for text in hide or () for part in text.split(",")]
    with out.working("measuring on the virtual robot"):
        measure(
            output, robot, items, seed=seed, session=session, poses=poses, tables=only, file_format=file_format.value
        )
    ask = shlex.join(["clampid", "check", str(output)])
    hidden = hidden_file(output) if output.is_absolute() else os.path.relpath(hidden_file(output))
    facts = (("campaign", str(output)), ("what was hidden", str(hidden)))
    out.show(
        Screen(
            f"Measured a campaign on the virtual robot {robot}.",
            None,
            facts,
            next=(Next("Next, look at what it holds:", ask),),
        )
    )
    given = {"robot": robot, "seed": seed, "session": session}
    out.result({"campaign": str(output), "hidden_file": str(hidden_file(output)), **given})
