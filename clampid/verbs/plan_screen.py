"""How the verbs of ``clampid plan`` begin and end: the file to write, refusals, and what the plan will identify."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clampid.display import number, scale_for
from clampid.verbs.errors import CallError
from clampid.verbs.output import Output, output_file

if TYPE_CHECKING:
    from clampid.screen import Screen
    from experiments.plans.model import Expected, Plan

__all__ = ["begin", "finish", "refusals"]


def begin(output: Path, json: str | None, quiet: bool, verbose: bool) -> Output:
    """The output of a verb that writes a plan."""
    out = Output(quiet, json, verbose)
    output_file(output, "a plan")
    if output.suffix.lower() != ".toml":
        raise CallError(f"{output}: expected a name that ends in .toml")
    return out


@contextmanager
def refusals() -> Iterator[None]:
    """Errors of plans are wrong calls."""
    from experiments.plans.errors import PlanError

    try:
        yield
    except PlanError as error:
        raise CallError(str(error)) from error


def finish(made: Plan, output: Path, out: Output, what: str, notes: Sequence[str] = (), **more: Any) -> None:
    """Write the plan, and say what it is and what it will identify."""
    from experiments.plans.write import write_plan

    write_plan(made, output)
    if made.expected is not None:
        _show(made.expected, out)
    out.show(_screen(made, output, what, notes))
    out.result(_as_json(made, output) | more)


def _screen(made: Plan, output: Path, what: str, said: Sequence[str]) -> Screen:
    """What was planned, and what it will identify."""
    from clampid.screen import Next, Screen
    from clampid.verbs.next_step import free_name

    facts = [("assumed", sentence) for sentence in made.assumed]
    verdict, notes = "", list(said)
    if made.expected is not None:
        known = sum(p.identified for p in made.expected.parameters)
        verdict = f"It identifies {known} of {len(made.expected.parameters)} parameters."
        notes += [f"not identified: {sentence}" for sentence in made.expected.not_identified]
    look = shlex.join(["clampid", "run", str(output), "-o", str(free_name(Path("measured"))), "--dry-run"])
    return Screen(
        f"Wrote {output}: {made.kind} of {made.cell.robot.name}, {what}, {_time(made.duration)}.",
        facts=tuple(facts),
        verdict=verdict,
        notes=tuple(notes),
        more="Expected errors of all parameters: --verbose, --json FILE." if verdict else "",
        next=(Next("Next, see what would move, without a robot:", look),),
    )


def _time(seconds: float) -> str:
    """Minutes, and from two hours on hours."""
    from experiments.runs.dry import hours_or_minutes

    return hours_or_minutes(seconds)


def _show(expected: Expected, out: Output) -> None:
    """What a plan will identify, for people."""
    from clampid.fitting.observability import index_words

    out.say(index_words(expected.indices))
    rows = []
    for p in expected.parameters:
        scale = scale_for(p.unit, [min(p.std, p.size)])
        shown = (number(v * scale.factor, 2) for v in (p.std, p.size))
        rows.append((p.name, scale.unit, *shown, "" if p.identified else "not identified"))
    out.table("", ("parameter", "unit", "expected error", "plausible size", ""), rows, left=2)
    for sentence in expected.not_identified:
        out.say(f"not identified: {sentence}")


def _as_json(made: Plan, output: Path) -> dict[str, Any]:
    expected = made.expected
    return {
        "plan": str(output),
        "kind": made.kind,
        "robot": made.cell.reference,
        "duration_s": made.duration,
        "runs": len(made.runs),
        "sweeps": len(made.sweeps),
        "visits": len(made.visits),
        "assumed": list(made.assumed),
        "indices": {} if expected is None else dict(expected.indices),
        "parameters": []
        if expected is None
        else [
            {"name": p.name, "unit": p.unit, "std": p.std, "size": p.size, "identified": p.identified}
            for p in expected.parameters
        ],
        "not_identified": [] if expected is None else list(expected.not_identified),
    }
