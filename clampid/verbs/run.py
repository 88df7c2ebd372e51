"""``clampid run``: a plan becomes a campaign, on a robot."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from clampid.verbs.errors import CallError
from clampid.verbs.options import Json, Quiet
from clampid.verbs.output import Output

if TYPE_CHECKING:
    from clampid.screen import Next
    from experiments.campaign import Campaign
    from experiments.plans.model import Plan
    from experiments.runs.people import Person
    from experiments.runs.runner import Asked, Outcome

__all__ = ["run"]

STOPPED = 3
"""Exit code: stopped safely before the end."""


def run(
    plan_file: Annotated[
        Path, typer.Argument(metavar="PLAN.toml", help="What clampid plan wrote.", show_default=False)
    ],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="CAMPAIGN", help="Folder: new, or a campaign that gets these tables."),
    ],
    link: Annotated[
        str | None,
        typer.Option(metavar="SCHEME://HOST:PORT", help="The robot; without a scheme eki://.", show_default=False),
    ] = None,
    instrument: Annotated[
        str | None,
        typer.Option(metavar="tcp://HOST:PORT|folder:DIR", help="What measures points, for poses.", show_default=False),
    ] = None,
    operator: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT", help="The hands at a virtual robot, which close its clamp.", show_default=False
        ),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a run that was stopped.")] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="For scripts: a person has looked; every question is answered with yes.")
    ] = False,
    until: Annotated[
        str | None,
        typer.Option(
            metavar="EXPR", help='Stop when "std(backlash@joint2) < 5 arcsec"; several with and.', show_default=False
        ),
    ] = None,
    adaptive: Annotated[
        bool, typer.Option("--adaptive", help="Then measure what separates effects that explain the same.")
    ] = False,
    budget: Annotated[
        int, typer.Option(min=1, metavar="N", help="With --adaptive: at most so many more visits, runs or sweeps.")
    ] = 20,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="No robot: say what would move, and draw CAMPAIGN.dry-run.svg.")
    ] = False,
    json: Json = None,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="With --dry-run: list every motion, too.", show_default=False)
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Run a measurement campaign on a robot; every row is on the disk before the next motion."""
    out = Output(quiet, json, verbose)

    from clampid.loop.until import parse_until
    from experiments.instruments import InstrumentError, instrument_of
    from experiments.links.address import open_link, parse_address
    from experiments.links.protocol import LinkError
    from experiments.plans.read import read_plan
    from experiments.runs.errors import RunStopped
    from experiments.runs.folder import check_folder_for
    from experiments.runs.people import host_and_port
    from experiments.runs.runner import Asked, begun
    from experiments.runs.runner import run as run_plan

    plan = read_plan(plan_file)
    conditions = () if until is None else parse_until(until)
    if dry_run:
        from clampid.verbs.dry_run import dry_run as show_motions

        show_motions(plan, plan_file, output, out)
        return
    if link is None:
        raise CallError("--link: expected the robot's address (or --dry-run), found none")
    if plan.kind == "poses" and instrument is None:
        raise CallError("--instrument: expected what measures the points of this plan, found none")
    try:
        parse_address(link)
    except LinkError as error:
        raise CallError(str(error)) from None
    try:
        connect = None if instrument is None else instrument_of(instrument)
    except InstrumentError as error:
        raise CallError(f"--{error}") from None
    if operator is not None:
        host_and_port(operator, "--operator")
    asked = Asked(
        link=lambda: open_link(link),
        instrument=connect,
        person=_person(yes, operator, out),
        resume=resume,
        say=out.step,
    )
    words = _words(plan_file, output, {"--link": link, "--instrument": instrument, "--operator": operator,
                                       "--until": until}, adaptive, budget)  # fmt: skip
    try:
        before = _held(output) if resume else check_folder_for(plan, output)
        _watch(asked, plan, before, conditions, out)
        if adaptive:
            from clampid.loop.adaptive import Adaptive

            asked.more = Adaptive(plan, before, budget, out.step).more
        with _progress(asked, plan, out):
            outcome = run_plan(plan, output, asked)
    except (RunStopped, InstrumentError, LinkError) as error:
        _stopped(str(error), asked, f"{words} --resume" if begun(output) else words, out)
        raise typer.Exit(STOPPED) from None
    _done(plan_file, output, outcome, out)


