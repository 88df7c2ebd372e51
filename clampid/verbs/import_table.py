"""``clampid import``: a campaign from tables as an instrument wrote them."""

from __future__ import annotations

import shlex
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from clampid.verbs.errors import CallError
from clampid.verbs.options import Json, Quiet
from clampid.verbs.output import Output
from experiments.targets import check_folder

if TYPE_CHECKING:
    from experiments.campaign import Campaign
    from experiments.checks.finding import Finding
    from experiments.foreign import Imported, Mapping
    from experiments.header import Header
    from experiments.pairing import Pairing

__all__ = ["import_table"]

MAX_REASONS = 5  # reasons shown for stops that are left out


def import_table(
    mapping: Annotated[
        Path, typer.Argument(metavar="MAPPING.toml", help="Which column is what, in which unit.", show_default=False)
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="CAMPAIGN", help="A new folder.", show_default=False)
    ],
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="FILE…",
            help="Tables as the instrument wrote them, where the mapping does not name them; with [pairing] the "
            "robot's log last.",
            show_default=False,
        ),
    ] = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Make a campaign from tables of an instrument or a controller, by a mapping; repeated samples become medians."""
    out = Output(quiet, json)
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise CallError(f"{output}: expected a new or empty folder, found something there")
    check_folder(output)

    from clampid.screen import Next, Screen
    from experiments.campaign import write_campaign
    from experiments.foreign import import_tables, read_mapping

    read = read_mapping(mapping, files or ())
    header = _header(read)
    tables = import_tables(read, header.robot, tuple(header.targets))
    for table in tables:
        for note in table.notes:
            out.warn(f"note: {table.table}: {note}")
    content = dict(read.campaign)
    if Path(str(content["robot"])).suffix:
        content["robot"] = str((mapping.parent / str(content["robot"])).resolve())
    _look_at(_campaign(content, tables), mapping, tables, out)
    write_campaign(output, content, {table.table: table.frame for table in tables}, "csv")
    from clampid.display import number

    facts = []
    for table in tables:
        facts.append((table.table, f"{len(table.frame)} rows of {table.samples} read"))
        if table.scatter is not None:
            scatter = ", ".join(number(1e6 * s) for s in table.scatter)
            facts.append(("", f"scatter of one sample along x, y, z: {scatter} µm"))
        if table.pairing is not None:
            facts += _pairing_facts(table.pairing)
    ask = Next("Next, look at what it holds:", shlex.join(["clampid", "check", str(output)]))
    out.show(Screen(f"Wrote the campaign {output}.", facts=tuple(facts), next=(ask,)))
    out.result({"campaign": str(output), "tables": {table.table: _json(table) for table in tables}})


def _json(table: Imported) -> dict[str, Any]:
    rows = {"rows": len(table.frame), "samples": table.samples}
    out: dict[str, Any] = {**rows, "scatter_m": table.scatter, "notes": list(table.notes)}
    if table.pairing is not None:
        found = table.pairing
        out["pairing"] = {
            "pairs": len(found.pairs), "stops": list(found.stops), "clock": asdict(found.clock),
            "left_out": [asdict(one) for one in found.left_out], "geometry_rms_m": found.geometry_rms_m,
        }  # fmt: skip
    return out


def _pairing_facts(pairing: Pairing) -> list[tuple[str, str]]:
    """The result of pairing two logs, in a few lines."""
    from clampid.display import error_text, with_error

    clock, (ours, theirs) = pairing.clock, pairing.stops
    offset = f"{clock.offset_s:.3f} ± {clock.offset_std_s:.2g} s at {clock.middle_s:.0f} s of the instrument's clock"
    drift = with_error(1e6 * clock.drift, 1e6 * clock.drift_std, "")
    facts = [
        ("pairs", f"{len(pairing.pairs)}, of {ours} stops of the instrument and {theirs} of the robot"),
        ("robot's clock", f"instrument's + {offset}"),
        ("drift", f"{drift} ppm, from {clock.events} starts and ends"),
    ]
    if pairing.geometry_rms_m is not None:
        facts.append(("geometry", f"rms {error_text(pairing.geometry_rms_m, 'm')} about the nominal arm"))
    counts = Counter(f"{one.log}: {one.reason}" for one in pairing.left_out)
    for reason, count in counts.most_common(MAX_REASONS):
        facts.append(("left out", f"{count} of {reason}"))
    if len(counts) > MAX_REASONS:
        facts.append(("left out", f"{len(counts) - MAX_REASONS} further reasons: --json lists all"))
    return facts


def _header(mapping: Mapping) -> Header:
    """What ``campaign.toml`` shall say, checked; errors name the mapping and its keys."""
    from experiments.errors import CampaignError
    from experiments.header import FORMAT, parse_header

    names = {table.table: f"{table.table}.csv" for table in mapping.tables}
    said = {key: value for key, value in mapping.campaign.items() if key not in ("format", "tables")}
    try:
        return parse_header({**said, "format": FORMAT, "tables": names}, mapping.path)
    except CampaignError as error:
        raise CampaignError(str(error).replace(f"{mapping.path}, key ", f"{mapping.path}, key campaign.", 1)) from error


def _campaign(header: dict[str, Any], tables: tuple[Imported, ...]) -> Campaign:
    """The campaign as it would be read, from a place of its own: one that cannot be right is never written."""
    from experiments.campaign import read_campaign, write_campaign
    from experiments.outputs import temporary_folder

    with temporary_folder() as folder:
        write_campaign(folder / "import", header, {table.table: table.frame for table in tables}, "csv")
        return read_campaign(folder / "import")


def _look_at(campaign: Campaign, mapping: Path, tables: tuple[Imported, ...], out: Output) -> None:
    """Print warnings; refuse numbers that contradict the mapping's units. Rows are those of the files."""
    from experiments.campaign import CampaignError
    from experiments.checks.check import check_campaign

    sources = {table.table: table.source for table in tables}

    def words(finding: Finding) -> str:
        where = finding.table if finding.column is None else f"{finding.table}, column {finding.column}"
        if finding.row is not None and finding.table in sources:
            where += f", from {sources[finding.table].words(finding.row - 1)}"
        return f"{mapping}: {where}: {finding.message}"

    findings = check_campaign(campaign)
    for finding in findings:
        if finding.severity == "warning":
            out.warn(f"warning: {words(finding)}")
    wrong = [words(finding) for finding in findings if finding.severity == "error"]
    if wrong:
        raise CampaignError("; ".join(wrong))
