"""Reads a plan and checks it against its own limits: an unsafe plan is refused before anything moves."""

from __future__ import annotations

import tomllib
from pathlib import Path
from types import MappingProxyType
from typing import Literal, cast

import numpy as np

from experiments.header import FARTHEST_POINT_M, LARGEST_MASS_KG, WORST_POSITION_STD_M, robot_in
from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits
from experiments.plans.model import (
    KINDS,
    Cell,
    Expected,
    ExpectedParameter,
    Kind,
    LeastTorque,
    Plan,
    Run,
    Steady,
    Sweep,
    Visit,
)
from experiments.plans.motion import Course
from experiments.plans.validate import validate_plan
from experiments.plans.write import FORMAT
from kinematics.reading import read_text, toml_of
from kinematics.section import Section, migrated

__all__ = ["parse_plan", "read_plan"]

LONGEST_SENTENCE = 2000  # characters
LONGEST_WAIT_S = 7 * 86400.0
MOST_TIMES = 100_000  # swings of one visit: days
STEP_KINDS = {"free_air": "run", "wrist": "run", "clamping": "sweep", "poses": "visit"}


def read_plan(path: str | Path) -> Plan:
    """Read and check a plan.

    Raises
    ------
    PlanError
        The file is missing or no TOML, a key is missing, unknown or wrong, or a step is beyond the plan's own limits;
        the message names file, place, what was expected and what was found.
    """
    file = Path(path)
    if not file.is_file():
        found = "a folder" if file.is_dir() else "a device or pipe" if file.exists() else "no such file"
        raise PlanError(f"{file}: expected a plan file, found {found}")
    try:
        text = read_text(file)
    except UnicodeDecodeError as error:
        raise PlanError(f"{file}: expected UTF-8 text, found a byte that is not, at offset {error.start}") from error
    except OSError as error:
        raise PlanError(f"{file}: cannot be read: {error.strerror or error}") from error
    return parse_plan(text, file)


def parse_plan(text: str, file: Path) -> Plan:
    """Read a plan from its text; ``file`` is for messages, and a robot's path is relative to it.

    Raises
    ------
    PlanError
        As `read_plan`.
    """
    try:
        root = Section(migrated(toml_of(text), FORMAT, {}), str(file), error=PlanError)
    except tomllib.TOMLDecodeError as error:
        raise PlanError(f"{file}: expected TOML, found {error}") from error
    except ValueError as error:
        raise PlanError(f"{file}, {error}") from None
    root.has("format")
    kind = cast(Kind, root.text("kind", KINDS))
    cell = _cell(root, file)
    n = cell.robot.n
    limits = _limits(root.section("limits"), n)
    steps = root.sections(STEP_KINDS[kind])
    plan = Plan(
        kind=kind,
        cell=cell,
        limits=limits,
        duration=root.number("duration_s", 0.0),
        runs=tuple(_run(s, n) for s in steps) if STEP_KINDS[kind] == "run" else (),
        sweeps=tuple(_sweep(s, n, number) for number, s in enumerate(steps, 1)) if kind == "clamping" else (),
        visits=tuple(_visit(s, n, tuple(cell.targets)) for s in steps) if kind == "poses" else (),
        start=root.vector("start_rad", n) if root.has("start_rad") else None,
        rate=root.number("rate_Hz", 0.0, above=True),
        measure_time=root.number("measure_time_s", 0.0),
        stiffness=root.vector("stiffness_Nm_rad", n, 0.0) if root.has("stiffness_Nm_rad") else None,
        expected=_expected(root.section("expected")) if root.has("expected") else None,
        steady=_steady(root) if root.has("steady_K_h") else None,
        least_torque=_least_torque(root, n) if root.has("least_torque_step_rad") else None,
        assumed=root.texts("assumed"),
        wished=MappingProxyType(_wished(root.section("wished", optional=True))),
    )
    root.done()
    validate_plan(plan, str(file))
    return plan


def _cell(root: Section, file: Path) -> Cell:
    robot, reference = robot_in(root, file.parent), root.content["robot"]
    if Path(reference).suffix:
        reference = str((file.parent / reference).resolve())
    tool = root.section("tool")
    targets = root.section("targets_m", optional=True)
    instrument = root.section("instrument")
    cell = Cell(
        robot=robot,
        reference=reference,
        gravity=root.vector("gravity_m_s2", 3),
        tool_mass=tool.number("mass_kg", 0.0, LARGEST_MASS_KG, "kg"),
        tool_com=tool.vector("com_m", 3, -FARTHEST_POINT_M, FARTHEST_POINT_M, "m"),
        targets={
            name: targets.vector(name, 3, -FARTHEST_POINT_M, FARTHEST_POINT_M, "m")
            for name in targets.keys()  # noqa: SIM118 - not a dict: marks them read
        },
        instrument=instrument.text("name"),
        position_std=instrument.number("position_std_m", 0.0, WORST_POSITION_STD_M, "m", above=True),
    )
    tool.done()
    instrument.done()
    return cell


