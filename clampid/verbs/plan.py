"""``clampid plan``: which measurements to take, as a file that a person can read and a robot can run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from clampid.verbs.errors import CallError
from clampid.verbs.grouped import grouped
from clampid.verbs.inputs import numbers_of
from clampid.verbs.options import Json, Quiet, Seed, Verbose
from clampid.verbs.plan_options import Acceleration, Effects, PlanFile, Surroundings, TorqueReadings, names_of
from clampid.verbs.plan_programs import PROGRAMS
from clampid.verbs.plan_screen import begin, finish, refusals

if TYPE_CHECKING:
    from clampid.planning.sight import Sight
    from clampid.stages.rows import Array
    from clampid.verbs.units import Units

__all__ = ["plan"]

SIGHT_TOLERANCE = 0.05  # rad
LAST_MOVE = 0.05  # rad, of every joint to a pose

plan = typer.Typer(help="Plan measurements that identify what is asked.", no_args_is_help=True)

Time = Annotated[float, typer.Option(metavar="S", help="Time budget, seconds.")]
Speeds = Annotated[str, typer.Option(metavar="A,B,…", help="Shares of the top speeds, one run each.")]


@plan.command("free-air", short_help="Motion in free air: gravity and friction.")
@grouped
def free_air(
    output: PlanFile,
    where: Surroundings,
    torques: TorqueReadings,
    time: Time = 1200.0,
    speeds: Speeds = "0.15,0.06",
    effects: Effects = None,
    acceleration: Acceleration = None,
    seed: Seed = 0,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Plan a motion in free air that identifies gravity and friction."""
    out = begin(output, json, quiet, verbose)
    with refusals():
        from clampid.planning.free_air import plan_free_air
        from clampid.planning.program import LogWishes

        cell, limits, assumed = where.cell(acceleration)
        noise, more = torques.noise(cell)
        with out.working("choosing configurations"):
            wished = LogWishes(time, numbers_of("--speeds", speeds) or (), names_of(effects) or None, seed=seed)
            made = plan_free_air(
                cell, limits, noise, wished, scene=where.scene(cell), assumed=(*assumed, *more)
            )  # fmt: skip
        finish(made, output, out, f"{len(made.runs[0].course.duration)} stops at {len(made.runs)} speeds")


