"""``clampid run --dry-run``: what a plan would move, in one screen, with every motion behind ``--verbose``."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from clampid.screen import Next, Screen
from clampid.verbs.output import Output, output_file

if TYPE_CHECKING:
    from experiments.plans.model import Plan
    from experiments.runs.dry import Motion

__all__ = ["dry_run"]

LIMITS_NAMED = 3  # limits that motions come nearest to are named
HEADS = ("motion", "measured", "at s", "takes s", "speed", "turns deg", "nearest limit")


def dry_run(plan: Plan, plan_file: Path, output: Path, out: Output) -> None:
    """Say what would move, and draw it; nothing moves, and no robot is needed."""
    from experiments.outputs import write_text
    from experiments.runs.dry import motions
    from experiments.runs.picture import picture

    steps = list(motions(plan))
    svg = output.with_name(f"{output.name}.dry-run.svg")
    write_text(output_file(svg, "a picture (SVG)"), picture(plan, steps))
    out.table("", HEADS, [_row(step) for step in steps], left=2)
    out.show(_screen(plan, steps, plan_file, output, svg))
    out.result(
        {
            "plan": str(plan_file),
            "picture": str(svg),
            "duration_s": steps[-1].start + steps[-1].duration,
            "motions": [
                {"name": s.name, "to_rad": s.to.tolist(), "start_s": s.start, "duration_s": s.duration,
                 "speed_share": s.share, "measured": s.measured, "limit": s.limit}
                for s in steps
            ],
        }
    )  # fmt: skip


def _row(step: Motion) -> tuple[str, ...]:
    return (
        step.name,
        step.measured,
        f"{step.start:.1f}",
        f"{step.duration:.1f}",
        f"{step.share:.0%}",
        f"{math.degrees(step.travel):.2f}",
        step.limit,
    )


def _screen(plan: Plan, steps: Sequence[Motion], plan_file: Path, output: Path, svg: Path) -> Screen:
    """The motions in numbers: how many, how fast, how far, and which limits they come nearest to."""
    from experiments.runs.dry import hours_or_minutes

    time = hours_or_minutes(steps[-1].start + steps[-1].duration)
    fastest = max(steps, key=lambda step: step.share)
    longest = max(steps, key=lambda step: step.travel)
    rows = [step.measured for step in steps if step.measured]
    tables = ", ".join(f"{name} after {rows.count(name)} motions" for name in dict.fromkeys(rows))
    nearest: dict[str, Motion] = {}  # of each limit, the motion that comes nearest to it
    for step in sorted((step for step in steps if "%" in step.limit), key=_share, reverse=True):
        nearest.setdefault(step.limit.partition("% of ")[2], step)
    near = list(nearest.values())[:LIMITS_NAMED]
    facts = [
        ("measured", tables or "nothing"),
        ("fastest", f"{fastest.share:.0%} of the top speeds ({fastest.name})"),
        ("longest", f"{math.degrees(longest.travel):.0f} deg of one joint ({longest.name})"),
        *(("nearest limit" if k == 0 else "", f"{step.limit} ({step.name})") for k, step in enumerate(near)),
        ("picture", str(svg)),
    ]
    command = shlex.join(["clampid", "run", str(plan_file), "-o", str(output), "--link"])
    instrument = " --instrument tcp://HOST:PORT" if plan.kind == "poses" else ""
    return Screen(
        f"{plan_file} would make {len(steps)} motions of {plan.cell.robot.name} in {time}; nothing has moved.",
        facts=tuple(facts),
        notes=("The first motion starts wherever the robot stands. No plan has checked it.",),
        more="Every motion: --verbose, --json FILE.",
        next=(Next("Next, run it, with the robot's address:", f"{command} eki://HOST:54600{instrument}"),),
    )


def _share(step: Motion) -> int:
    """Percent of the limit that a motion comes nearest to."""
    return int(step.limit.split("%", 1)[0])
