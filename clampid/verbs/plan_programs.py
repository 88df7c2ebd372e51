"""``clampid plan iso9283``, ``line``, ``fixed-point`` and ``warm-up``: postures that are visited again and again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from clampid.display import length
from clampid.verbs.errors import CallError
from clampid.verbs.inputs import numbers_of
from clampid.verbs.options import Json, Quiet, Verbose
from clampid.verbs.plan_options import Acceleration, PlanFile, Surroundings, names_of
from clampid.verbs.plan_screen import begin, finish, refusals

if TYPE_CHECKING:
    from clampid.planning.returns import ReturnWishes
    from clampid.stages.rows import Array
    from clampid.verbs.units import Units
    from experiments.plans.model import Cell

__all__ = ["PROGRAMS"]

DOWN = "0,0,-1"
HOUR = 3600.0

Way = Annotated[str, typer.Option(metavar="X,Y,Z", help="Where the flange's z axis looks, base frame.")]
Posture = Annotated[
    str | None, typer.Option(metavar="Q1,…", help="Where it stands; otherwise mid-range.", show_default=False)
]


@dataclass(frozen=True)
class Measuring:
    """What is measured at each visit, and how the robot approaches it."""

    targets: Annotated[
        str | None,
        typer.Option(metavar="T1,…", help="Targets to measure; otherwise the first of the cell.", show_default=False),
    ] = None
    approach: Annotated[
        float | None, typer.Option(metavar="RAD", help="Last move of every joint; otherwise 0.05.", show_default=False)
    ] = None
    last_move: Annotated[
        float | None,
        typer.Option(metavar="S", help="Least time of the last move; otherwise at --speed.", show_default=False),
    ] = None
    speed: Annotated[float, typer.Option(metavar="SHARE", help="Share of the top speeds.")] = 0.5
    measure_time: Annotated[float, typer.Option(metavar="S", help="Time for each target, seconds.")] = 3.0

    def returns(self, cell: Cell, units: Units, way: str, one_side: bool) -> ReturnWishes:
        """As the planner takes it."""
        from clampid.planning.returns import ReturnWishes
        from clampid.planning.visiting import Approach
        from experiments.plans.errors import PlanError

        if not cell.targets:
            raise PlanError("targets: expected a cell with targets (--like CAMPAIGN), found none")
        angle = 0.05 if self.approach is None else units.radians(self.approach)
        names = names_of(self.targets) or (next(iter(cell.targets)),)
        last = Approach(angle, self.last_move, self.speed)
        return ReturnWishes(_three("--way", numbers_of("--way", way)), names, one_side, last, self.measure_time)


def iso9283(
    output: PlanFile,
    where: Surroundings,
    measuring: Measuring,
    cube: Annotated[str, typer.Option(metavar="X,Y,Z,EDGE", help="Centre and edge, m, base frame.")],
    plane: Annotated[str, typer.Option(metavar="a|b|c|d", help="Through which edges.")] = "a",
    cycles: Annotated[int, typer.Option(help="How many; the standard asks for 30.")] = 30,
    both_sides: Annotated[bool, typer.Option("--both-sides", help="Every other cycle from the other side.")] = False,
    way: Way = DOWN,
    acceleration: Acceleration = None,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Plan the cycles of ISO 9283 through five poses of a cube: accuracy, repeatability, drift."""
    out = begin(output, json, quiet, verbose)
    with refusals():
        from clampid.planning.returns import Cube, plan_cube

        cell, limits, assumed = where.cell(acceleration)
        numbers = where.units.lengths(numbers_of("--cube", cube))
        if numbers is None or len(numbers) != 4:
            raise CallError(f"--cube: expected X,Y,Z,EDGE, found {cube!r}")
        wanted = measuring.returns(cell, where.units, way, not both_sides)
        made = plan_cube(
            cell, limits, where.scene(cell), wanted,
            Cube(_three("--cube", numbers[:3]), numbers[3], plane), cycles=cycles, assumed=assumed,
        )  # fmt: skip
        finish(made, output, out, f"{cycles} cycles of 5 poses")


