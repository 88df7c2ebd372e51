"""Writes a plan as TOML that a person can read: purpose, limits, expected results, then step by step."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.outputs import write_text
from experiments.plans.model import Expected, Plan, Run, Sweep, Visit
from experiments.toml_text import toml_text

__all__ = ["FORMAT", "plan_text", "write_plan"]

FORMAT = "clampid-plan/1"


def write_plan(plan: Plan, path: str | Path) -> Path:
    """Write a plan, whole or not at all."""
    target = Path(path)
    write_text(target, plan_text(plan, target.parent))
    return target


def plan_text(plan: Plan, folder: Path = Path()) -> str:
    """The plan as TOML; numbers keep every digit that they need. A robot's path is made relative to ``folder``."""
    cell, limits = plan.cell, plan.limits
    robot = cell.reference
    if Path(robot).suffix:
        robot = os.path.relpath(Path(robot).resolve(), folder.resolve())
    head: dict[str, Any] = {
        "format": FORMAT,
        "kind": plan.kind,
        "robot": robot,
        "duration_s": round(plan.duration, 3),
        "gravity_m_s2": cell.gravity,
        "rate_Hz": plan.rate,
        "measure_time_s": plan.measure_time,
    }
    if plan.start is not None:
        head["start_rad"] = plan.start
    if plan.stiffness is not None:
        head["stiffness_Nm_rad"] = plan.stiffness
    if plan.steady is not None:
        head |= {"steady_K_h": plan.steady.rate, "steady_for_s": plan.steady.beyond}
    if plan.least_torque is not None:
        head |= {"least_torque_step_rad": plan.least_torque.step, "least_torque_within_rad": plan.least_torque.within}
    head["assumed"] = list(plan.assumed)
    bounds: dict[str, Any] = {
        "lower_rad": limits.lower,
        "upper_rad": limits.upper,
        "speed_rad_s": limits.speed,
        "acceleration_rad_s2": limits.acceleration,
    }
    if limits.motor_torque is not None:
        bounds["motor_torque_Nm"] = limits.motor_torque
    for key, value in (("force_N", limits.force), ("moment_Nm", limits.moment)):
        if value is not None:
            bounds[key] = value
    sections: dict[str, Mapping[str, Any]] = {
        "tool": {"mass_kg": cell.tool_mass, "com_m": cell.tool_com},
        "targets_m": cell.targets,
        "instrument": {"name": cell.instrument, "position_std_m": cell.position_std},
        "limits": bounds,
        "wished": plan.wished,
    }
    parts = [toml_text(head), *(_section(f"[{name}]", content) for name, content in sections.items() if content)]
    if plan.expected is not None:
        parts += _expected(plan.expected)
    parts += [_run(run) for run in plan.runs]
    parts += [_section("[[sweep]]", _sweep(sweep, number)) for number, sweep in enumerate(plan.sweeps, 1)]
    parts += [_section("[[visit]]", _visit(visit)) for visit in plan.visits]
    return "\n".join(parts)


def _section(title: str, content: Mapping[str, Any]) -> str:
    return f"{title}\n{toml_text(content)}"


def _rows(key: str, rows: Sequence[Any]) -> str:
    """A long list with one entry on each line."""
    # In a list, so that a mapping becomes an inline table and not a section.
    lines = [toml_text({key: [row]}).removeprefix(f"{key} = [").strip().removesuffix("]") for row in rows]
    return f"{key} = [\n" + "".join(f"    {line},\n" for line in lines) + "]\n"


def _expected(expected: Expected) -> list[str]:
    open_ = _rows("not_identified", expected.not_identified) if expected.not_identified else "not_identified = []\n"
    table = [
        {"name": p.name, "unit": p.unit, "std": _short(p.std), "size": p.size, "identified": p.identified}
        for p in expected.parameters
    ]
    indices = {name: int(v) if name == "parameters" else _short(v) for name, v in expected.indices.items()}
    return [
        _section("[expected]", {"noise": expected.noise}) + open_ + _rows("parameter", table),
        _section("[expected.indices]", indices),
    ]


def _short(value: float) -> float:
    return float(f"{value:.5g}")


def _run(run: Run) -> str:
    course = run.course
    stops = [
        {"to_rad": to, "duration_s": float(duration), "ramp_s": float(ramp)}
        for to, duration, ramp in zip(course.knots[1:], course.duration, course.ramp, strict=True)
    ]
    head = {"speed_share": run.speed_share, "dwell_s": course.dwell, "start_rad": course.knots[0]}
    return _section("[[run]]", head) + _rows("move", stops)


def _sweep(sweep: Sweep, number: int) -> dict[str, Any]:
    return {
        "sweep": number,
        "clamping": sweep.clamping,
        "joint": sweep.joint + 1,
        "posture_rad": sweep.posture,
        "dwell_s": sweep.dwell,
        "offset_rad": sweep.offset,
        "force_N": np.round(sweep.force, 3),
        "moment_Nm": np.round(sweep.moment, 3),
    }


def _visit(visit: Visit) -> dict[str, Any]:
    return {
        "table": visit.table,
        "pose": visit.pose,
        "visit": visit.visit,
        "via_rad": visit.via,
        "to_rad": visit.q,
        "duration_s": visit.duration,
        "ramp_s": visit.ramp,
        "targets": list(visit.targets),
        **({"times": visit.times} if visit.times != 1 else {}),
        **({"wait_s": visit.wait} if visit.wait else {}),
    }
