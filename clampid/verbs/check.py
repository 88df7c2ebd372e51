"""``clampid check``: what a campaign holds, what is wrong with it, and what can be identified from it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

import typer

from clampid.verbs.check_screen import check_screen, contents
from clampid.verbs.inputs import finding_text
from clampid.verbs.options import Json, OneCampaign, Quiet, Verbose
from clampid.verbs.output import Output

if TYPE_CHECKING:
    from clampid.effect import Effect, Stage
    from experiments.campaign import Campaign

__all__ = ["check"]


def check(
    campaign: OneCampaign,
    iso9283: Annotated[
        bool, typer.Option("--iso9283", help="Accuracy and repeatability of the robot itself, from returns to poses.")
    ] = False,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Read and validate a campaign folder; say what it holds and what can be identified from it."""
    from clampid.catalogue import catalogue
    from clampid.identification.identify import stages_of, standard_effects
    from clampid.stages.stage_kind import kind_of
    from clampid.verbs.screens import more_poses
    from experiments.campaign import CampaignError, read_campaign
    from experiments.checks.check import check_campaign, holdings
    from experiments.long_log import LONG_ROWS

    out = Output(quiet, json, verbose)
    read = read_campaign(campaign, rows_in_memory=LONG_ROWS)
    holds, findings = holdings(read), check_campaign(read, fits=not iso9283)
    standard = standard_effects([read]) if stages_of([read]) else {}
    stages: dict[str, Any] = {
        stage: {
            "tables": [t for t in kind_of(stage).tables if t in read.tables],
            "standard": [term.label for term in terms],
            "known": sorted(name for name, effect in catalogue().items() if kind_of(stage).has(effect)),
            "only_asked": sorted(
                n for n, e in catalogue().items() if kind_of(stage).has(e) and _only_asked(e, stage, read)
            ),
        }
        for stage, terms in standard.items()
    }
    out.say(f"{holds['campaign']}: {holds['robot']}, {holds['joints']} joints, measured by {holds['instrument']}")
    rows = [(name, f"{table['rows']}", contents(table)) for name, table in holds["tables"].items()]
    out.table("", ("table", "rows", "what it holds"), rows, left=3)
    for line in _stated(read):
        out.say(f"known beforehand: {line}")
    for stage, part in stages.items():
        out.say(f"{stage}: standard set {', '.join(part['standard'])}")
        asked = [name for name in part["only_asked"] if name not in part["standard"]]
        rest = [name for name in part["known"] if name not in (*part["standard"], *asked)]
        out.say(f"{' ' * len(stage)}  and to be tested {', '.join(rest) or 'nothing'}")
        if asked:
            out.say(f"{' ' * len(stage)}  and only where asked for by name {', '.join(asked)}")
    if not stages:
        out.say("there is no table that a model can be fitted to")
    for finding in findings:
        out.say(f"{finding.severity}: {finding_text(finding)}")
    shown = [
        {"severity": f.severity, "table": f.table, "column": f.column, "row": f.row, "message": f.message}
        for f in findings
    ]
    wrong = sum(f.severity == "error" for f in findings)
    measured = {} if wrong or not iso9283 else _repeated(read, out)
    fits = not iso9283 or all(f.severity != "error" for f in check_campaign(read, fits=True))
    plan = () if fits else more_poses(read, campaign)
    out.show(check_screen(holds, stages, shown, campaign, measured, list(_stated(read)), plan))
    out.result({**holds, "stages": stages, "findings": shown, **measured})
    if wrong:
        first = next(finding_text(f) for f in findings if f.severity == "error")
        more = f" (and {wrong - 1} more)" if wrong > 1 else ""
        raise CampaignError(f"{campaign}: {first}{more}")