def line(
    output: PlanFile,
    where: Surroundings,
    measuring: Measuring,
    start: Annotated[str, typer.Option("--from", metavar="X,Y,Z", help="Where the first target begins, m, base.")],
    end: Annotated[str, typer.Option("--to", metavar="X,Y,Z", help="Where it ends.")],
    stops: Annotated[int, typer.Option(help="Places on the line, both ends included.")] = 24,
    repetitions: Annotated[int, typer.Option(help="How often it goes out and back.")] = 200,
    one_side: Annotated[
        bool, typer.Option("--one-side", help="On the way back too, come from the outward side.")
    ] = False,
    way: Way = DOWN,
    acceleration: Acceleration = None,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Plan stops on a straight line, out and back: repeatability from one side and from both, along a length."""
    out = begin(output, json, quiet, verbose)
    with refusals():
        import numpy as np

        from clampid.planning.returns import line_deviation, plan_line

        cell, limits, assumed = where.cell(acceleration)
        ends = np.array(
            [_three(n, where.units.lengths(numbers_of(n, t))) for n, t in (("--from", start), ("--to", end))]
        )
        wanted = measuring.returns(cell, where.units, way, one_side)
        made = plan_line(
            cell, limits, where.scene(cell), wanted, ends, stops=stops, repetitions=repetitions, assumed=assumed
        )
        between, travelled = line_deviation(made, wanted.targets[0])
        notes = (
            f"Between stops, {wanted.targets[0]} leaves the line by at most {length(between)}.",
            f"In the last moves (--approach) it leaves the line by at most {length(travelled)}.",
        )
        finish(
            made, output, out, f"{stops} stops, {repetitions} times out and back", notes,
            off_line_m=between, off_line_in_last_moves_m=travelled,
        )  # fmt: skip


def fixed_point(
    output: PlanFile,
    where: Surroundings,
    measuring: Measuring,
    posture: Posture = None,
    readings: Annotated[int, typer.Option(help="How often each target is measured.")] = 30,
    pause: Annotated[float, typer.Option(metavar="S", help="Rest before each, seconds.")] = 0.0,
    acceleration: Acceleration = None,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Plan measurements of a robot that stands: how well the instrument itself repeats."""
    out = begin(output, json, quiet, verbose)
    with refusals():
        from clampid.planning.returns import plan_fixed

        cell, limits, assumed = where.cell(acceleration)
        wanted = measuring.returns(cell, where.units, DOWN, True)
        made = plan_fixed(
            cell, limits, where.scene(cell), wanted, _posture(posture, where.units, limits.lower, limits.upper),
            readings=readings, pause=pause, assumed=assumed,
        )  # fmt: skip
        finish(made, output, out, f"{readings} readings of a fixed point")


def warm_up(
    output: PlanFile,
    where: Surroundings,
    measuring: Measuring,
    posture: Posture = None,
    joints: Annotated[str | None, typer.Option(metavar="1,2,…", help="Which move; all otherwise.")] = None,
    one_at_a_time: Annotated[
        bool, typer.Option("--one-at-a-time", help="One joint after the other, each all hours.")
    ] = False,
    swing: Annotated[
        float | None, typer.Option(metavar="RAD", help="To either side; otherwise 0.5 rad.", show_default=False)
    ] = None,
    hours: Annotated[float, typer.Option(metavar="H", help="Of motion.")] = 3.0,
    repetitions: Annotated[int | None, typer.Option(help="Measurements instead of hours.", show_default=False)] = None,
    every: Annotated[float, typer.Option(metavar="MIN", help="Minutes of motion between two measurements.")] = 5.0,
    interrupt: Annotated[
        str | None, typer.Option(metavar="H,H", help="After how many hours of motion it rests, and for how many.")
    ] = None,
    cool_down: Annotated[float, typer.Option(metavar="H", help="Hours of rest at the end, measured too.")] = 0.0,
    until_steady: Annotated[
        float | None,
        typer.Option(metavar="K/H", help="End earlier, when temperatures change by less.", show_default=False),
    ] = None,
    beyond: Annotated[
        float, typer.Option(metavar="H", help="With --until-steady: hours for which they stay so.")
    ] = 1.0,
    acceleration: Acceleration = None,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Plan a warm-up: joints swing for hours, and between the swings a reference point is measured."""
    out = begin(output, json, quiet, verbose)
    with refusals():
        from clampid.planning.warm_up import WarmUp, plan_warm_up
        from experiments.plans.errors import PlanError
        from experiments.plans.model import Steady

        cell, limits, assumed = where.cell(acceleration)
        rest = numbers_of("--interrupt", interrupt)
        if rest is not None and len(rest) != 2:
            raise CallError(f"--interrupt: expected two numbers of hours, found {interrupt!r}")
        if until_steady is not None and not (until_steady > 0.0 and 0.0 <= beyond <= 168.0):
            raise PlanError(
                f"until steady: expected K/h above 0 and hours from 0 to 168, found {until_steady}, {beyond}"
            )
        warm = WarmUp(
            joints=_joints(joints, cell.robot.n),
            together=not one_at_a_time,
            swing=0.5 if swing is None else where.units.radians(swing),
            hours=hours,
            repetitions=repetitions,
            every=60.0 * every,
            interrupt=None if rest is None else (HOUR * rest[0], HOUR * rest[1]),
            cool=cool_down,
            steady=None if until_steady is None else Steady(until_steady, HOUR * beyond),
        )
        wanted = measuring.returns(cell, where.units, DOWN, True)
        at = _posture(posture, where.units, limits.lower, limits.upper)
        made = plan_warm_up(cell, limits, where.scene(cell), wanted, warm, at, assumed)
        swings = sum(v.times for v in made.visits if not v.targets)
        measured = sum(bool(v.targets) for v in made.visits)
        finish(made, output, out, f"{swings} swings, {measured} measurements of the reference point")


PROGRAMS: dict[str, tuple[Callable[..., Any], str]] = {
    "iso9283": (iso9283, "Cycles of ISO 9283: accuracy and repeatability."),
    "line": (line, "Stops on a line, out and back: repeatability along it."),
    "fixed-point": (fixed_point, "A robot that stands: how the instrument repeats."),
    "warm-up": (warm_up, "Swings for hours, with a reference point between."),
}
"""Name → verb, and what it is for in short."""


def _three(option: str, numbers: tuple[float, ...] | None) -> Array:
    import numpy as np

    if numbers is None or len(numbers) != 3:
        raise CallError(f"{option}: expected three numbers, found {0 if numbers is None else len(numbers)}")
    return np.array(numbers)


def _posture(text: str | None, units: Units, lower: Array, upper: Array) -> Array:
    import numpy as np

    given = units.angles(numbers_of("--posture", text))
    if given is None:
        return np.asarray(np.round((lower + upper) / 2, 6))
    if len(given) != len(lower):
        raise CallError(f"--posture: expected {len(lower)} angles in {units.angle_unit}, found {len(given)}")
    return np.array(given)


def _joints(text: str | None, n: int) -> tuple[int, ...]:
    numbers = numbers_of("--joints", text)
    if numbers is None:
        return tuple(range(n))
    if not all(j.is_integer() and 1 <= j <= n for j in numbers) or len(set(numbers)) < len(numbers):
        raise CallError(f"--joints: expected different numbers from 1 to {n}, found {text!r}")
    return tuple(int(j) - 1 for j in numbers)
