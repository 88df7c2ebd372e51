"""``clampid ik``: joint and motor angles for a detector position."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Annotated, Any

import typer

from clampid.verbs.options import EffectsFrom, Json, ModelFile, Quiet
from clampid.verbs.output import Output
from offline_ik.verbs.options import CellFile, Robot, numbers, opened

if TYPE_CHECKING:
    from offline_ik.answer import Solution
    from offline_ik.ways import Ways

__all__ = ["ik"]


def ik(
    model: ModelFile,
    gamma: Annotated[float, typer.Option(metavar="RAD", help="Scattering angle gamma, radians.", show_default=False)],
    delta: Annotated[float, typer.Option(metavar="RAD", help="Scattering angle delta, radians.", show_default=False)],
    r: Annotated[float, typer.Option("--r", metavar="M", help="Distance from the sample, metres.", show_default=False)],
    cell: CellFile = None,
    robot: Robot = None,
    roll: Annotated[str, typer.Option(metavar="RAD|free", help="About the detector's normal.")] = "0",
    near: Annotated[
        str | None, typer.Option(metavar="Q1,Q2,…", help="The posture at hand, radians.", show_default=False)
    ] = None,
    branch: Annotated[
        str, typer.Option(metavar="WHICH", help="nearest, all, axis5+, axis5-, or KUKA's Status and Turn as S2T35.")
    ] = "nearest",
    approach: Annotated[
        bool, typer.Option("--approach", help="Through an intermediate point, so that play lies on a known side.")
    ] = False,
    pyfai: Annotated[bool, typer.Option("--pyfai", help="Give the geometry for pyFAI as well.")] = False,
    effects_from: EffectsFrom = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Joint and motor angles that put the detector there, how far off it may be, and whether the way is safe."""
    out = Output(quiet, json)
    os.environ.setdefault("CLAMPID_COMPILER", "none")  # one answer comes sooner than its compiled kernel
    from offline_ik.coordinates import check_target
    from offline_ik.ways import ways_to

    turned = None if roll == "free" else (numbers("--roll", roll) or [0.0])[0]
    check_target(gamma, delta, r, turned or 0.0)
    here = numbers("--near", near)
    detector = opened(model, cell, robot, effects_from)
    with out.working("solving"):
        answer = detector.locate(gamma, delta, r, turned, near=here, branch=branch, direction="moved" if here else None)
        ways = ways_to(detector, answer, start=here, branch=branch, approach=approach)
        answer, data = ways.answer, _data(ways, branch, detector.notes)
    if pyfai and answer.reachable:
        from offline_ik.pyfai import pyfai_geometry

        data["pyfai"] = pyfai_geometry(detector.cell.convention, answer.target).to_json()
    for note in data["notes"]:
        out.warn(note)
    _show(ways, out)
    out.result(data)


def _data(ways: Ways, branch: str, notes: tuple[str, ...]) -> dict[str, Any]:
    """The JSON; where all postures were asked for, each with the check of the way there."""
    data = ways.answer.to_json() | ways.to_json()
    data["notes"] = [*notes, *data.get("notes", ())]
    if branch == "all":
        data["solutions"] = [s | way.to_json() for s, way in zip(data["solutions"], ways.chosen, strict=True)]
    return data


def _show(ways: Ways, out: Output) -> None:
    answer = ways.answer
    convention = answer.convention
    out.say(
        f"convention: {convention['name']}, {convention['order']}, beam {convention['beam']}, "
        f"sample {convention['sample_m']} m in the frame {convention['frame']}"
    )
    for what in answer.cell["assumed"]:
        out.warn(f"assumed, for want of a cell that says: {what}")
    if not answer.reachable:
        out.say(f"not reachable: {'; '.join(answer.reasons)}")
        if answer.nearest is not None:
            n = answer.nearest
            out.say(
                f"nearest: gamma {n['gamma_rad']:.6f} rad, delta {n['delta_rad']:.6f} rad, r {n['r_m']:.4f} m, "
                f"{1e3 * n['distance_m']:.1f} mm away"
            )
        return
    for way in ways.chosen:
        _show_solution(way.solution, out)
        out.say("path: safe" if way.path.safe else f"path: refused: {'; '.join(way.path.reasons)}")
        if way.approach is not None:
            out.say(f"approach through a point, gain {1e6 * way.approach.gain:.0f} µm")


def _show_solution(solution: Solution, out: Output) -> None:
    u = solution.uncertainty
    rows = [(f"joint {i + 1}", f"{a:.6f}", f"{m:.4f}") for i, (a, m) in enumerate(
        zip(solution.q.tolist(), solution.motor.tolist(), strict=True))]  # fmt: skip
    out.table(f"S {solution.status}  T {solution.turn}", ("", "joint / rad", "motor / rad"), rows)
    out.say(
        f"uncertainty (1 σ): {1e6 * u.std_m:.0f} µm ({1e6 * u.tangential_m:.0f} µm = {u.tangential_m / u.pixel:.1f} "
        f"pixels along the sphere), {1e6 * u.std_rad:.0f} µrad"
    )
    if solution.extrapolating:
        from clampid.verbs.findings import extrapolating_text

        out.say(f"extrapolating: {extrapolating_text([beyond.to_json() for beyond in solution.extrapolating])}")
    if solution.singular:
        out.warn(f"near a singularity: {', '.join(solution.singular)}")
