"""``clampid import``: a campaign from tables as an instrument wrote them."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from clampid.verbs.errors import CallError
from clampid.verbs.options import Json, Quiet
from clampid.verbs.output import Output

__all__ = ["import_table"]


def import_table(
    mapping: Annotated[
        Path, typer.Argument(metavar="MAPPING.toml", help="Which column is what, in which unit.", show_default=False)
    ],
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE…", help="Tables as the instrument wrote them.", show_default=False)
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="CAMPAIGN", help="A new folder.", show_default=False)
    ],
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Make a campaign of tables of columns, by a mapping; repeated samples become medians with their scatter."""
    out = Output(quiet, json)
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise CallError(f"{output}: expected a new or empty folder, found something there")

    from clampid.verbs.inputs import read_checked
    from experiments.campaign import write_campaign
    from experiments.errors import CampaignError
    from experiments.mapping import import_tables, read_mapping
    from kinematics.description import DescriptionError, load_robot

    read = read_mapping(mapping)
    try:
        robot = load_robot(str(read.campaign.get("robot", "")), relative_to=mapping.parent)
    except DescriptionError as error:
        raise CampaignError(f"{mapping}, key campaign.robot: {error}") from error
    table = import_tables(read, files, robot.n)
    header = dict(read.campaign)
    if Path(str(header["robot"])).suffix:
        header["robot"] = str((mapping.parent / str(header["robot"])).resolve())
    # Looked at in a place of its own first, so that a campaign that cannot be right is never written.
    with tempfile.TemporaryDirectory() as folder:
        read_checked([write_campaign(Path(folder) / "import", header, {read.table: table.frame}, "csv")], out)
    write_campaign(output, header, {read.table: table.frame}, "csv")
    out.say(f"campaign: {output}; {read.table}, {len(table.frame)} rows of {table.samples} samples")
    if table.scatter is not None:
        out.say("scatter of one sample, x, y, z: " + ", ".join(f"{1e6 * s:.3g}" for s in table.scatter) + " um")
    out.result(
        {
            "campaign": str(output),
            "table": read.table,
            "rows": len(table.frame),
            "samples": table.samples,
            "scatter_m": table.scatter,
        }
    )