@plan.command(short_help="Swings of a coupled wrist: friction of its gears.")
@grouped
def wrist(
    output: PlanFile,
    where: Surroundings,
    torques: TorqueReadings,
    time: Time = 600.0,
    speeds: Speeds = "0.15,0.06",
    effects: Effects = None,
    acceleration: Acceleration = None,
    seed: Seed = 0,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Plan swings of a coupled wrist that separate friction of the motors from friction of the arm's side."""
    out = begin(output, json, quiet, verbose)
    with refusals():
        from clampid.planning.program import LogWishes
        from clampid.planning.wrist import SWING_STOPS, plan_wrist

        cell, limits, assumed = where.cell(acceleration)
        noise, more = torques.noise(cell)
        with out.working("choosing swings"):
            wished = LogWishes(time, numbers_of("--speeds", speeds) or (), names_of(effects), seed=seed)
            made = plan_wrist(cell, limits, noise, wished, scene=where.scene(cell), assumed=(*assumed, *more))
        swings = sum(len(run.course.duration) for run in made.runs) // SWING_STOPS
        finish(made, output, out, f"{swings} swings in {len(made.runs)} runs")


@plan.command(short_help="Sweeps against a clamped flange: springs and clearances.")
@grouped
def clamping(
    output: PlanFile,
    where: Surroundings,
    torques: TorqueReadings,
    time: Time = 7200.0,
    amplitude: Annotated[
        str, typer.Option(metavar="SHARE[,…]", help="Of the rated motor torques, for all joints or one each.")
    ] = "0.3",
    joints: Annotated[
        str | None, typer.Option(metavar="1,2,…", help="Which joints to drive; all otherwise.", show_default=False)
    ] = None,
    max_torque: Annotated[
        float, typer.Option(metavar="SHARE", help="Limit of the motor torques, as a share of the rated ones.")
    ] = 0.8,
    max_force: Annotated[float, typer.Option(metavar="N", help="Limit of the force on the clamp.")] = 3000.0,
    max_moment: Annotated[float, typer.Option(metavar="NM", help="Limit of the moment on the clamp.")] = 2000.0,
    margin: Annotated[float, typer.Option(help="By how much stiffer drives may be than described.")] = 1.6,
    dwell: Annotated[float, typer.Option(metavar="S", help="Dwell time at each step, seconds.")] = 1.0,
    clamping_time: Annotated[float, typer.Option(metavar="S", help="Time to clamp the flange, seconds.")] = 600.0,
    posture: Annotated[
        list[str] | None,
        typer.Option(metavar="Q1,…", help="Where it can be clamped, rad; may be repeated.", show_default=False),
    ] = None,
    least_torque: Annotated[
        bool, typer.Option("--least-torque", help="Search for the posture of least torque in each clamping.")
    ] = False,
    effects: Effects = None,
    seed: Seed = 0,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Plan sweeps against a clamped flange that identify springs, clearances and friction within load limits."""
    out = begin(output, json, quiet, verbose)
    with refusals():
        from dataclasses import replace

        import numpy as np

        from clampid.planning.clamping import ClampingWishes, plan_clamping
        from clampid.planning.least_torque import search_for
        from clampid.planning.press import Press, press_limits, stiffness_of
        from clampid.standard_sets import STANDARD
        from experiments.plans.press import rated_motor_torque

        cell, limits, assumed = where.cell()
        noise, more = torques.noise(cell)
        rated = rated_motor_torque(cell.robot, None if torques.rated is None else np.array(torques.rated))
        stiffness, usual = stiffness_of(cell.robot, rated)
        share = np.array(numbers_of("--amplitude", amplitude) or ())
        share = np.full(cell.robot.n, share[0]) if len(share) == 1 else share
        bounds = press_limits(limits, rated, torque=max_torque, force=max_force, moment=max_moment)
        press = Press(share, rated, stiffness, margin, dwell, clamping_time)
        with out.working("choosing sweeps"):
            wished = ClampingWishes(
                time=time, effects=names_of(effects) or STANDARD["clamped"], joints=_joints(joints, cell.robot.n),
                postures=_postures(posture, cell.robot.n, where.units), seed=seed,
            )  # fmt: skip
            made = plan_clamping(
                cell, bounds, noise, press, wished, scene=where.scene(cell), assumed=(*assumed, *more, *usual),
            )  # fmt: skip
        if least_torque:
            made = replace(made, least_torque=search_for(cell.robot, press))
        force = max(float(s.force.max()) for s in made.sweeps)
        moment = max(float(s.moment.max()) for s in made.sweeps)
        load = f"on the clamp at most {force:.0f} N of {max_force:g} N and {moment:.0f} Nm of {max_moment:g} Nm"
        finish(made, output, out, f"{len(made.sweeps)} sweeps in {made.sweeps[-1].clamping} clampings", (load,))


@plan.command(short_help="Poses to measure: geometry, springs and clearances.")
@grouped
def poses(
    output: PlanFile,
    where: Surroundings,
    count: Annotated[int, typer.Option("--poses", help="How many poses.")] = 60,
    replicates: Annotated[int, typer.Option(help="How many of them are visited three times more.")] = 6,
    verification: Annotated[int, typer.Option(help="How many more poses, for verification only.")] = 20,
    box: Annotated[
        str | None,
        typer.Option(metavar="X,Y,Z,X,Y,Z", help="Targets inside this box, m, base frame.", show_default=False),
    ] = None,
    sphere: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z,R,R[,AX,AY,AZ,RAD]",
            show_default=False,
            help="Targets between two radii about a point and within an angle of an axis, m, base frame.",
        ),
    ] = None,
    verification_sphere: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z,R,R[,AX,AY,AZ,RAD]",
            show_default=False,
            help="Verification on a grid on such a part, the flange's z axis towards its centre.",
        ),
    ] = None,
    instrument: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Where it stands, m, base frame.", show_default=False)
    ] = None,
    view: Annotated[
        str | None, typer.Option(metavar="X,Y,Z,RAD", help="Cone that it sees, base frame.", show_default=False)
    ] = None,
    facing: Annotated[
        str | None, typer.Option(metavar="X,Y,Z,RAD", help="Cone that targets answer in, flange.", show_default=False)
    ] = None,
    sight_tolerance: Annotated[
        float | None,
        typer.Option(metavar="RAD", help="Angle that is taken off both cones; otherwise 0.05 rad.", show_default=False),
    ] = None,
    approach: Annotated[
        float | None,
        typer.Option(metavar="RAD", help="Last move of every joint to a pose; otherwise 0.05 rad.", show_default=False),
    ] = None,
    spread: Annotated[
        float, typer.Option(metavar="SHARE", help="Share of the poses chosen to be far from all others.")
    ] = 0.2,
    measure_time: Annotated[float, typer.Option(metavar="S", help="Time for each tracked point, seconds.")] = 3.0,
    effects: Effects = None,
    acceleration: Acceleration = None,
    seed: Seed = 0,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Plan poses to measure: visible, clear of obstacles, informative, approached from both sides, in a short order."""
    out = begin(output, json, quiet, verbose)
    with refusals():
        from clampid.planning.direction_balance import balance_of
        from clampid.planning.poses import PoseWishes, plan_poses
        from clampid.planning.region import box_of, sphere_part_of

        if box is not None and sphere is not None:
            raise CallError("--box and --sphere: expected one of them, found both")
        units = where.units
        inside = units.lengths(numbers_of("--box", box)) or units.part_of_sphere(numbers_of("--sphere", sphere))
        grid = units.part_of_sphere(numbers_of("--verification-sphere", verification_sphere))
        cell, limits, assumed = where.cell(acceleration)
        wishes = PoseWishes(
            count, replicates, verification, names_of(effects),
            None if inside is None else box_of(inside) if box is not None else sphere_part_of(inside),
            _sight(instrument, view, facing, sight_tolerance, units),
            None if grid is None else sphere_part_of(grid), spread,
            LAST_MOVE if approach is None else units.radians(approach), measure_time,
        )  # fmt: skip
        with out.working("choosing poses"):
            made = plan_poses(cell, limits, wishes, scene=where.scene(cell), seed=seed, assumed=assumed)
        own = sum(visit.table == "poses" for visit in made.visits)
        balance = balance_of(made)
        what = f"{count} poses in {own} visits, {len(made.visits) - own} for verification"
        finish(made, output, out, what, (balance.words,), approaches=balance.to_json())


def _sight(
    instrument: str | None, view: str | None, facing: str | None, tolerance: float | None, units: Units
) -> Sight | None:
    from clampid.planning.sight import sight_of

    station = units.lengths(numbers_of("--instrument", instrument))
    if station is None:
        if view is not None or facing is not None:
            raise CallError("--view, --facing: expected --instrument X,Y,Z with them, found none")
        return None
    cones = units.cone(numbers_of("--view", view)), units.cone(numbers_of("--facing", facing))
    return sight_of(station, *cones, SIGHT_TOLERANCE if tolerance is None else units.radians(tolerance))


def _joints(text: str | None, n: int) -> tuple[int, ...] | None:
    numbers = numbers_of("--joints", text)
    if numbers is None:
        return None
    if not all(j.is_integer() and 1 <= j <= n for j in numbers) or len(set(numbers)) < len(numbers):
        raise CallError(f"--joints: expected different numbers from 1 to {n}, found {text!r}")
    return tuple(int(j) - 1 for j in numbers)


def _postures(texts: list[str] | None, n: int, units: Units) -> Array | None:
    import numpy as np

    if not texts:
        return None
    rows = [units.angles(numbers_of("--posture", text)) or () for text in texts]
    for row in rows:
        if len(row) != n:
            raise CallError(f"--posture: expected {n} angles in {units.angle_unit}, found {len(row)}")
    return np.array(rows)


for _name, (_verb, _short) in PROGRAMS.items():
    plan.command(_name, short_help=_short)(grouped(_verb))
