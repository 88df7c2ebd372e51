"""Arguments and options that several verbs share, as annotated types."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = [
    "Campaigns",
    "Effects",
    "EffectsFrom",
    "Json",
    "ModelFile",
    "OneCampaign",
    "Output",
    "Quiet",
    "Seed",
    "Verbose",
]

OneCampaign = Annotated[Path, typer.Argument(metavar="CAMPAIGN", help="A campaign folder.", show_default=False)]
Campaigns = Annotated[
    list[Path],
    typer.Argument(metavar="CAMPAIGN…", help="Campaign folders: sessions of one robot.", show_default=False),
]
ModelFile = Annotated[Path, typer.Argument(metavar="MODEL.json", help="A model file.", show_default=False)]
Output = Annotated[
    Path, typer.Option("--output", "-o", metavar="MODEL.json", help="Model file to write.", show_default=False)
]
Effects = Annotated[
    list[str] | None,
    typer.Option(
        metavar="[STAGE=]A,B,…",
        help="The effects of a stage, such as poses=geometry,backlash@joint2; may be repeated.",
        show_default=False,
    ),
]
EffectsFrom = Annotated[
    Path | None,
    typer.Option(metavar="FILE.py", help="A file with effects of your own.", show_default=False),
]
Json = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE|-", help="The result for programs; - is stdout.", show_default=False),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print no progress.", show_default=False)]
Seed = Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print the tables, too.", show_default=False)]
