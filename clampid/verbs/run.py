"""``clampid run``: a plan becomes a campaign, on a robot."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clampid.verbs.errors import CallError
from clampid.verbs.options import Json, Quiet
from clampid.verbs.output import Output

if TYPE_CHECKING:
    from experiments.runs.people import Person

__all__ = ["run"]

STOPPED = 3
"""Exit code: stopped safely before the end."""


def run(
    plan: Annotated[Path, typer.Argument(metavar="PLAN.toml", help="What clampid plan wrote.", show_default=False)],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="CAMPAIGN", help="Campaign folder: new, or to be added to.")
    ],
    link: Annotated[
        str, typer.Option(metavar="SCHEME://HOST:PORT", help="The robot, see clampid serve.", show_default=False)
    ],
    instrument: Annotated[
        str | None, typer.Option(metavar="tcp://HOST:PORT", help="What measures points.", show_default=False)
    ] = None,
    operator: Annotated[
        str | None,
        typer.Option(metavar="HOST:PORT", help="Hands of a virtual robot, for its clamp.", show_default=False),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a run that was stopped.")] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="A person has looked at the robot: every question is answered so.")
    ] = False,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Run a measurement campaign on a robot; every row is on the disk before the next motion."""
    out = Output(quiet, json, verbose=False)

    from clampid.screen import Next, Screen
    from experiments.links.address import open_link, parse_address
    from experiments.links.protocol import LinkError
    from experiments.plans.read import read_plan
    from experiments.runs.errors import RunStopped
    from experiments.runs.runner import Asked
    from experiments.runs.runner import run as run_plan
    from experiments.runs.tracker_line import InstrumentError, connect_instrument

    read = read_plan(plan)
    try:
        parse_address(link)
    except LinkError as error:
        raise CallError(str(error)) from None
    asked = Asked(
        link=lambda: open_link(link),
        instrument=None if instrument is None else lambda: connect_instrument(instrument),
        person=_person(yes, operator, out),
        resume=resume,
        say=out.step,
        progress=lambda done, text: out.step(f"{done:4.0%} {text}"),
    )
    again = _again(plan, output, link, instrument, operator)
    try:
        outcome = run_plan(read, output, asked)
    except (RunStopped, InstrumentError) as error:
        rows = {} if asked.journal is None else _rows(asked.journal.entries)
        kept = ", ".join(f"{count} rows of {name}" for name, count in rows.items()) or "no rows yet"
        out.warn(f"clampid: stopped: {error}")
        out.show(Screen("Stopped before the end.", facts=(("recorded", f"{kept}; nothing is lost"),),
                        next=(Next("Look at the robot. Then go on where it stopped:", again),)))
        out.result({"finished": False, "why": str(error), "rows": rows, "resume": again})
        raise typer.Exit(STOPPED) from None
    rows = dict(outcome.rows)
    counted = ", ".join(f"{count} rows of {name}" for name, count in rows.items())
    notes = [*outcome.notes, *(f"skipped: {text}" for text in outcome.skipped)]
    if outcome.enough:
        notes.insert(0, outcome.enough)
    model = shlex.quote(f"{output}.json")
    out.show(Screen(f"Ran {plan} and wrote {output}: {counted}.", notes=tuple(notes), next=(
        Next("Next, fit a model:", f"clampid identify {shlex.quote(str(output))} -o {model}"),)))
    out.result({"finished": True, "campaign": str(output), "rows": rows, "skipped": list(outcome.skipped),
                "notes": list(outcome.notes), "enough": outcome.enough})


def _person(yes: bool, operator: str | None, out: Output) -> Person:
    from experiments.runs.people import Console, VirtualOperator, Yes

    asked: Person = Yes(out.step) if yes else Console(out.warn)
    return asked if operator is None else VirtualOperator(operator, asked)


def _rows(entries: list[dict]) -> dict[str, int]:
    from experiments.runs.folder import tables_of

    return {name: len(frame) for name, frame in tables_of(entries).items()}


def _again(plan: Path, output: Path, link: str, instrument: str | None, operator: str | None) -> str:
    words = ["clampid", "run", str(plan), "--link", link, "-o", str(output)]
    for name, value in (("--instrument", instrument), ("--operator", operator)):
        words += [] if value is None else [name, value]
    return shlex.join([*words, "--resume"])
