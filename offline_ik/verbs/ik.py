"""``clampid ik``: joint and motor angles for a detector position."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from clampid.display import fixed, length, number, readable
from clampid.verbs.options import EffectsFrom, Json, ModelFile, Quiet, Verbose
from clampid.verbs.output import Output
from clampid.verbs.units import Degrees, Millimetres, Units
from offline_ik.errors import DetectorError
from offline_ik.verbs.options import CellFile, Robot, Running, numbers, opened, say_assumed
from offline_ik.verbs.previews import Picture, Pixel, Pixels, Poni, Preview, check_previews, previewed
from offline_ik.verbs.screen import ik_screen

if TYPE_CHECKING:
    from offline_ik.inverse.answer import Solution
    from offline_ik.inverse.detector import Detector
    from offline_ik.motion.ways import Way, Ways

__all__ = ["ik"]


def ik(
    model: ModelFile,
    gamma: Annotated[float, typer.Option(metavar="RAD", help="Scattering angle gamma, radians.", show_default=False)],
    delta: Annotated[float, typer.Option(metavar="RAD", help="Scattering angle delta, radians.", show_default=False)],
    r: Annotated[float, typer.Option("--r", metavar="M", help="Distance from the sample, metres.", show_default=False)],
    deg: Degrees = False,
    mm: Millimetres = False,
    cell: CellFile = None,
    robot: Robot = None,
    running: Running = None,
    roll: Annotated[str, typer.Option(metavar="RAD|free", help="Angle about the detector's normal, or free.")] = "0",
    near: Annotated[
        str | None, typer.Option(metavar="Q1,Q2,…", help="The posture at hand, radians.", show_default=False)
    ] = None,
    branch: Annotated[
        str, typer.Option(metavar="WHICH", help="nearest, all, axis5+, axis5-, or KUKA's Status and Turn as S2T35.")
    ] = "nearest",
    approach: Annotated[
        bool, typer.Option("--approach", help="Approach through a point, so that clearances lie on a known side.")
    ] = False,
    direction: Annotated[
        str | None,
        typer.Option(
            metavar="D1,D2,…", show_default=False,
            help="From which side each joint comes: 1 towards larger angles, -1 smaller, 0 not said; without it, as "
            "joints move straight from --near, or with --approach, as gravity presses.",
        ),
    ] = None,
    pyfai: Annotated[bool, typer.Option("--pyfai", help="Give the geometry for pyFAI as well.")] = False,
    picture: Picture = None,
    poni: Poni = None,
    pixel: Pixel = None,
    pixels: Pixels = None,
    effects_from: EffectsFrom = None,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:  # fmt: skip
    """Give joint and motor angles for a detector position, its uncertainty, and whether the move is safe."""
    out = Output(quiet, json, verbose, copied=True)
    check_previews(picture, poni)
    os.environ.setdefault("CLAMPID_COMPILER", "none")  # one answer comes sooner than its compiled kernel
    from offline_ik.cell.checks import check_directions
    from offline_ik.cell.coordinates import check_target
    from offline_ik.inverse.assumed import assumptions
    from offline_ik.motion.simulation import Position, simulate_move

    units = Units(deg, mm)
    given_position = {"--gamma": gamma, "--delta": delta, "--r": r}
    gamma, delta, r = units.radians(gamma), units.radians(delta), units.metres(r)
    turned = None if roll == "free" else units.radians(_roll(roll))
    check_target(gamma, delta, r, turned or 0.0)
    here, sides = numbers("--near", near), numbers("--direction", direction)
    here = None if here is None else [units.radians(angle) for angle in here]
    detector = opened(model, cell, robot, effects_from, running)
    asked = None if sides is None else check_directions(detector.arm.n, sides)
    with out.working("solving"):
        simulation = simulate_move(
            detector, Position(gamma, delta, r, turned), start=here, branch=branch, approach=approach, direction=asked
        )
        ways = simulation.ways
        answer, data = ways.answer, _data(ways, branch, (*detector.notes, *_later(detector, ways)))
        found, seen = previewed(detector, simulation, Preview(picture, poni, pixel, pixels), units)
        data |= seen
    if pyfai and answer.reachable:
        from offline_ik.cell.pyfai import pyfai_geometry

        data["pyfai"] = pyfai_geometry(detector.cell.convention, answer.target).to_json()
    assumed = assumptions(detector)
    if json == "-":  # then there is no screen
        for note in data["notes"]:
            out.warn(note)
        say_assumed(detector, out)
    elif assumed:
        out.say("\n  ".join(["assumed, because no cell file states it:", *assumed]))
    _show(detector, ways, units, out)
    if "pyfai" in data:
        at = ", ".join(f"{name} {fixed(value, 9)}" for name, value in data["pyfai"].items())
        out.say(f"pyFAI: {at} (m, rad; poni counted from the detector's middle)")
    angle, distance = units.angle_unit, units.distance_unit
    g, d, far = given_position.values()
    position = f"gamma {g:g} {angle}, delta {d:g} {angle}, r {far:g} {distance}"
    call: list[str | Path] = [model, *(w for name, v in given_position.items() for w in (name, f"{v!r}"))]
    own = () if effects_from is None else ("--effects-from", effects_from)
    given = (("--cell", cell), ("--robot", robot), ("--running", running), ("--near", near))
    call += [f"{option}={value}" for option, value in given if value is not None]
    call += [*(["--roll", roll] if roll != "0" else []), *units.options]
    out.show(ik_screen(detector, ways, position, [*call, *own], [*found, *data["notes"]], assumed, approach, units))
    out.result(data)


def _roll(text: str) -> float:
    found = numbers("--roll", text) or []
    if len(found) != 1:
        raise DetectorError(f"--roll: expected one angle in radians or free, found {text!r}")
    return found[0]


def _later(detector: Detector, ways: Ways) -> tuple[str, ...]:
    """How far the detector drifts in 8 h, if no running time was given."""
    from offline_ik.inverse.assumed import moves_by, time_effects

    if detector.cell.running is not None or not ways.answer.reachable or not time_effects(detector.arm):
        return ()
    moved = moves_by(detector, ways.answer.solutions[0].q)
    return (f"8 h later the detector would stand {1e6 * moved:.0f} µm from there: say --running",)


def _data(ways: Ways, branch: str, notes: tuple[str, ...]) -> dict[str, Any]:
    """The JSON; if all postures were asked for, each has the check of its move."""
    data = ways.answer.to_json() | ways.to_json()
    data["notes"] = [*notes, *data.get("notes", ())]
    if branch == "all":
        data["solutions"] = [s | way.to_json() for s, way in zip(data["solutions"], ways.chosen, strict=True)]
    return data


def _show(detector: Detector, ways: Ways, units: Units, out: Output) -> None:
    answer, running = ways.answer, detector.cell.running
    convention = answer.convention
    out.say(f"robot: {detector.robot.name}" + ("" if running is None else f", running for {running / 3600:.4g} h"))
    out.say(
        f"convention: {convention['name']}, {convention['order']}, beam {convention['beam']}, "
        f"sample {convention['sample_m']} m in the frame {convention['frame']}"
    )
    if not answer.reachable:
        out.say(f"not reachable: {'; '.join(answer.reasons)}")
        if answer.nearest is not None:
            n = answer.nearest
            out.say(
                f"nearest: gamma {units.angle(n['gamma_rad'])}, delta {units.angle(n['delta_rad'])}, "
                f"r {units.distance(n['r_m'])}, roll {units.angle(n['roll_rad'], 4)}, {length(n['distance_m'])} away"
            )
        return
    for way in ways.chosen:
        _show_solution(way.solution, answer.asked["r_m"] or 0.0, units, out)
        out.say(f"joints come {_coming(way.solution, ways.came)}")
        out.say(f"path: {CHECKED[way.checked]}{_path(way)}")
        if way.approach is not None:
            through = ", ".join(map(units.bare_angle, way.approach.through.tolist()))
            out.say(f"approach through {through} {units.angle_unit}, gain {length(way.approach.gain)}")


CAME = {
    "asked": "as asked",
    "moved": "as they move straight from --near",
    "approach": "on the last part of the approach",
}


CHECKED = {
    "way": "",
    "approach": "to the approach's point not checked: give the starting posture with --near; from there on ",
    "place": "not checked: give the starting posture with --near; the place itself is ",
}


def _path(way: Way) -> str:
    """What the check found, in words."""
    path = way.path
    if not path.safe:
        return f"refused: {'; '.join(path.reasons)}"
    near = []
    if math.isfinite(path.clearance):
        near.append(f"{' and '.join(path.between)} come within {length(path.clearance)}")
    if math.isfinite(path.base_distance):
        near.append(f"axes 4 and 5 within {length(path.base_distance)} of the base")
    takes = "" if way.checked == "place" else f"; {number(path.duration, 2)} s"
    return f"safe{': ' if near else ''}{', '.join(near)}{takes}"


def _coming(solution: Solution, came: str) -> str:
    """From which sides, in words."""
    if came not in CAME:
        return "from unknown sides: half of play and wind-up counts as an error"
    marks = {1.0: "+", -1.0: "-", 0.0: "unknown"}
    return f"{' '.join(marks[side] for side in solution.direction.tolist())} ({CAME[came]})"


def _show_solution(solution: Solution, r: float, units: Units, out: Output) -> None:
    u, stated = solution.uncertainty, solution.uncertainty.stated()
    rows = [
        (f"joint {i}", units.bare_angle(a), units.bare_angle(m, 4))
        for i, (a, m) in enumerate(zip(solution.q.tolist(), solution.motor.tolist(), strict=True), 1)
    ]
    columns = ("", f"joint / {units.angle_unit}", f"motor / {units.angle_unit}")
    out.table(f"KUKA Status and Turn: S{solution.status}T{solution.turn}", columns, rows)
    out.say(
        f"uncertainty (1 σ, by the model's covariance): {length(u.tangential_m)} along the sphere, both directions "
        f"together ({readable(u.tangential_m / r, 'microrad')} as seen from the sample, "
        f"{number(stated['tangential_std_pixels'])} pixels of {readable(u.pixel, 'm', 2)}); "
        f"{length(stated['radial_std_m'])} along the line of sight; "
        f"{readable(u.std_rad, 'microrad')} in orientation, all axes together"
    )
    out.say(f"the detector is within {length(u.radius95_m)} of where it is asked to be, with 95 %")
    if solution.extrapolating:
        from clampid.verbs.findings import extrapolating_text

        out.say(f"extrapolating: {extrapolating_text([beyond.to_json() for beyond in solution.extrapolating])}")
    if solution.singular:
        out.say(f"near a singularity: {', '.join(solution.singular)}")
