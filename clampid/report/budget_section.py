"""The error budget as figures and tables, with the noise floor."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from clampid.charts import Axis, Bars, Chart, Label, Level, Mark, Panel, Points
from clampid.display import error_text, number
from clampid.effect import Stage
from clampid.report.budget import Share, pose_budget, torque_budget
from clampid.report.stage_data import StageData, stage_title
from clampid.report.style import Figure, Section, Table, as_table
from clampid.stages.rows import Array, Integers
from clampid.stages.stage_kind import kind_of

__all__ = ["budget_section"]

RING_WIDTH = 0.022  # of the axis: a ring of 16 pixels and its edge
_IN_WORDS = {"robot": "what all joints share"}
RING_HEIGHTS = (0.0, -0.4, 0.4)  # of a bar's distance from the next, where rings would cover each other


def budget_section(stages: Mapping[Stage, StageData]) -> Section | None:
    """Section "Error budget"."""
    blocks: list[str | Table | Figure] = []
    for stage, data in stages.items():
        if not data.good.any():
            continue
        blocks.append(stage_title(stage))
        blocks += _pose_blocks(data) if kind_of(stage).points else _torque_blocks(data)
    if not blocks:
        return None
    text = (
        "How much each effect amounts to over this campaign: its amplitudes set to zero in the fitted model, "
        "everything else as it is, and the difference of the two predictions. Parts do not add up: a model without one "
        "effect, fitted again, would hide some of it in the others."
    )
    return Section("budget", "Error budget by effect", (text,), tuple(blocks))


def _pose_blocks(data: StageData) -> list[Table | Figure]:
    shares = [s for s in pose_budget(data) if float(s.total[0]) > 0.0]
    floor = data.floor.norm
    names = [s.name.replace("_", " ") for s in shares]
    totals = [1e6 * float(s.total[0]) for s in shares]
    smallest = min([*totals, *(1e6 * v for s in shares for v in s.places.values() if v > 0), 1e6 * floor], default=1.0)
    low = 10.0 ** np.floor(np.log10(max(smallest, 1e-2)))
    low, high = float(low), max([*totals, 1e6 * floor]) * 10**0.15
    tips = [f"{name}: {number(total, 3)} µm" for name, total in zip(names, totals, strict=True)]
    marks: list[Mark] = [Bars(np.array(totals), ["blue"] * len(names), "effect as a whole", tips)]
    places = [(k, 1e6 * v, p) for k, s in enumerate(shares) for p, v in s.places.items() if 1e6 * v > low]
    dots = [dot for dot in places if _number_of(dot[2]).isdigit()]  # a ring has room for a number
    if dots:
        tips = [f"{names[k]} at {place}: {number(v, 3)} µm" for k, v, place in dots]
        at, rows_of = np.array([v for _, v, _ in dots]), np.array([k for k, _, _ in dots])
        heights = rows_of + _apart(np.log(at) / np.log(high / low), rows_of)
        marks.append(Points(at, heights, "single joints and links, by number", "orange", 16, symbol="ring", tips=tips))
        marks += [Label((_number_of(p),), v, y) for (_, v, p), y in zip(dots, heights.tolist(), strict=True)]
    marks.append(Level(1e6 * floor, "x", "noise floor"))
    panel = Panel(
        tuple(marks),
        Axis("RMS shift of the measured points, µm", low, high, log=True),
        Axis(flipped=True, ticks=tuple((float(k), name) for k, name in enumerate(names))),
    )
    plot = Chart((panel,), 100 + 34 * len(names), left=230)
    rows = [
        (
            s.name.replace("_", " "),
            error_text(float(s.total[0]), "m"),
            number(float(s.total[0]) / floor, 2),
            _largest(s),
        )
        for s in shares
    ]
    caption = (
        f"RMS shift at the campaign's {int(data.first.good[:, 0].sum())} points. Base, targets and "
        "flange belong to the setup. Their shift is relative to the nominal robot aligned with the points."
    )
    table = as_table(("Effect", "RMS shift#", "Times the noise#", "Largest single places"), rows)
    return [Figure("budget-poses", plot, caption), table]


def _apart(at: Array, row: Integers) -> Array:
    """Heights ``(N,)`` beside those of their rows at which rings ``at`` shares of the axis do not cover each other."""
    out, last = np.zeros(len(at)), dict[tuple[int, float], float]()
    for k in np.argsort(at, kind="stable"):
        clear = [h for h in RING_HEIGHTS if at[k] - last.get((int(row[k]), h), -np.inf) >= RING_WIDTH]
        out[k] = clear[0] if clear else RING_HEIGHTS[0]
        last[int(row[k]), float(out[k])] = float(at[k])
    return out


def _number_of(place: str) -> str:
    """The number of a joint or link; of other places their name."""
    return place.removeprefix("joint").removeprefix("link")


def _largest(share: Share) -> str:
    listed = sorted(share.places.items(), key=lambda item: -item[1])[:3]
    return ", ".join(f"{_IN_WORDS.get(place, place)} {error_text(v, 'm')}" for place, v in listed if v > 0) or "–"


def _torque_blocks(data: StageData) -> list[Table | Figure]:
    shares = torque_budget(data)
    motors = data.channels
    floor = data.floor.sigma[:motors]
    lines = [*shares, Share("noise floor", floor, {})]
    across = min(motors, 6)
    named = tuple((float(k), s.name.replace("_", " ")) for k, s in enumerate(lines))
    colors = ["grey" if s.name in ("torque measured", "gravity as described") else "blue" for s in shares] + ["green"]
    panels = []
    for k in range(across):
        values = np.array([float(s.total[k]) for s in lines])
        tiny = 0.2 * float(floor[k])
        top = float(np.nanmax([*values, floor[k]])) * 10**0.1
        tips = [f"{s.name}, motor {k + 1}: {number(v, 3)} Nm" for s, v in zip(lines, values.tolist(), strict=True)]
        bars = Bars(np.where(values > tiny, values, np.nan), colors, "", tips)
        axis = Axis("", flipped=True, ticks=() if k else named)
        level = Level(float(floor[k]), "x", "noise floor")
        panels.append(Panel((bars, level), Axis("Nm", tiny, top, log=True), axis, f"motor {k + 1}"))
    plot = Chart(tuple(panels), 110 + 30 * len(lines), across, left=210)
    rows = [(s.name.replace("_", " "), *(number(float(v)) if v > 1e-9 else "0" for v in s.total)) for s in lines]
    note = " The springs are left out: a clamped drive without them has no finite torque." if data.kind.solved else ""
    caption = f"RMS torque at each motor that an effect stands for, Nm.{note}"
    return [
        Figure(f"budget-{data.stage}", plot, caption),
        Table(
            ("Nm, RMS", *(f"Motor {k + 1}#" for k in range(motors))),
            tuple(rows),
            "RMS torque at each motor by effect, in numbers",
            folded=True,
        ),
    ]
