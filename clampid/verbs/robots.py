"""``clampid robots``: the bundled robot descriptions, and how one description is understood."""

from __future__ import annotations

import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from clampid.verbs.options import Json, Quiet, Verbose
from clampid.verbs.output import Output, output_file

if TYPE_CHECKING:
    from clampid.screen import Screen
    from kinematics.robot import Joint, RobotDescription

__all__ = ["assumptions", "robots", "understood"]


def robots(
    robot: Annotated[
        str | None,
        typer.Argument(
            metavar="[ROBOT]", help="A bundled name, or a .toml or .urdf file.", show_default="all bundled ones"
        ),
    ] = None,
    svg: Annotated[
        Path | None,
        typer.Option(metavar="FILE.svg", help="Draw the robot at its zero pose.", show_default=False),
    ] = None,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """List the bundled robots, or say how a description is understood and what is assumed where it says nothing."""
    from clampid.verbs.errors import CallError
    from kinematics.description import load_robot, robot_names

    out = Output(quiet, json, verbose)
    if robot is None:
        if svg is not None:
            raise CallError(
                "--svg: expected the robot to draw, found none; for example: clampid robots ur10 --svg x.svg"
            )
        known = {name: load_robot(name) for name in robot_names()}
        out.result([understood(description) for description in known.values()])
        out.show(_all(known))
        return
    description = load_robot(robot)
    if svg is not None:
        from clampid.report.robot_drawing import robot_drawing
        from experiments.outputs import write_text

        write_text(output_file(svg, "a picture (SVG)"), robot_drawing(description))
    for note in (*description.notes, *description.unverified):
        out.say(f"note: {note}")
    if description.source:
        out.say(f"source: {description.source}")
    out.result(understood(description))
    out.show(_one(robot, description, svg))


def understood(robot: RobotDescription) -> dict[str, Any]:
    """How a description is understood, for programs; SI units, angles in radians.

    Parameters
    ----------
    robot
        The description.

    Returns
    -------
    dict
        Joints with limits, speed, rated torque and gear ratio (motor angle per joint angle); reach; masses, whether
        described or assumed; transmission; springs; the kinds of table; and `assumed`, sentences.
    """
    from kinematics.masses import links_of

    masses = [link.mass for link in links_of(robot)]
    gears = _gears(robot)
    return {
        "name": robot.name,
        "title": robot.title,
        "joints": [
            {
                "name": joint.name,
                "kind": joint.kind,
                "axis": list(joint.axis),
                "point_m": list(joint.point),
                "lower": joint.lower,
                "upper": joint.upper,
                "max_speed": joint.max_speed,
                "rated_torque": joint.rated_torque,
                "gear_ratio": gear,
                "mass_kg": mass,
            }
            for joint, gear, mass in zip(robot.joints, gears, masses, strict=True)
        ],
        "reach_m": robot.stretched,
        "masses_described": robot.has_masses,
        "transmission_known": robot.transmission_known,
        "transmission": robot.transmission.tolist(),
        "coupled_joints": _coupled(robot),
        "motor_spring_Nm_rad": None if robot.motor_spring is None else list(robot.motor_spring),
        "dh_table": robot.dh is not None,
        "notes": list(robot.notes),
        "unverified": list(robot.unverified),
        "source": robot.source,
        "assumed": list(assumptions(robot)),
    }


def assumptions(robot: RobotDescription) -> tuple[str, ...]:
    """What is assumed because the description says nothing of it, in sentences."""
    from kinematics.masses import usual_links
    from kinematics.robot import USUAL_TORQUE

    out = []
    if not robot.has_masses:
        mass = sum(link.mass for link in usual_links(robot))
        out.append(
            f"Masses are not described. The links are taken to weigh {mass:.0f} kg in all, as arms of this reach do, "
            "with a factor of two of uncertainty."
        )
    if not robot.transmission_known:
        out.append(
            "The transmission is not described: gear ratios are 1, nothing is coupled, motor angles mean nothing."
        )
    if robot.motor_spring is None:
        out.append("Motor springs are not described. The fit finds the joints' compliance from zero.")
    if silent := _numbers(k for k, joint in enumerate(robot.joints, 1) if joint.rated_torque is None):
        out.append(f"Rated torque of {silent}: {USUAL_TORQUE:g} Nm (N where it slides).")
    if silent := _numbers(k for k, joint in enumerate(robot.joints, 1) if joint.max_speed is None):
        out.append(f"Greatest speed of {silent}: 180 deg/s where a move is checked, 57 deg/s in plans.")
    if silent := _numbers(k for k, joint in enumerate(robot.joints, 1) if not math.isfinite(joint.upper - joint.lower)):
        out.append(f"Range of {silent}: without limits; plans use half a turn to either side.")
    return tuple(out)


def _numbers(found: Any) -> str:
    joints = list(found)
    return f"joint{'s' if len(joints) > 1 else ''} {', '.join(map(str, joints))}" if joints else ""


def _gears(robot: RobotDescription) -> list[float]:
    """Motor angle per joint angle, of each joint's own motor ``(n,)``."""
    return [1.0 / float(robot.transmission[k, k]) for k in range(robot.n)]


def _coupled(robot: RobotDescription) -> list[list[int]]:
    """Pairs (motor, joint), from 1: a motor that turns another joint than its own."""
    return [
        [i + 1, j + 1] for i in range(robot.n) for j in range(robot.n) if i != j and robot.transmission[i, j] != 0.0
    ]


def _all(known: dict[str, RobotDescription]) -> Screen:
    from clampid.screen import Next, Screen

    def words(robot: RobotDescription) -> str:
        known = [
            "masses" if robot.has_masses else "",
            "gears" if robot.transmission_known else "",
            "springs" if robot.motor_spring is not None else "",
        ]
        said = ", ".join(filter(None, known)) or "geometry only"
        return f"{robot.title}; {robot.n} joints; {said}"

    return Screen(
        f"{len(known)} robots are bundled. Another one is described by a .toml or .urdf file.",
        facts=tuple((name, words(robot)) for name, robot in known.items()),
        more="Axes, limits and assumptions of each: --json FILE.",
        next=(Next("Next, see how a description is understood:", "clampid robots kuka_kr20_r1810"),),
    )


def _one(given: str, robot: RobotDescription, svg: Path | None) -> Screen:
    from clampid.screen import Next, Screen
    from clampid.verbs.next_step import free_name
    from kinematics.masses import links_of

    facts = [
        (f"joint {k}", _joint(joint, gear if robot.transmission_known else None))
        for k, (joint, gear) in enumerate(zip(robot.joints, _gears(robot), strict=True), 1)
    ]
    total = sum(link.mass for link in links_of(robot))
    facts.append(("reach", f"{robot.stretched:.3f} m from axis 2 to the flange, stretched out"))
    facts.append(("masses", f"{total:.1f} kg in all" if robot.has_masses else "not described"))
    coupled = ", ".join(f"motor {i} turns joint {j}" for i, j in _coupled(robot))
    gears = f"described; {coupled or 'nothing is coupled'}" if robot.transmission_known else "not described"
    facts.append(("transmission", gears))
    simulate = shlex.join(["clampid", "simulate", "-o", str(free_name(Path("arm"))), "--robot", given])
    steps = [Next("Next, try the commands on a simulated one:", simulate)]
    if svg is None:
        name = f"{Path(given).stem if Path(given).suffix else given}.svg"
        steps.append(Next("Draw it:", f"clampid robots {shlex.quote(given)} --svg {shlex.quote(name)}"))
    assumed = assumptions(robot)
    return Screen(
        f"{robot.title}, {robot.n} joints." + ("" if svg is None else f" Drawn in {svg}."),
        facts=tuple(facts),
        verdict="Assumed, because the description does not say it:" if assumed else "Nothing has to be assumed.",
        tone="open" if assumed else "good",
        notes=assumed,
        next=tuple(steps),
    )


def _joint(joint: Joint, gear: float | None) -> str:
    turns = joint.kind != "prismatic"
    scale, unit, load = (180.0 / math.pi, "deg", "Nm") if turns else (1e3, "mm", "N")
    bounded = math.isfinite(joint.upper - joint.lower)
    parts = [
        "" if joint.kind == "revolute" else joint.kind,
        f"{joint.lower * scale:.0f} to {joint.upper * scale:.0f} {unit}" if bounded else "no limits",
        "" if joint.max_speed is None else f"{joint.max_speed * scale:.0f} {unit}/s",
        "" if joint.rated_torque is None else f"{joint.rated_torque:.0f} {load}",
        "" if gear is None else f"gear {gear:.1f}",
    ]
    return ", ".join(filter(None, parts))