def _limits(section: Section, n: int) -> Limits:
    limits = Limits(
        lower=section.vector("lower_rad", n),
        upper=section.vector("upper_rad", n),
        speed=section.vector("speed_rad_s", n, 0.0),
        acceleration=section.vector("acceleration_rad_s2", n, 0.0),
        motor_torque=section.vector("motor_torque_Nm", n, 0.0) if section.has("motor_torque_Nm") else None,
        force=section.number("force_N", 0.0, above=True) if section.has("force_N") else None,
        moment=section.number("moment_Nm", 0.0, above=True) if section.has("moment_Nm") else None,
    )
    section.done()
    return limits


def _run(section: Section, n: int) -> Run:
    start = section.vector("start_rad", n)
    moves = section.sections("move")
    knots, duration, ramp = [start], [], []
    for move in moves:
        knots.append(move.vector("to_rad", n))
        duration.append(move.number("duration_s", 0.0, above=True))
        ramp.append(move.number("ramp_s", 0.0, above=True))
        move.done()
    course = Course(np.array(knots), np.array(duration), np.array(ramp), section.number("dwell_s", 0.0))
    run = Run(course, section.number("speed_share", 0.0, above=True))
    section.done()
    return run


def _sweep(section: Section, n: int, number: int) -> Sweep:
    if section.integer("sweep") != number:
        raise section.fault("sweep", str(number), repr(section.content["sweep"]))
    offset = section.vector("offset_rad", None)
    sweep = Sweep(
        clamping=section.integer("clamping"),
        joint=section.integer("joint", 1, n) - 1,
        posture=section.vector("posture_rad", n),
        offset=offset,
        dwell=section.number("dwell_s", 0.0),
        force=section.vector("force_N", len(offset), 0.0),
        moment=section.vector("moment_Nm", len(offset), 0.0),
    )
    section.done()
    return sweep


def _visit(section: Section, n: int, targets: tuple[str, ...]) -> Visit:
    wanted = section.texts("targets")
    for name in wanted:
        if name not in targets:
            raise section.fault("targets", f"some of {', '.join(targets)}", repr(name))
    visit = Visit(
        table=cast(Literal["poses", "verification"], section.text("table", ("poses", "verification"))),
        pose=section.integer("pose"),
        visit=section.integer("visit"),
        via=section.vector("via_rad", n),
        q=section.vector("to_rad", n),
        duration=section.vector("duration_s", 2, 0.0),
        ramp=section.vector("ramp_s", 2, 0.0),
        targets=wanted,
        times=section.integer("times", 1, MOST_TIMES) if section.has("times") else 1,
        wait=section.number("wait_s", 0.0, LONGEST_WAIT_S, "s") if section.has("wait_s") else 0.0,
    )
    section.done()
    return visit


def _steady(root: Section) -> Steady:
    return Steady(root.number("steady_K_h", 0.0, above=True), root.number("steady_for_s", 0.0))


def _least_torque(root: Section, n: int) -> LeastTorque:
    found = LeastTorque(root.vector("least_torque_step_rad", n, 0.0), root.vector("least_torque_within_rad", n, 0.0))
    for name, values in (("step", found.step), ("within", found.within)):
        if np.any(values <= 0.0):
            raise root.fault(f"least_torque_{name}_rad", "numbers above 0", str(values.tolist()))
    return found


def _expected(section: Section) -> Expected:
    indices = section.section("indices")
    found = []
    for one in section.sections("parameter"):
        found.append(
            ExpectedParameter(
                one.text("name"),
                one.text("unit"),
                one.number("size", 0.0),
                one.number("std", 0.0),
                one.flag("identified"),
            )
        )
        one.done()
    expected = Expected(
        indices={name: indices.number(name) for name in indices.keys()},  # noqa: SIM118 - not a dict
        parameters=tuple(found),
        not_identified=section.texts("not_identified"),
        noise=section.text("noise", longest=LONGEST_SENTENCE),
    )
    section.done()
    return expected


def _wished(section: Section) -> dict[str, float | int | str]:
    out: dict[str, float | int | str] = {}
    for key in section.keys():  # noqa: SIM118 - not a dict
        value = section.content[key]
        if not isinstance(value, int | float | str):
            raise section.fault(key, "a number or text", repr(value))
        out[key] = value
    return out