def _repeated(campaign: Campaign, out: Output) -> dict[str, Any]:
    """Metrics of ISO 9283 of points, and the repeatability along one line of distances."""
    from dataclasses import asdict

    from clampid.verbs.errors import CallError
    from experiments.line_repeatability import line_repeatability

    points = _iso9283(campaign, out)
    line = line_repeatability(campaign.tables["distances"]) if "distances" in campaign.tables else None
    if not points and "distances" not in campaign.tables:
        raise CallError(f"--iso9283: expected a table poses, verification or distances, {campaign.name} has none")
    along = {} if "distances" not in campaign.tables else {"along_a_line": None if line is None else asdict(line)}
    return {"iso9283": points, **along}


def _iso9283(campaign: Campaign, out: Output) -> dict[str, Any]:
    """Metrics of the uncorrected robot, for each table of poses."""
    import numpy as np

    from clampid.catalogue import catalogue
    from clampid.comparison.attained import as_sent
    from clampid.comparison.attained import iso9283 as metrics_of
    from clampid.stages.layout import layout_of
    from clampid.stages.pose_rows import pose_rows
    from clampid.verbs.placing import show_iso9283
    from experiments.measures.metrics import norm_metrics

    found: dict[str, Any] = {}
    for table in ("poses", "verification"):
        if table in campaign.tables:
            rows = pose_rows([campaign], layout_of([campaign]), table).points
            sent = as_sent(rows, catalogue())
            norms = np.linalg.norm(sent.residual[rows.used[:, 0], :3], axis=1)
            found[table] = metrics_of(rows, sent.residual) | {"universal": norm_metrics(norms)}
            places = campaign.tables[table][["pose", "target"]].drop_duplicates()
            numbers = len(places) * sent.residual.shape[1]
            if numbers <= sent.fitted:
                _leave_out_accuracy(found[table])
            show_iso9283(table, found[table], out)
            if sent.fitted < numbers:
                out.say(
                    f"{table}: base and targets are fitted to {numbers} numbers and take up {sent.fitted} of them: "
                    "the larger that share, the more AP comes out too small"
                )
    return found


def _leave_out_accuracy(found: dict[str, Any]) -> None:
    """Move AP of a table's metrics to what is not determinable: base and targets fit so few places exactly."""
    for kind in ("position", "orientation"):
        if kind in found and found[kind].pop("AP", None) is not None:
            found[kind]["not_determinable"]["AP"] = "base and targets, fitted to so few poses, fit them exactly"


def _stated(campaign: Campaign) -> Iterator[str]:
    """What is known beforehand, in words."""
    from clampid.display import readable

    stated = campaign.stated
    if stated.base is not None:
        known = [
            f"{name} to {readable(std, unit)}" if math.isfinite(std) else f"{name} not known"
            for names, stds, unit in (
                ("xyz", stated.base.position_std, "m"),
                (("roll", "pitch", "yaw"), stated.base.rpy_std, "rad"),
            )
            for name, std in zip(names, stds.tolist(), strict=True)
        ]
        yield f"base in the instrument's frame, {', '.join(known)}"
    for name, target_std in stated.targets_std.items():
        yield f"target {name} to {', '.join(readable(s, 'm') for s in dict.fromkeys(target_std.tolist()))}"
    for d in stated.distances:
        yield f"{d.between[0]} to {d.between[1]}: {1e3 * d.value:.10g} mm, to {readable(d.std, 'm')}"
    for name, sensor in stated.sensors.items():
        yield f"sensor {name}: " + ("not used" if sensor.at == "none" else f"at {sensor.at}, weight {sensor.weight:g}")


def _only_asked(effect: Effect, stage: Stage, campaign: Campaign) -> bool:
    """Whether diagnosis of a stage leaves this effect out on this robot and these tables."""
    from clampid.stages.stage_kind import kind_of

    kinds = {joint.kind for joint in campaign.robot.joints}
    ranged = "distances" in campaign.tables or "anchor_way" not in effect.needs
    shown_by = effect.search.shown_by or stage
    unseen = shown_by != stage and not any(t in campaign.tables for t in kind_of(shown_by).tables)
    return effect.search.opt_in or effect.search.joint_kind not in (None, *kinds) or not ranged or unseen
