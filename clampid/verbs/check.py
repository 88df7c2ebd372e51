"""``clampid check``: what a campaign holds, what is wrong with it, and what can be identified from it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from clampid.verbs.inputs import finding_text
from clampid.verbs.options import Json, OneCampaign, Quiet
from clampid.verbs.output import Output

__all__ = ["check"]


def check(campaign: OneCampaign, json: Json = None, quiet: Quiet = False) -> None:
    """Read and validate a campaign folder; say what it holds and what can be identified from it."""
    from clampid.catalogue import catalogue
    from clampid.identify import TABLES_OF, stages_of, standard_effects
    from experiments.campaign import CampaignError, read_campaign
    from experiments.check import check_campaign, holdings
    from experiments.long_log import LONG_ROWS

    out = Output(quiet, json)
    read = read_campaign(campaign, held=LONG_ROWS)
    holds, findings = holdings(read), check_campaign(read)
    standard = standard_effects([read]) if stages_of([read]) else {}
    stages = {
        stage: {
            "tables": [t for t in TABLES_OF[stage] if t in read.tables],
            "standard": [term.label for term in terms],
            "known": sorted(name for name, effect in catalogue().items() if stage in effect.stages),
        }
        for stage, terms in standard.items()
    }
    out.say(f"{holds['campaign']}: {holds['robot']}, {holds['joints']} joints, measured by {holds['instrument']}")
    rows = [(name, f"{table['rows']}", _contents(table)) for name, table in holds["tables"].items()]
    out.table("", ("table", "rows", "what it holds"), rows, left=3)
    for stage, part in stages.items():
        out.say(f"{stage}: standard set {', '.join(part['standard'])}")
        rest = [name for name in part["known"] if name not in part["standard"]]
        out.say(f"{' ' * len(stage)}  and to be tested {', '.join(rest) or 'nothing'}")
    if not stages:
        out.say("there is no table that a model can be fitted to")
    for finding in findings:
        out.say(f"{finding.severity}: {finding_text(finding)}")
    shown = [
        {"severity": f.severity, "table": f.table, "column": f.column, "row": f.row, "message": f.message}
        for f in findings
    ]
    out.result({**holds, "stages": stages, "findings": shown})
    wrong = sum(f.severity == "error" for f in findings)
    if wrong:
        first = next(finding_text(f) for f in findings if f.severity == "error")
        more = f" (and {wrong - 1} more)" if wrong > 1 else ""
        raise CampaignError(f"{campaign}: {first}{more}")


def _contents(table: Mapping[str, Any]) -> str:
    """A table's summary in words."""
    words = []
    for key in ("poses", "visits", "replicates", "runs", "sweeps"):
        if table.get(key):
            words.append(f"{table[key]} {key}")
    words.append(f"{table['duration_s'] / 60:.0f} min")
    moved = table["joints_moved"]
    words.append(f"joints {', '.join(map(str, moved))} move" if moved else "no joint moves")
    for key, word in (
        ("targets", "targets"),
        ("orientation", "orientations"),
        ("directions", "approach directions"),
        ("velocities", "velocities"),
        ("fixture", "fixture watched"),
        ("temperatures", "temperatures"),
    ):
        value = table.get(key)
        if value:
            words.append(f"{len(value)} {word}" if isinstance(value, list) else word)
    return "; ".join(words)