def _person(yes: bool, operator: str | None, out: Output) -> Person:
    from experiments.runs.people import Console, VirtualOperator, Yes

    asked: Person = Yes(out.step) if yes else Console(out.warn)
    return asked if operator is None else VirtualOperator(operator, asked)


def _held(folder: Path) -> Campaign | None:
    """What the folder holds, of a run that goes on."""
    from experiments.campaign import read_campaign
    from experiments.header import HEADER_FILE

    return read_campaign(folder) if (folder / HEADER_FILE).is_file() else None


def _watch(asked: Asked, plan: Plan, before: Campaign | None, conditions: Sequence[Any], out: Output) -> None:
    """Fit while it runs, where somebody listens or waits for an end."""
    if out.quiet and not conditions:
        return
    from clampid.loop.live_fit import LiveFit

    def entries() -> Sequence[Mapping[str, Any]]:
        return [] if asked.journal is None else asked.journal.entries

    asked.finished = LiveFit(plan, entries, before, out.step, conditions).finished


def _progress(asked: Asked, plan: Plan, out: Output) -> Any:
    from clampid.verbs.run_progress import progress_of

    return progress_of(asked, out)


def _stopped(why: str, asked: Asked, again: str, out: Output) -> None:
    from clampid.display import counted
    from clampid.screen import Next, Screen
    from experiments.runs.folder import tables_of

    rows = {} if asked.journal is None else {k: len(v) for k, v in tables_of(asked.journal.entries).items()}
    kept = ", ".join(f"{counted(count, 'row')} of {name}" for name, count in rows.items()) or "nothing yet"
    out.show(
        Screen(
            f"Stopped before the end: {why}.",
            facts=(("recorded", f"{kept}; all of it is kept" if rows else kept),),
            next=(Next("Look at the robot. Then go on where it stopped:", again),),
        )
    )
    out.result({"finished": False, "why": why, "rows": rows, "resume": again})


def _after(output: Path) -> Next:
    """What to do with the campaign: fit it, or see how its few poses repeat, or look at what is wrong with it."""
    from clampid.screen import Next
    from experiments.campaign import read_campaign
    from experiments.checks.check import check_campaign
    from experiments.long_log import LONG_ROWS

    read = read_campaign(output, rows_in_memory=LONG_ROWS)
    if all(found.severity != "error" for found in check_campaign(read, fits=True)):
        return Next("Next, fit a model:", shlex.join(["clampid", "identify", str(output), "-o", f"{output}.json"]))
    look = ["clampid", "check", str(output)]
    if any(found.severity == "error" for found in check_campaign(read)):
        return Next("Next, see what is wrong with it:", shlex.join(look))
    return Next("Next, see how accurate and repeatable the robot is:", shlex.join([*look, "--iso9283"]))


def _done(plan_file: Path, output: Path, outcome: Outcome, out: Output) -> None:
    from clampid.display import counted
    from clampid.screen import Screen

    rows = ", ".join(f"{counted(count, 'row')} of {name}" for name, count in outcome.rows.items())
    early = [outcome.enough] if outcome.enough else []
    out.show(
        Screen(
            f"Ran {plan_file} and wrote {output}: {rows}.",
            notes=(*early, *outcome.notes, *(f"skipped: {text}" for text in outcome.skipped)),
            next=(_after(output),),
        )
    )
    out.result(
        {
            "finished": True,
            "campaign": str(output),
            "rows": dict(outcome.rows),
            "skipped": list(outcome.skipped),
            "notes": list(outcome.notes),
            "enough": outcome.enough,
        }
    )


def _words(plan: Path, output: Path, given: Mapping[str, str | None], adaptive: bool, budget: int) -> str:
    words = ["clampid", "run", str(plan), "-o", str(output)]
    for name, value in given.items():
        words += [] if value is None else [name, value]
    return shlex.join([*words, *(["--adaptive", "--budget", str(budget)] if adaptive else [])])
